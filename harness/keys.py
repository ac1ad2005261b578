"""Keys: digests of all that can change a result, so that what is stored is never used for another one."""

from __future__ import annotations

import functools
import hashlib
import importlib.metadata
import importlib.util
import json
import platform
import subprocess
from collections.abc import Iterable, Mapping
from pathlib import Path

from harness import environment
from harness.registry import BadInput

EXPERT_SOURCES = (
    *("envs", "harness/advantage.py", "harness/environment.py", "harness/exact.py", "harness/expert_set.py"),
    *("harness/experts.py", "harness/rl.py", "harness/rl_settings.py", "harness/seeds.py"),
    *("harness/simulator.py",),
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
    *("torch", "numpy", "scipy", "jax", "jaxlib", "flax", "optax", "stable-baselines3", "sbx-rl"),
    *("gymnasium", "mujoco", "highway-env", "cvxpy", "clarabel"),
)
MODULES = {"sbx-rl": "sbx"}
"""Packages whose module has another name."""
PROGRAM = ("envs", "methods", "harness")
EXPERTS = ("results/reference/experts", "harness/shipped")
"""Where the shipped experts are: in the repository, and where the package is installed."""
ROOT = Path(__file__).parent.parent
PROGRAM_NAME = "irl-bench"
INSTRUCTIONS = ("sse4", "avx", "fma", "amx")


@functools.cache
def program() -> dict[str, bytes]:
    """What Python can import of this program, the report's template and the shipped experts, by path below
    `ROOT`. Read once: keys are of this reading, and the cells' processes use it and not what the files hold
    by then."""
    files = [file for package in PROGRAM for file in sorted((ROOT / package).rglob("*")) if _counts(file)]
    files += [file for folder in EXPERTS for file in sorted((ROOT / folder).glob("*.safetensors"))]
    files += [file for folder in EXPERTS if (file := ROOT / folder / "SHA256SUMS").is_file()]
    names = {file.relative_to(ROOT).as_posix(): file for file in files}
    return {name: file.read_bytes() for name, file in names.items()}


def expert_files(env: str) -> dict[str, bytes]:
    """A task's shipped experts by path below `ROOT`, in order."""
    beginnings = tuple(f"{folder}/{env}__" for folder in EXPERTS)
    return {name: data for name, data in program().items() if name.startswith(beginnings)}


def experts_version(env: str) -> str:
    """Eight hexadecimal digits that whatever changes a task's shipped experts changes; '' where it has
    none."""
    digests = [
        f"{Path(name).name} {hashlib.sha256(data).hexdigest()}" for name, data in expert_files(env).items()
    ]
    return hashlib.sha256("\n".join(digests).encode()).hexdigest()[:8] if digests else ""


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


def cell_key(env: str, conditions: object, variables: Mapping[str, str]) -> str:
    """What a cell of this environment must have been computed under to count, in processes with these
    `environment.numeric` variables. conditions: what JSON can hold."""
    return key_of(CELL_SOURCES, [conditions, experts_version(env)], variables)


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
    installed = [platform.python_version(), versions(PACKAGES), _elsewhere()]
    everything = [ingredients, digests, installed, chosen]
    return hashlib.sha256(json.dumps(everything, sort_keys=True).encode()).hexdigest()[:16]


@functools.cache
def origin() -> dict[str, str]:
    """The processor, the system and the versions that this process computes with, for people."""
    system = f"{platform.system()} {platform.machine()} {' '.join(platform.libc_ver())}".strip()
    return {
        **_processor(),
        "system": system,
        PROGRAM_NAME: _commit(),
        "python": platform.python_version(),
        **dict(zip(PACKAGES, versions(PACKAGES), strict=True)),
    }


def versions(packages: Iterable[str]) -> list[str]:
    """Of those installed. Raises BadInput where one is not, or only in part."""
    found = []
    for package in packages:
        try:
            version = importlib.metadata.version(package)
        except importlib.metadata.PackageNotFoundError:
            version = None
        if not isinstance(version, str):
            raise BadInput(f"the package {package} is not installed, or only in part; install it again")
        found.append(version)
    return found


@functools.cache
def _elsewhere() -> dict[str, str]:
    """Packages whose module is not imported from where they are installed, such as through PYTHONPATH, and
    from where it is: their version says nothing of it."""
    found = {}
    for package in PACKAGES:
        name = MODULES.get(package, package.replace("-", "_"))
        spec = importlib.util.find_spec(name)
        origin = Path(spec.origin) if spec and spec.origin else Path(name)
        installed = Path(str(importlib.metadata.distribution(package).locate_file("")))
        if not origin.resolve().is_relative_to(installed.resolve()):
            found[package] = str(origin)
    return found


def _processor() -> dict[str, str]:
    """What libraries choose their instructions by. Processors of one name differ in it."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").split("\n\n")[0].splitlines()
    except OSError:  # not on Linux
        return {"processor": platform.processor()}
    facts = {name.strip(): value.strip() for name, _, value in (line.partition(":") for line in lines)}
    model = [facts.get(name, "?") for name in ("cpu family", "model", "stepping")]
    flags = [flag for flag in facts.get("flags", "").split() if flag.startswith(INSTRUCTIONS)]
    return {
        "processor": facts.get("model name", platform.machine()),
        "family, model, stepping": " ".join(model),
        "instructions": " ".join(sorted(flags)),
    }


def _commit() -> str:
    """The program's version and, where it runs from its repository, the commit, with a + where files of the
    program differ from it."""
    version = importlib.metadata.version("irl-bench")
    git = ["git", "-C", str(ROOT)]
    try:
        ask = functools.partial(subprocess.run, check=True, capture_output=True, text=True, timeout=10)
        commit = ask([*git, "rev-parse", "--short=10", "HEAD"]).stdout.strip()
        changed = ask([*git, "status", "--porcelain", "--", *PROGRAM, *EXPERTS[:1]]).stdout.strip()
    except (OSError, subprocess.SubprocessError):
        return version
    return f"{version} ({commit}{'+' if changed else ''})"
