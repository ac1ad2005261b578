"""What a plug-in may touch: its own cells, and nothing of the driver, of other cells, or of later runs."""

import json
import os
import subprocess
import sys
import textwrap
from contextlib import nullcontext
from pathlib import Path
from types import SimpleNamespace

import psutil
import pytest

from harness.api.preparing import Engine
from harness.engines import processes
from harness.engines.compute import compute
from harness.engines.inline import Inline
from harness.engines.jobs import Job, Outcome
from harness.process.environment import of_this_process
from harness.records import Cell
from harness.registry import KNOWN, SPECS, BadInput, keys, loading, plugins
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
HOSTILE = """
import os, numpy, torch
torch.set_default_dtype(torch.float64)
numpy.seterr(all="raise")
os.environ["JAX_ENABLE_X64"] = "1"
still = lambda obs: numpy.tile(numpy.eye(5)[0], (len(obs), 1))
BehaviourCloning.fit = lambda self, demos, world, rng: Learned(still, None)
"""
SCRIPT = """
from irl_bench import Engine, RunRequest, run
asked = {"envs": ["gridworld"], "budget": "smoke", "retrain": False}
run(RunRequest(methods=["bc", "mine"], plugins=["hostile.py"], **asked), Engine(workers=1), "one")
run(RunRequest(methods=["bc"], **asked), Engine(workers=1), "two")
try:
    run(RunRequest(methods=["mine"], **asked), store="three")
except Exception as error:
    print(type(error).__name__, error)
"""


@pytest.fixture
def both(tmp_path: Path, here: None) -> None:
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


def imported() -> list[str]:
    return sorted(name for name in sys.modules if name.startswith(FILE_MODULE))


def test_a_plugin_leaves_all_else_as_it_was(tmp_path: Path) -> None:
    """Beside the script lie packages called as this program's. The plug-in wraps a built-in method, and
    changes what numbers are of. A second run knows no plug-in of the first, and its cells are the same, key
    and score."""
    for name in ("envs", "methods", "harness"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "__init__.py").write_text("raise SystemExit('theirs')")
    (tmp_path / "hostile.py").write_text(MINE + HOSTILE)
    (tmp_path / "script.py").write_text(SCRIPT)
    env = {**os.environ, "IRL_BENCH_CACHE": str(tmp_path / "cache")}
    done = subprocess.run(
        [sys.executable, "script.py"], cwd=tmp_path, env=env, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[-1].startswith("BadInput no method named 'mine'")
    one, two, hostile = (
        decode(json.dumps(stored(tmp_path / run, f"gridworld__{method}__seed0")))
        for run, method in (("one", "bc"), ("two", "bc"), ("one", "mine"))
    )
    assert one.rows[0].status == "ok"
    assert (one.key, one.rows[0].return_mean) == (two.key, two.rows[0].return_mean)
    assert hostile.rows[0].status == "ok", hostile.rows[0].reason
    assert hostile.rows[0].return_mean != one.rows[0].return_mean


def test_a_job_needs_the_plugins_of_its_method_and_its_task(both: None) -> None:
    cells = [Cell(env, method, 0) for env in ("swingup", "moon") for method in ("bc", "mine", "other")]
    grid = Grid(CONDITIONS, plan.Silent(), plan.Simulated(1, lambda job: (0.0, Outcome())))
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


def test_a_cell_imports_the_plugins_of_its_job_and_what_it_is_forked_from_none(
    both: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(processes, "Processes", lambda workers, timeout, fixed, modules: modules)
    request = Request(("bc",), ("swingup", "moon"), (0,), CONDITIONS)
    assert Engine().for_request(request) == ["envs.swingups.swingup"]
    work = SimpleNamespace(prepare=lambda cells, conditions: {"imported": " ".join(imported()).encode()})
    monkeypatch.setitem(sys.modules, "work", work)
    for env, names in (("swingup", ""), ("mars", f"{FILE_MODULE}other")):
        key = keys.cell_keys([Cell(env, "reference", 0)], CONDITIONS, of_this_process())
        job = Job((Cell(env, "bc", 0),), True, CONDITIONS, *key.values(), plugins.needed([], [env]))
        assert compute("work", job).files == {"imported": names.encode()}


def test_inline_cells_meet_no_plugin_but_their_own(both: None) -> None:
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


@pytest.mark.parametrize("then", ["", "import time; time.sleep(1000)"])
def test_nothing_that_a_plugin_starts_while_it_is_loaded_outlives_that(
    then: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    starts = f"""
        import subprocess
        with open({str(tmp_path / "pid")!r}, "w") as file:
            print(subprocess.Popen(["sleep", "60"], start_new_session=True).pid, file=file)
        METHODS = {{}}
    """
    (tmp_path / "starts.py").write_text(textwrap.dedent(starts) + then)
    monkeypatch.setattr(loading, "LONGEST", 4 if then else 100)
    with pytest.raises(BadInput) if then else nullcontext():
        plugins.add([str(tmp_path / "starts.py")])
    pid = int((tmp_path / "pid").read_text())
    assert not psutil.pid_exists(pid) or psutil.Process(pid).status() == psutil.STATUS_ZOMBIE
