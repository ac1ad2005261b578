"""What a plug-in may touch: its own cells, and nothing of the driver, of other cells, or of later runs."""

import json
import os
import subprocess
import sys
import textwrap
import time
from collections.abc import Callable
from contextlib import nullcontext
from pathlib import Path
from types import SimpleNamespace

import psutil
import pytest

from harness.api.preparing import Engine
from harness.cli import main as cli
from harness.engines import processes, ray
from harness.engines.compute import compute
from harness.engines.inline import Inline
from harness.engines.jobs import Job
from harness.process.environment import of_this_process
from harness.records import Cell
from harness.registry import KNOWN, SPECS, BadInput, keys, loading, packages, plugins, sources
from harness.registry.known import FILE_MODULE
from harness.schedule import plan
from harness.schedule.costs import Costs
from harness.schedule.grid import Grid
from harness.store.codec import decode
from harness.store.request import Request
from tests.harness.plugged import MINE
from tests.harness.registry.conftest import CONDITIONS
from tests.harness.small_runs import stored

OTHER = MINE.replace("mine", "other").replace("moon", "mars").replace("Mine", "Other")


@pytest.fixture
def both(tmp_path: Path, here: None) -> list[str]:
    """Two plug-ins that are known, and not imported here."""
    files = [tmp_path / f"{name}.py" for name in ("mine", "other")]
    for file, text in zip(files, (MINE, OTHER), strict=True):
        file.write_text(text)
    plugins.add([str(file) for file in files])
    for name in imported():
        del sys.modules[name]
    KNOWN.loaded.clear()
    SPECS.pop("moon", None)
    SPECS.pop("mars", None)
    return [str(file) for file in files]


def imported() -> list[str]:
    return sorted(name for name in sys.modules if name.startswith(FILE_MODULE))


def test_a_plugin_leaves_all_else_as_it_was(tmp_path: Path) -> None:
    """Beside the script lie packages called as this program's. The plug-in wraps a built-in method, and
    changes what numbers are of. A second run knows no plug-in of the first, and its cells are the same, key
    and score."""
    for name in ("envs", "methods", "harness"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "__init__.py").write_text("raise SystemExit('theirs')")
    (tmp_path / "hostile.py").write_text(
        MINE
        + textwrap.dedent("""
            import os, numpy, torch
            torch.set_default_dtype(torch.float64)
            numpy.seterr(all="raise")
            os.environ["JAX_ENABLE_X64"] = "1"
            still = lambda obs: numpy.tile(numpy.eye(5)[0], (len(obs), 1))
            BehaviourCloning.fit = lambda self, demos, world, rng: Learned(still, None)
        """)
    )
    (tmp_path / "script.py").write_text(
        textwrap.dedent("""
            from irl_bench import Engine, RunRequest, run
            asked = {"envs": ["gridworld"], "budget": "smoke", "retrain": False}
            run(RunRequest(methods=["bc", "mine"], plugins=["hostile.py"], **asked), Engine(workers=1), "one")
            run(RunRequest(methods=["bc"], **asked), Engine(workers=1), "two")
            try:
                run(RunRequest(methods=["mine"], **asked), store="three")
            except Exception as error:
                print(type(error).__name__, error)
        """)
    )
    env = {**os.environ, "IRL_BENCH_CACHE": str(tmp_path / "cache")}
    done = subprocess.run(
        [sys.executable, "script.py"], cwd=tmp_path, env=env, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[-1].startswith("BadInput no method named 'mine'")
    one, two = (decode(json.dumps(stored(tmp_path / run, "gridworld__bc__seed0"))) for run in ("one", "two"))
    assert one.rows[0].status == "ok"
    assert (one.key, one.rows[0].return_mean) == (two.key, two.rows[0].return_mean)
    hostile = decode(json.dumps(stored(tmp_path / "one", "gridworld__mine__seed0")))
    assert hostile.rows[0].status == "ok", hostile.rows[0].reason
    assert hostile.rows[0].return_mean != one.rows[0].return_mean


def test_a_job_needs_the_plugins_of_its_method_and_its_task(both: list[str]) -> None:
    cells = [Cell(env, method, 0) for env in ("swingup", "moon") for method in ("bc", "mine", "other")]
    grid = Grid(CONDITIONS, plan.Silent(), plan.Simulated(1, plan._unknown))
    jobs = grid.jobs(cells, Costs(CONDITIONS))
    assert {job.name: [Path(one.place).stem for one in job.plugins] for job in jobs} == {
        "swingup__expert__seed0": [],
        "swingup__bc__seed0": [],
        "swingup__mine__seed0": ["mine"],
        "swingup__other__seed0": ["other"],
        "moon__expert__seed0": ["mine"],
        "moon__bc__seed0": ["mine"],
        "moon__mine__seed0": ["mine"],
        "moon__other__seed0": ["mine", "other"],
    }
    assert not imported()


def test_a_cell_imports_the_plugins_that_its_job_needs(
    both: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    work = SimpleNamespace(prepare=lambda cells, conditions: {"imported": " ".join(imported()).encode()})
    monkeypatch.setitem(sys.modules, "work", work)
    for env, names in (("swingup", ""), ("mars", f"{FILE_MODULE}other")):
        key = keys.cell_keys([Cell(env, "reference", 0)], CONDITIONS, of_this_process())
        job = Job((Cell(env, "bc", 0),), True, CONDITIONS, *key.values(), plugins.needed([], [env]))
        assert compute("work", job).files == {"imported": names.encode()}


def test_the_process_that_cells_are_forked_from_imports_no_plugin(
    both: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(processes, "Processes", lambda workers, timeout, fixed, modules: modules)
    request = Request(("bc",), ("swingup", "moon"), (0,), CONDITIONS)
    assert Engine().for_request(request) == ["envs.swingups.swingup"]


def test_of_a_package_only_what_is_asked_for_is_imported(
    here: None, tmp_path: Path, key: Callable[..., str], monkeypatch: pytest.MonkeyPatch
) -> None:
    theirs = MINE.replace("steps: int = 30", "batch: int = 64")
    for name, text in (("theirs", theirs), ("theirs_too", "raise RuntimeError('imported')")):
        info = tmp_path / f"{name}-1.dist-info"
        info.mkdir()
        (tmp_path / f"{name}.py").write_text(text)
        (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1\n")
        (info / "entry_points.txt").write_text(f"[irl_bench.methods]\nof_{name} = {name}:Mine\n")
    monkeypatch.syspath_prepend(tmp_path)
    plugins.add([])
    assert {"of_theirs", "of_theirs_too"} <= KNOWN.of_plugins("method").keys()
    assert "theirs" not in sys.modules
    of_an_earlier_run = key("of_theirs")
    plugins.add([], ["bc,of_theirs"])
    assert key("of_theirs") == of_an_earlier_run
    assert plugins.settings_for("of_theirs", "swingup", "smoke") == {"steps": 200}
    with pytest.raises(BadInput, match="the method of_theirs_too cannot be loaded: RuntimeError: imported"):
        plugins.add([], ["of_theirs_too"])


def test_inline_cells_meet_no_plugin_but_their_own(both: list[str]) -> None:
    """Built-in cells come first. What cannot be put in order, or follows another plug-in, is refused."""
    cells = [Cell("swingup", method, seed) for seed in (0, 1) for method in ("mine", "bc")]
    jobs = Grid(CONDITIONS, plan.Silent(), Inline()).jobs(cells, Costs(CONDITIONS))
    assert [job.cells[0].method for job in jobs if not job.shared] == ["bc", "bc", "mine", "mine"]
    plugins.check_inline([(["bc"], "swingup"), (["mine"], "swingup"), (["mine"], "moon")])
    with pytest.raises(BadInput, match="name one plug-in at a time"):
        plugins.check_inline([(["mine"], "swingup"), (["other"], "swingup")])
    plugins.load(["mine"], [])
    plugins.check_inline([(["mine"], "swingup")])
    with pytest.raises(BadInput, match="the plug-in mine was imported in this process"):
        plugins.check_inline([(["bc"], "swingup")])
    Path(both[0]).write_text(f"{MINE}\nEDITED = 1\n")
    plugins.add(both[:1])
    with pytest.raises(BadInput, match="the plug-in mine was imported in this process"):
        plugins.check_inline([(["mine"], "swingup")])


def test_a_plugin_whose_helper_was_edited_is_not_computed_in_the_same_process(
    here: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Python executes a module once: the old code would be stored under the new key."""
    (tmp_path / "helped.py").write_text(f"import theirs_helper\n{MINE}")
    monkeypatch.syspath_prepend(str(tmp_path))
    for text in ("VALUE = 1", "VALUE = 2"):
        (tmp_path / "theirs_helper.py").write_text(text)
        with KNOWN.for_now():
            plugins.add([str(tmp_path / "helped.py")])
            refused = pytest.raises(BadInput, match="helped was imported in this process")
            with refused if text.endswith("2") else nullcontext():
                plugins.check_alone([], ["moon"])
            plugins.load([], ["moon"])


def test_experts_of_two_plugins_are_not_trained_in_one_process(
    both: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main(["experts", "train", "moon", "mars", "--budget", "smoke"]) == 2
    assert "train those of one at a time" in capsys.readouterr().err
    assert not imported()


ENDING = {
    "leaves": ("import os\nos._exit(0)", "ended its process while it was loaded (0)"),
    "crashes": ("import ctypes\nctypes.string_at(0)", "ended its process while it was loaded (-11)"),
    "hangs": ("import time\ntime.sleep(1000)", "was not loaded within 2 s"),
    "keyboard": ("raise KeyboardInterrupt", "cannot be loaded: KeyboardInterrupt"),
    "variable": ("import os\nos.environ['MY_DATA']", "KeyError: 'MY_DATA'; of the environment's"),
    "envs": ("import envs.of_mine", "'envs' is this program's package: give yours another name"),
}


@pytest.mark.parametrize("how", ENDING)
def test_however_a_plugin_ends_while_it_is_loaded_is_a_line(
    how: str, tmp_path: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    text, reason = ENDING[how]
    (tmp_path / "odd.py").write_text(text)
    monkeypatch.setenv("MY_DATA", "mine")
    monkeypatch.setattr(loading, "LONGEST", 2 if how == "hangs" else 100)
    assert cli.main(["list", "--plugin", str(tmp_path / "odd.py")]) == 2
    out, err = capfd.readouterr()
    assert (out, err.count("\n")) == ("", 1)
    assert reason in err


@pytest.mark.parametrize("then", ["", "import time; time.sleep(1000)"])
def test_nothing_that_a_plugin_starts_while_it_is_loaded_outlives_that(
    then: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    lines = [
        f"import subprocess\nfile = open({str(tmp_path / 'pid')!r}, 'w')",
        "print(subprocess.Popen(['sleep', '60'], start_new_session=True).pid, file=file)",
        "file.close()\nMETHODS = {}",
    ]
    (tmp_path / "starts.py").write_text("\n".join([*lines, then]))
    monkeypatch.setattr(loading, "LONGEST", 4 if then else 100)
    with pytest.raises(BadInput) if then else nullcontext():
        plugins.add([str(tmp_path / "starts.py")])
    pid = int((tmp_path / "pid").read_text())
    assert not psutil.pid_exists(pid) or psutil.Process(pid).status() == psutil.STATUS_ZOMBIE


def test_keys_of_many_methods_ask_no_distribution_twice(
    here: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    many = "METHODS = {f'm{i}': type(f'M{i}', (Mine,), {}) for i in range(66)}"
    (tmp_path / "many.py").write_text(f"import numpy, torch\n{MINE}\n{many}\n")

    def refused(*asked: object) -> None:
        raise AssertionError(f"{asked} was asked or walked")

    keys.program()
    monkeypatch.setattr(packages.importlib.metadata, "packages_distributions", refused)
    monkeypatch.setattr(sources, "_code_in", refused)
    read: list[Path] = []
    of_path = Path.read_bytes
    monkeypatch.setattr(Path, "read_bytes", lambda self: [read.append(self), of_path(self)][1])
    plugins.add([str(tmp_path / "many.py")])
    cells = [Cell("swingup", f"m{i}", 0) for i in range(66)]
    assert len(set(keys.cell_keys(cells, CONDITIONS, {}).values())) == 66
    assert len(read) < 66


def test_jobs_for_other_machines_name_plugins_where_they_were_copied(
    both: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    engine = object.__new__(ray.Ray)
    engine._packed = plugins.packed(tmp_path / "program")
    engine._running, engine._shared, engine._settings = {}, {}, None
    engine._begin = lambda sent, *rest: sent.plugins
    job = Job((Cell("moon", "other", 0),), False, CONDITIONS, "", plugins.needed(["other"], ["moon"]))
    engine._answered = time.monotonic()
    engine.submit(job)
    (sent,) = engine._running
    monkeypatch.chdir(tmp_path / "program")
    places = [Path(one.place) for one in plugins.unpacked(sent)]
    assert [place.read_text() for place in places] == [MINE, OTHER]
    assert all(place.is_relative_to(tmp_path / "program") for place in places)


def test_what_was_added_for_good_is_known_to_runs_and_what_a_run_names_is_not(both: list[str]) -> None:
    with KNOWN.for_now():
        plugins.add([os.path.relpath(both[0])])
        KNOWN.entries["method"].pop("other")
    assert {"mine", "other"} <= KNOWN.entries["method"].keys()
    assert plugins.needed(["mine"], [])[0].name == both[0]
