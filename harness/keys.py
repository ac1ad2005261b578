"""Keys: digests of all that can change a result, so that what is stored is never used for another one."""

from __future__ import annotations

import hashlib
import importlib.metadata
import json
from collections.abc import Iterable
from pathlib import Path

EXPERT_SOURCES = (
    *("envs", "harness/advantage.py", "harness/exact.py", "harness/experts.py", "harness/rl.py"),
    *("harness/processes.py", "harness/seeds.py", "harness/simulator.py", "harness/world.py"),
    "methods/network.py",
)
CELL_SOURCES = (
    *EXPERT_SOURCES,
    *("methods", "harness/cells.py", "harness/controls.py", "harness/evaluation.py", "harness/study.py"),
)
"""Files, and folders of them, that decide what an expert or a cell computes."""
PACKAGES = (
    *("torch", "numpy", "scipy", "jax", "flax", "optax", "stable-baselines3", "sbx-rl"),
    *("gymnasium", "mujoco", "highway-env", "cvxpy", "clarabel"),
)
ROOT = Path(__file__).parent.parent


def key_of(sources: Iterable[str], ingredients: object) -> str:
    """Of the sources, the packages' versions, and what JSON can hold."""
    files = [f for s in sources for f in (sorted((ROOT / s).glob("*.py")) or [ROOT / s])]
    digests = [hashlib.sha256(file.read_bytes()).hexdigest() for file in files]
    versions = [importlib.metadata.version(package) for package in PACKAGES]
    return hashlib.sha256(json.dumps([ingredients, digests, versions]).encode()).hexdigest()[:16]
