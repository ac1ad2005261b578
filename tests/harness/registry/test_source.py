"""What is computed is what the key says: one reading of the source, known packages, known variables."""

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

import pytest
from numpy._core._multiarray_umath import __cpu_features__

from harness.process.environment import (
    CHOSEN,
    FIXED,
    PASSED,
    PASSED_PREFIXES,
    SAME_INSTRUCTIONS,
    TEXT,
    numeric,
    of_this_process,
)
from harness.records import Cell
from harness.registry import keys
from harness.registry.keys import ROOT, cell_keys, expert_key, program
from harness.registry.ours import PROGRAM
from tests.harness.fake_runs import prepared
from tests.harness.registry.conftest import CONDITIONS

RUN = ["run", "--methods", "bc", "--envs", "gridworld", "--budget", "smoke", "--out", "run"]
RUN += ["--no-retrain", "--record", "none"]
CELL = Cell("cartpole", "bc", 0)
NUMBERS_DEPEND = {
    "JAX_ENABLE_X64": "1",
    "XLA_FLAGS": "--xla_cpu_enable_fast_math=true",
    "OMP_NUM_THREADS": "7",
    "NPY_DISABLE_CPU_FEATURES": "AVX2",
    "PYTHONHASHSEED": "7",
    "PYTHONOPTIMIZE": "2",
    "TF_ENABLE_ONEDNN_OPTS": "0",
    "ANOTHER_LIBRARYS_OWN": "1",
}


@pytest.fixture
def copy(tmp_path: Path) -> Path:
    """The program in a folder of its own, to be edited."""
    for package in PROGRAM:
        shutil.copytree(
            ROOT / package, tmp_path / "copy" / package, ignore=shutil.ignore_patterns("__pycache__")
        )
    return tmp_path / "copy"


def start(copy: Path, *arguments: str) -> subprocess.Popen[str]:
    env = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    env |= {"IRL_BENCH_CACHE": str(copy / "cache")}
    command = [sys.executable, "-m", "harness", *arguments]
    return subprocess.Popen(
        command, cwd=copy, env=env, text=True, stdout=subprocess.PIPE, stderr=subprocess.STDOUT
    )


def test_what_is_edited_counts_from_the_next_run_on_and_for_its_own_cells(copy: Path) -> None:
    """An editor has a file open all the while."""
    bc, registry = copy / "methods/bc.py", copy / "harness/registry/built_in.py"
    as_it_was = bc.read_text()
    (copy / "methods/.#bc.py").symlink_to("nobody@nowhere")
    process = start(copy, *RUN)
    assert process.stdout is not None
    assert "cells to run" in process.stdout.readline()
    bc.write_text(as_it_was + "\nraise RuntimeError('edited')\n")
    told, _ = process.communicate(timeout=120)
    assert process.returncode == 0, told
    again, _ = (process := start(copy, *RUN)).communicate(timeout=120)
    assert process.returncode == 1
    assert "computed by another version of the program" in again
    assert "RuntimeError: edited" in again
    # A new method computes its own cell, and others' files none of it.
    bc.write_text(as_it_was)
    (copy / "methods/mine.py").write_text("from methods.bc import BehaviourCloning\n")
    line = '"mine": Entry("methods.mine:BehaviourCloning", "mine"),'
    registry.write_text(registry.read_text().replace("METHODS = {", f"METHODS = {{ {line}", 1))
    for file in ("methods/maxent.py", "envs/balancing/cartpole.py", "harness/cli/main.py"):
        (copy / file).write_text((copy / file).read_text() + "\nEDITED = 1\n")
    told, _ = start(copy, "run", "--methods", "mine,bc", *RUN[3:], "--plan").communicate(timeout=120)
    assert "3 cells: 1 kept from before, in run; 0 of a baseline; 2 to run" in told


def test_instructions_are_fixed_only_where_the_processor_has_them(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(__cpu_features__, "AVX2", True)
    monkeypatch.setitem(__cpu_features__, "FMA3", True)
    assert numeric(True) == numeric(False) | SAME_INSTRUCTIONS
    monkeypatch.setitem(__cpu_features__, "AVX2", False)
    assert numeric(True) == numeric(False)


TELLS = f"""
import json, os
from harness.records import Cell, Conditions
from harness.process.environment import of_this_process
from harness.registry.keys import cell_keys

def prepare(cells, conditions):
    try:
        import methods.bc
        said = methods.bc.__file__
    except RuntimeError as error:
        said = str(error)
    keys = cell_keys([Cell("cartpole", "bc", 0)], {CONDITIONS!r}, of_this_process())
    told = {{"said": said, "key": [*keys.values()][0], "variables": dict(os.environ)}}
    return {{"told": json.dumps(told).encode()}}
"""


@pytest.fixture
def reading(copy: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """The copy as what this process takes for the program."""
    monkeypatch.setattr(keys, "ROOT", copy)
    program.cache_clear()
    yield copy
    program.cache_clear()


def test_cells_processes_import_what_the_key_was_made_of(reading: Path, tmp_path: Path) -> None:
    (reading / "methods/bc.py").write_text("raise RuntimeError('as it was read')")
    (key,) = cell_keys([CELL], CONDITIONS, numeric(True)).values()
    (reading / "methods/bc.py").write_text("raise RuntimeError('as it is now')")
    told = json.loads(prepared(tmp_path, TELLS)["told"])
    assert (told["said"], told["key"]) == ("as it was read", key)
    program.cache_clear()
    assert cell_keys([CELL], CONDITIONS, numeric(True)) != {CELL: key}


def test_of_variables_cells_have_only_what_changes_no_number(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, value in NUMBERS_DEPEND.items():
        monkeypatch.setenv(name, value)
    monkeypatch.setenv("LC_ALL", "C")
    variables = json.loads(prepared(tmp_path, TELLS)["told"])["variables"]
    ours = {*FIXED, *TEXT, "TMPDIR", "PYTHONPATH", "PYTHONSAFEPATH"}
    ours |= {"JAX_COMPILATION_CACHE_DIR", "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS"}
    others = {name for name in variables.keys() - PASSED - ours if not name.startswith(PASSED_PREFIXES)}
    # Some that libraries set when they are imported, here or there.
    set_by_libraries = {"PYGAME_HIDE_SUPPORT_PROMPT", "OTEL_SERVICE_NAME", "LINES", "COLUMNS"}
    set_by_libraries |= {"TPU_SKIP_MDS_QUERY", "TF_CPP_MIN_LOG_LEVEL"}
    assert others <= {*CHOSEN, *set_by_libraries}
    for name, value in NUMBERS_DEPEND.items():
        assert variables.get(name) != value, name
    assert variables["LC_ALL"] == "C"


@pytest.mark.parametrize("name", CHOSEN)
def test_what_users_may_choose_is_part_of_the_key(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    before = cell_keys([CELL], CONDITIONS, numeric(False)), expert_key("cartpole", None)
    monkeypatch.setenv(name, "another")
    after = cell_keys([CELL], CONDITIONS, numeric(False)), expert_key("cartpole", None)
    assert all(one != other for one, other in zip(before, after, strict=True))


@pytest.mark.parametrize(
    ("name", "counts"),
    [
        *((name, True) for name in ("JAX_ENABLE_X64", "MKL_DYNAMIC", "GLIBC_TUNABLES", "LD_PRELOAD")),
        *((name, False) for name in ("JAX_COMPILATION_CACHE_DIR", "TORCH_HOME", "TERM")),
    ],
)
def test_inline_what_libraries_read_of_this_process_is_part_of_the_key(
    name: str, counts: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = cell_keys([CELL], CONDITIONS, of_this_process())
    monkeypatch.setenv(name, "another")
    assert (cell_keys([CELL], CONDITIONS, of_this_process()) != before) == counts


def ran(folder: Path, words: Sequence[str], files: dict[str, str], path: str) -> tuple[int, str]:
    """Return the exit status and standard error of Python in a folder of these files."""
    for name, text in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text)
    env = {**os.environ, "PYTHONPATH": path}
    command = [sys.executable, *words]
    done = subprocess.run(command, cwd=folder, env=env, capture_output=True, text=True, check=False)
    return done.returncode, done.stderr


def test_packages_of_the_programs_names_are_found_after_it(tmp_path: Path) -> None:
    """They lie in a folder of PYTHONPATH that comes first."""
    files = {f"{package}/__init__.py": "raise SystemExit('theirs')" for package in PROGRAM}
    words = ["-c", "import irl_bench; exit(irl_bench.start())", "check", "gridworld"]
    assert ran(tmp_path, words, files, f"{tmp_path}{os.pathsep}{ROOT}") == (0, "")


def test_modules_of_the_current_folder_are_not_imported(tmp_path: Path) -> None:
    files = {f"{name}.py": "raise SystemExit('theirs')" for name in ("json", "random", "numpy", "signal")}
    assert ran(tmp_path, ["-m", "harness", "list"], files, str(ROOT)) == (0, "")
