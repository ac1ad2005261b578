"""Keys: digests of all that can change a result, so that what is stored is never used for another one."""

from __future__ import annotations

import functools
import hashlib
import importlib.metadata
import json
import os
import platform
from collections.abc import Iterable
from pathlib import Path

from harness.processes import SAME_INSTRUCTIONS

EXPERT_SOURCES = (
    *("envs", "harness/advantage.py", "harness/exact.py", "harness/experts.py", "harness/processes.py"),
    *("harness/rl.py", "harness/rl_settings.py", "harness/seeds.py", "harness/simulator.py"),
    *("harness/world.py", "methods/network.py"),
)
CELL_SOURCES = (
    *EXPERT_SOURCES,
    *("methods", "harness/cells.py", "harness/controls.py", "harness/evaluation.py", "harness/study.py"),
)
"""Files, and folders of them, that decide what an expert or a cell computes."""
REPORT_SOURCES = ("harness", "harness/report.html.j2")
REPORT_PACKAGES = ("matplotlib", "pandas", "jinja2")
"""What decides, besides, how cells are reported."""
PACKAGES = (
    *("torch", "numpy", "scipy", "jax", "flax", "optax", "stable-baselines3", "sbx-rl"),
    *("gymnasium", "mujoco", "highway-env", "cvxpy", "clarabel"),
)
ROOT = Path(__file__).parent.parent


def key_of(sources: Iterable[str], ingredients: object) -> str:
    """Of the sources, the packages' versions, the choice of instructions, and what JSON can hold."""
    files = [f for s in sources for f in (sorted((ROOT / s).glob("*.py")) or [ROOT / s])]
    digests = [hashlib.sha256(file.read_bytes()).hexdigest() for file in files]
    chosen = [os.environ.get(name) for name in SAME_INSTRUCTIONS]
    everything = [ingredients, digests, versions(PACKAGES), chosen]
    return hashlib.sha256(json.dumps(everything).encode()).hexdigest()[:16]


@functools.cache
def origin() -> dict[str, str]:
    """The processor, the system and the versions that this process computes with, for people."""
    system = f"{platform.system()} {platform.machine()} {' '.join(platform.libc_ver())}".strip()
    return {
        "processor": _processor(),
        "system": system,
        "python": platform.python_version(),
        **dict(zip(PACKAGES, versions(PACKAGES), strict=True)),
    }


def versions(packages: Iterable[str]) -> list[str]:
    """Of those installed."""
    return [importlib.metadata.version(package) for package in packages]


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:  # not on Linux
        return platform.processor()
    return next((line.partition(":")[2].strip() for line in lines if line.startswith("model name")), "")
