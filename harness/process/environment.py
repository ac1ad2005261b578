"""Environment variables of processes that compute cells, and the folder of the cache.

Variables that numbers depend on are set here. Others are passed on where no number depends on them.
"""

from __future__ import annotations

import os
import traceback
from pathlib import Path

CACHE_VARIABLE = "IRL_BENCH_CACHE"
PASSED = {
    *("PATH", "HOME", "USER", "LOGNAME", "SHELL", "LANG", "LANGUAGE", "TZ", "TMPDIR"),
    *("LD_LIBRARY_PATH", "LD_PRELOAD", "VIRTUAL_ENV", "CONDA_PREFIX"),
    *("PYTHONPATH", "PYTHONHOME", "PYTHONUSERBASE", "PYTHONNOUSERSITE", "PYTHONDONTWRITEBYTECODE"),
    *("CUDA_VISIBLE_DEVICES", "NVIDIA_VISIBLE_DEVICES"),
}
PASSED_PREFIXES = ("LC_", "XDG_", "IRL_BENCH_")
FORMER = "IRL_BENCH_PLUGINS"
"""A variable of earlier versions, which named files to be executed."""
CHOSEN = (
    *("ATEN_CPU_CAPABILITY", "MKL_CBWR", "OPENBLAS_CORETYPE", "OPENBLAS_L2_SIZE"),
    *("NPY_DISABLE_CPU_FEATURES", "LD_PRELOAD"),
)
"""Numbers depend on these; the user may set them, for some processors need it, and they are part of every
key. Where instructions are fixed, by `SAME_INSTRUCTIONS`."""
NUMERIC_PREFIXES = (
    *("ATEN_", "BLIS_", "DNNL_", "FLAX_", "GLIBC_TUNABLES", "GOTO_", "JAX_", "KMP_", "MKL_", "NPY_", "OMP_"),
    *("ONEDNN_", "OPENBLAS_", "PYTORCH_", "TF_", "TORCH_", "XLA_"),
)
"""Beginnings of the names of variables that numeric libraries read. Isolated cells have none of them besides
those that are set here; of this process all are in the keys of what it computes itself."""
NO_NUMBER_PREFIXES = (
    *("JAX_COMPILATION_CACHE_", "JAX_PERSISTENT_CACHE_", "JAX_LOG", "JAX_TRACEBACK"),
    *("TF_CPP_", "TORCH_HOME"),
)
"""Beginnings of names among those that no number depends on; libraries set some of them on import."""
FIXED = {
    "OMP_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
    "MKL_NUM_THREADS": "1",
    "NPROC": "1",  # XLA's threads
    # XLA's programs of this level were equal to the last bit, and are compiled faster.
    "XLA_FLAGS": "--xla_cpu_multi_thread_eigen=false --xla_backend_optimization_level=2",
    "JAX_PLATFORMS": "cpu",
    "PYTHONHASHSEED": "0",
}
"""One thread, for processes that run side by side would only fight for the same cores; the processor,
whatever else there is; and one order of hashed strings."""
SAME_INSTRUCTIONS = {
    "ATEN_CPU_CAPABILITY": "avx2",
    "MKL_CBWR": "COMPATIBLE",
    "OPENBLAS_CORETYPE": "Haswell",
    # NumPy has the first three; before 2.4 it had others instead.
    "NPY_DISABLE_CPU_FEATURES": "X86_V4 AVX512_ICL AVX512_SPR AVX512F AVX512CD AVX512_SKX AVX512_CLX",
    "XLA_FLAGS": f"{FIXED['XLA_FLAGS']} --xla_cpu_max_isa=AVX2",
}
"""With these, libraries use the same instructions on all processors that have AVX2 and FMA3."""
_LOOKING_UP = type(os.environ).__getitem__.__code__.co_filename
TEXT = {"PYTHONUTF8": "1", "PYTHONIOENCODING": "utf-8:backslashreplace"}


def cache_folder() -> Path:
    """Return the folder of what is computed once and kept for other runs: the user's, unless the variable
    names another. A user without a home has it in the current folder."""
    if named := os.environ.get(CACHE_VARIABLE):
        return Path(named)
    caches = Path(os.environ.get("XDG_CACHE_HOME", ""))
    if not caches.is_absolute():
        caches = Path(os.path.expanduser("~/.cache"))
    return caches / "irl-bench" if caches.is_absolute() else Path("results") / "cache"


def can_fix_instructions() -> bool:
    """Return whether this processor has `SAME_INSTRUCTIONS`."""
    from numpy._core._multiarray_umath import __cpu_features__ as has  # type: ignore[import-not-found]

    return bool(has.get("AVX2") and has.get("FMA3"))


def numeric(deterministic: bool) -> dict[str, str]:
    """Return the variables that numbers depend on, as cells' processes have them. deterministic: with
    `SAME_INSTRUCTIONS`, where the processor has them."""
    chosen = {name: os.environ[name] for name in CHOSEN if name in os.environ}
    return chosen | FIXED | (SAME_INSTRUCTIONS if deterministic and can_fix_instructions() else {})


def of_this_process() -> dict[str, str]:
    """Return the variables of this process that numbers depend on."""
    return {name: value for name, value in sorted(os.environ.items()) if _is_numeric(name)}


def _is_numeric(name: str) -> bool:
    if name.startswith(NO_NUMBER_PREFIXES):
        return False
    return name in CHOSEN or name in FIXED or name.startswith(NUMERIC_PREFIXES)


def of_user() -> dict[str, str]:
    """Return the variables that the user gives to plug-ins, which are part of the keys of their cells."""
    theirs = {name for name in os.environ if name.startswith(PASSED_PREFIXES[-1])} - {CACHE_VARIABLE, FORMER}
    return {name: os.environ[name] for name in sorted(theirs)}


def is_set_for_cells(name: str) -> bool:
    """Return whether cells have a variable of this name, or libraries must not."""
    return _is_numeric(name) or name in PASSED or name in TEXT or name.startswith(PASSED_PREFIXES)


def of_cells(deterministic: bool) -> dict[str, str]:
    """Return the environment of processes that compute cells."""
    passed = {
        name: value
        for name, value in os.environ.items()
        if (name in PASSED or name.startswith(PASSED_PREFIXES)) and name != FORMER
    }
    return passed | numeric(deterministic) | TEXT


def hint(error: BaseException | None) -> str:
    """Return what helps where a variable of the environment was missing, '' for all other errors."""
    seen = list[BaseException]()
    while error is not None and error not in seen:
        seen.append(error)
        trace = traceback.extract_tb(error.__traceback__)
        if isinstance(error, KeyError) and trace and trace[-1].filename == _LOOKING_UP:
            return f"; cells get few variables: add --env-var {error.args[0]} (docs/plugins.md)"
        error = error.__cause__ or error.__context__
    return ""
