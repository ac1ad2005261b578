"""What is computed is what the key says: one reading of the source, known packages, known variables."""

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
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
from harness.registry.keys import ROOT, RUNNING, cell_keys, expert_key, program, sources
from harness.registry.ours import PROGRAM
from tests.harness.fake_runs import compute, prepared
from tests.harness.registry.conftest import CONDITIONS

HERE = Path(__file__).parents[1]
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


@pytest.fixture
def reading(copy: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """The copy as what this process takes for the program."""
    monkeypatch.setattr(keys, "ROOT", copy)
    program.cache_clear()
    yield copy
    program.cache_clear()


def start(copy: Path, *arguments: str, **variables: str) -> subprocess.Popen[str]:
    env = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    env |= {"IRL_BENCH_CACHE": str(copy / "cache"), **variables}
    command = [sys.executable, "-m", "harness", *arguments]
    return subprocess.Popen(
        command, cwd=copy, env=env, text=True, stdout=subprocess.PIPE, stderr=subprocess.STDOUT
    )


def test_what_is_edited_counts_from_the_next_run_on_and_for_its_own_cells(copy: Path) -> None:
    """An editor has a file open all the while."""
    bc, registry = copy / "methods/bc.py", copy / "harness/registry/names.py"
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


TELLS = """
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
    keys = cell_keys([Cell("cartpole", "bc", 0)], CONDITIONS, of_this_process())
    told = {"said": said, "key": [*keys.values()][0], "variables": dict(os.environ)}
    return {"told": json.dumps(told).encode()}
"""


def told_by_a_cell(directory: Path) -> dict:
    """What a cell imports, and what its environment is."""
    return json.loads(prepared(directory, TELLS.replace("CONDITIONS", repr(CONDITIONS)))["told"])


def test_cells_processes_import_what_the_key_was_made_of(reading: Path, tmp_path: Path) -> None:
    (reading / "methods/bc.py").write_text("raise RuntimeError('as it was read')")
    (key,) = cell_keys([CELL], CONDITIONS, numeric(True)).values()
    (reading / "methods/bc.py").write_text("raise RuntimeError('as it is now')")
    told = told_by_a_cell(tmp_path)
    assert told["said"] == "as it was read"
    assert told["key"] == key
    program.cache_clear()
    assert cell_keys([CELL], CONDITIONS, numeric(True)) != {CELL: key}


def test_only_what_python_would_import_counts(reading: Path) -> None:
    before = sources(*RUNNING, "methods.bc"), expert_key("cartpole", None)
    (reading / "methods/.#bc.py").symlink_to("nobody@nowhere")
    (reading / "methods/gone.py").symlink_to("nowhere")
    (reading / "methods/folder.py").mkdir()
    (reading / "methods/bc copy.py").write_text("a copy")
    (reading / "methods/bc.py~").write_text("a backup")
    (reading / "methods/.bc.py.swp").write_bytes(b"\xff")
    (reading / "envs/notes.json").write_text("{}")
    (reading / "methods/__pycache__").mkdir()
    (reading / "methods/__pycache__/bc.cpython-311.pyc").write_bytes(b"")
    program.cache_clear()
    assert (sources(*RUNNING, "methods.bc"), expert_key("cartpole", None)) == before
    (reading / "methods/network.py").write_text("import methods.another\n")
    (reading / "methods/another.py").write_text("")
    program.cache_clear()
    assert "methods/another.py" in sources(*RUNNING, "methods.bc")
    assert expert_key("cartpole", None) != before[1]


def test_of_variables_cells_have_only_what_changes_no_number(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, value in NUMBERS_DEPEND.items():
        monkeypatch.setenv(name, value)
    monkeypatch.setenv("LC_ALL", "C")
    variables = told_by_a_cell(tmp_path)["variables"]
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
    before, here = cell_keys([CELL], CONDITIONS, numeric(False)), expert_key("cartpole", None)
    monkeypatch.setenv(name, "another")
    assert cell_keys([CELL], CONDITIONS, numeric(False)) != before
    assert expert_key("cartpole", None) != here
    assert of_this_process()[name] == "another"


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


def test_a_cell_that_finds_other_packages_than_its_run_is_a_failed_row(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("harness.schedule.grid.cell_keys", lambda cells, *_: dict.fromkeys(cells, "other"))
    found = compute(tmp_path, [Cell("cartpole", "good", 0)]).results
    assert "are not those that the run began with" in found[0].rows[0].reason


def test_packages_of_the_programs_names_are_found_after_it(tmp_path: Path) -> None:
    """They lie in a folder of PYTHONPATH that comes first."""
    for package in PROGRAM:
        (tmp_path / package).mkdir()
        (tmp_path / package / "__init__.py").write_text("raise SystemExit('theirs')")
    env = {**os.environ, "PYTHONPATH": f"{tmp_path}{os.pathsep}{ROOT}"}
    command = [
        sys.executable,
        "-c",
        "import irl_bench; exit(irl_bench.start())",
        "check",
        "gridworld",
    ]
    done = subprocess.run(command, cwd=tmp_path, env=env, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.parametrize("package", ["envs", "harness"])
def test_a_package_of_the_programs_name_that_is_imported_already_is_named(
    tmp_path: Path, package: str
) -> None:
    (tmp_path / package).mkdir()
    theirs = tmp_path / package / "__init__.py"
    theirs.write_text("")
    (tmp_path / "script.py").write_text(f"import {package}\nimport irl_bench\n")
    done = subprocess.run(
        [sys.executable, "script.py"], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert done.returncode == 1
    assert f"{theirs} hides this program's package {package!r}: rename it" in done.stderr.splitlines()[-1]


def test_modules_of_the_current_folder_are_not_imported(tmp_path: Path) -> None:
    for name in ("json", "random", "numpy", "signal"):
        (tmp_path / f"{name}.py").write_text("raise SystemExit('theirs')")
    env = {**os.environ, "PYTHONPATH": str(ROOT)}
    command = [sys.executable, "-m", "harness", "list"]
    done = subprocess.run(command, cwd=tmp_path, env=env, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.parametrize("package", ["msgspec", "jinja2"])
def test_a_package_that_cannot_be_imported_is_one_line_before_anything_is_written(
    tmp_path: Path, package: str
) -> None:
    (tmp_path / "broken" / package).mkdir(parents=True)
    (tmp_path / "broken" / package / "__init__.py").write_text("raise ImportError('half installed')")
    env = {**os.environ, "PYTHONPATH": f"{tmp_path / 'broken'}{os.pathsep}{ROOT}"}
    command = [sys.executable, "-m", "harness", *RUN]
    done = subprocess.run(command, cwd=tmp_path, env=env, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert "half installed" in done.stderr
    assert done.stderr.count("\n") == 1
    assert not (tmp_path / "run").exists()


def test_a_package_that_is_half_installed_is_one_line_and_nothing_is_written(tmp_path: Path) -> None:
    (tmp_path / "broken/torch-0.dist-info").mkdir(parents=True)
    env = {**os.environ, "PYTHONPATH": f"{tmp_path / 'broken'}{os.pathsep}{ROOT}"}
    command = [sys.executable, "-m", "harness", *RUN]
    done = subprocess.run(command, cwd=tmp_path, env=env, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert "the package torch is not installed, or only in part" in done.stderr
    assert not (tmp_path / "run").exists()
