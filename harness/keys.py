"""Keys: digests of all that can change a result, so that what is stored is never used for another one."""

from __future__ import annotations

import functools
import hashlib
import importlib.metadata
import json
import platform
from collections.abc import Iterable, Mapping
from pathlib import Path

from harness import environment

EXPERT_SOURCES = (
    *("envs", "harness/advantage.py", "harness/environment.py", "harness/exact.py", "harness/experts.py"),
    *("harness/rl.py", "harness/rl_settings.py", "harness/seeds.py", "harness/simulator.py"),
    *("harness/world.py", "methods/network.py"),
)
CELL_SOURCES = (
    *EXPERT_SOURCES,
    *("methods", "harness/cache.py", "harness/cells.py", "harness/controls.py", "harness/evaluation.py"),
    *("harness/recordings.py", "harness/registry.py", "harness/results.py", "harness/study.py"),
)
"""Files, and folders of them, that decide what an expert or a cell computes."""
REPORT_SOURCES = ("harness",)
REPORT_PACKAGES = ("matplotlib", "pandas", "jinja2")
"""What decides, besides, how cells are reported."""
PACKAGES = (
    *("torch", "numpy", "scipy", "jax", "flax", "optax", "stable-baselines3", "sbx-rl"),
    *("gymnasium", "mujoco", "highway-env", "cvxpy", "clarabel"),
)
PROGRAM = ("envs", "methods", "harness")
ROOT = Path(__file__).parent.parent


@functools.cache
def program() -> dict[str, bytes]:
    """What Python can import of this program, and the report's template, by path below `ROOT`. Read once:
    keys are of this reading, and the cells' processes import it and not what the files hold by then."""
    files = [file for package in PROGRAM for file in sorted((ROOT / package).rglob("*"))]
    names = {file.relative_to(ROOT).as_posix(): file for file in files if _counts(file)}
    return {name: file.read_bytes() for name, file in names.items()}


def _counts(file: Path) -> bool:
    *folders, name = file.relative_to(ROOT).parts
    stem, _, kind = name.partition(".")
    return (
        all(part.isidentifier() for part in (*folders, stem)) and kind in ("py", "html.j2") and file.is_file()
    )


def write_program(folder: Path) -> None:
    """Copies `program()` into the folder, which is made."""
    for name, content in program().items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(content)


def cell_key(conditions: object, variables: Mapping[str, str]) -> str:
    """What a cell must have been computed under to count, in processes with these `environment.numeric`
    variables. conditions: what JSON can hold."""
    return key_of(CELL_SOURCES, conditions, variables)


def key_of(sources: Iterable[str], ingredients: object, variables: Mapping[str, str] | None = None) -> str:
    """Of the sources, the packages' versions, the variables (default: this process's) that numbers depend on,
    and what JSON can hold."""
    folders = tuple(f"{source}/" for source in sources if not source.endswith(".py"))
    digests = {
        name: hashlib.sha256(content).hexdigest()
        for name, content in program().items()
        if name in sources or name.startswith(folders)
    }
    chosen = environment.of_this_process() if variables is None else dict(variables)
    everything = [ingredients, digests, versions(PACKAGES), chosen]
    return hashlib.sha256(json.dumps(everything, sort_keys=True).encode()).hexdigest()[:16]


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
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:  # not on Linux
        return platform.processor()
    return next((line.partition(":")[2].strip() for line in lines if line.startswith("model name")), "")
