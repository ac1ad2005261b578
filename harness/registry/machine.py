"""The machine and the versions that results are computed with, for people."""

from __future__ import annotations

import functools
import importlib.metadata
import platform
import subprocess
from pathlib import Path

from harness.records import PROGRAM_NAME
from harness.registry.keys import EXPERTS, PUBLIC, ROOT
from harness.registry.ours import PROGRAM
from harness.registry.packages import PACKAGES, versions

NO_NUMBERS = "It describes where numbers were computed."
INSTRUCTIONS = ("sse4", "avx", "fma", "amx")


@functools.cache
def origin() -> dict[str, str]:
    """Return the facts of `machine`, and the program's version."""
    return machine() | {PROGRAM_NAME: _commit()}


def machine() -> dict[str, str]:
    """Return the processor, the system and the versions that this process computes with."""
    system = f"{platform.system()} {platform.machine()} {' '.join(platform.libc_ver())}".strip()
    return {
        **_processor(),
        "system": system,
        PROGRAM_NAME: "",
        "python": platform.python_version(),
        **dict(zip(PACKAGES, versions(PACKAGES), strict=True)),
    }


def _processor() -> dict[str, str]:
    """Return what libraries choose their instructions by. Processors of one name differ in it."""
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
    """Return the version and, in a checkout, the commit, with a + where files differ from it."""
    version = importlib.metadata.version("irl-bench")
    git = ["git", "-C", str(ROOT)]
    try:
        ask = functools.partial(subprocess.run, check=True, capture_output=True, text=True, timeout=10)
        commit = ask([*git, "rev-parse", "--short=10", "HEAD"]).stdout.strip()
        changed = ask([*git, "status", "--porcelain", "--", *PROGRAM, PUBLIC, *EXPERTS[:1]]).stdout.strip()
    except (OSError, subprocess.SubprocessError):
        return version
    return f"{version} ({commit}{'+' if changed else ''})"
