"""What a plug-in may touch: its own cells, and nothing of the driver, of other cells, or of later runs."""

import dataclasses
import os
import subprocess
import sys
import textwrap
from collections.abc import Iterator
from contextlib import nullcontext
from pathlib import Path
from types import SimpleNamespace

import psutil
import pytest

from harness import cli, commands
from harness.arguments import parser
from harness.judge import effort
from harness.judge.results import Cell, CellResult, Conditions, Row
from harness.registry import PLUGINS, SPECS, VARIANTS, BadInput, load_method
from harness.run import cluster, environment, isolated, keys, plan, plugin_sources, plugins
from harness.run.codec import decode
from harness.run.costs import Costs
from harness.run.engines import Inline, Job, compute, describe
from harness.run.environment import of_this_process
from harness.run.grid import Grid
from methods.settings import settings_for
from tests.harness.plugged import MINE

CONDITIONS = Conditions("smoke", "absorbing", "sbx")
OTHER = MINE.replace("mine", "other").replace("moon", "mars").replace("Mine", "Other")


@pytest.fixture(autouse=True)
def forgotten() -> Iterator[None]:
    """What is made known here is forgotten again."""
    before = set(sys.modules)
    with plugins.for_now():
        yield
    for name in set(sys.modules) - before:
        if name.startswith((plugins.FILE_MODULE, "theirs")):
            del sys.modules[name]
    plugins._replaced.clear()


@pytest.fixture
def here(monkeypatch: pytest.MonkeyPatch) -> None:
    """Plug-ins are looked at in this process, for one of their own takes a second."""
    monkeypatch.setattr(plugins, "_in_a_process", plugins.look)


@pytest.fixture
def both(tmp_path: Path, here: None) -> list[str]:
    """Two plug-ins that are known, and not imported here."""
    for name, text in (("mine", MINE), ("other", OTHER)):
        (tmp_path / f"{name}.py").write_text(text)
    files = [str(tmp_path / f"{name}.py") for name in ("mine", "other")]
    plugins.add(files)
    for name in ("mine", "other"):
        del sys.modules[plugins.FILE_MODULE + name]
    SPECS.pop("moon", None)
    return files


def imported() -> list[str]:
    return sorted(name for name in sys.modules if name.startswith(plugins.FILE_MODULE))


def test_a_plugin_leaves_all_else_as_it_was(tmp_path: Path) -> None:
    """Beside the script lie packages called as this program's. The plug-in wraps a built-in method, and
    changes what numbers are of. The variable of earlier versions names a file. A second run knows no plug-in
    of the first, and its cells are the same, key and score."""
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
    (tmp_path / "evil.py").write_text("open('executed', 'w')")
    (tmp_path / "script.py").write_text(
        textwrap.dedent("""
            import irl_bench
            asked = {"envs": ["gridworld"], "budget": "smoke", "options": ["--no-retrain", "--workers", "1"]}
            irl_bench.run(["bc", "mine"], out="one", plugins=["hostile.py"], **asked)
            irl_bench.run(["bc"], out="two", **asked)
            try:
                irl_bench.run(["mine"], out="three", **asked)
            except Exception as error:
                print(type(error).__name__, error)
        """)
    )
    env = {**os.environ, "IRL_BENCH_CACHE": str(tmp_path / "cache")}
    env["IRL_BENCH_PLUGINS"] = f'[["evil.py", "{tmp_path / "evil.py"}"]]'
    done = subprocess.run(
        [sys.executable, "script.py"], cwd=tmp_path, env=env, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[-1].startswith("BadInput no method named 'mine'")
    assert not (tmp_path / "executed").exists()
    one, two = (
        decode((tmp_path / run / "cells/gridworld__bc__seed0.json").read_text()) for run in ("one", "two")
    )
    assert one.rows[0].status == "ok"
    assert (one.key, one.rows[0].return_mean) == (two.key, two.rows[0].return_mean)
    its = decode((tmp_path / "one/cells/gridworld__mine__seed0.json").read_text())
    assert its.rows[0].status == "ok", its.rows[0].reason
    assert its.rows[0].return_mean != one.rows[0].return_mean


def test_a_job_needs_the_plugins_of_its_method_and_its_task(both: list[str]) -> None:
    cells = [Cell(env, method, 0) for env in ("swingup", "moon") for method in ("bc", "mine", "other")]
    silent = plan.Silent()
    grid = Grid(CONDITIONS, silent, plan.Simulated(1, plan._unknown))
    needs = {
        job.name: [Path(one.place).stem for one in job.plugins] for job in grid.jobs(cells, Costs(CONDITIONS))
    }
    assert needs == {
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
    for env, its in (("swingup", ""), ("mars", f"{plugins.FILE_MODULE}other")):
        key = keys.cell_keys([Cell(env, "reference", 0)], CONDITIONS, of_this_process())
        job = Job((Cell(env, "bc", 0),), True, CONDITIONS, *key.values(), plugins.needed([], [env]))
        assert compute("work", job).files == {"imported": its.encode()}


def test_the_process_that_cells_are_forked_from_imports_no_plugin(
    both: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(isolated, "Isolated", lambda workers, timeout, fixed, modules: modules)
    args = parser().parse_args(["run"])
    assert commands._engine(args, ["swingup", "moon"]) == ["envs.swingups.swingup"]


@pytest.mark.usefixtures("here")
def test_of_a_package_only_what_is_asked_for_is_imported(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    theirs = MINE.replace("steps: int = 30", "batch: int = 64")
    for name, text in (("theirs", theirs), ("theirs_too", "raise RuntimeError('imported')")):
        (tmp_path / f"{name}.py").write_text(text)
        (tmp_path / f"{name}-1.dist-info").mkdir()
        (tmp_path / f"{name}-1.dist-info/METADATA").write_text(
            f"Metadata-Version: 2.1\nName: {name}\nVersion: 1\n"
        )
        (tmp_path / f"{name}-1.dist-info/entry_points.txt").write_text(
            f"[irl_bench.methods]\nof_{name} = {name}:Mine\n"
        )
    monkeypatch.syspath_prepend(tmp_path)
    plugins.add([])
    assert {"of_theirs", "of_theirs_too"} <= PLUGINS["method"].keys()
    assert "theirs" not in sys.modules
    cell = Cell("swingup", "of_theirs", 0)
    of_an_earlier_run = keys.cell_keys([cell], CONDITIONS, {})
    plugins.add([], ["bc,of_theirs"])
    assert keys.cell_keys([cell], CONDITIONS, {}) == of_an_earlier_run
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
    Path(both[0]).write_text(MINE + "# edited\n")
    plugins.add(both[:1])
    with pytest.raises(BadInput, match="the plug-in mine was imported in this process"):
        plugins.check_inline([(["mine"], "swingup")])


@pytest.mark.usefixtures("here")
def test_a_plugin_whose_helper_was_edited_is_not_computed_in_the_same_process(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Python executes a module once: the old code would be stored under the new key."""
    (tmp_path / "theirs_helper.py").write_text("VALUE = 1")
    (tmp_path / "helped.py").write_text(f"import theirs_helper\n{MINE}")
    monkeypatch.syspath_prepend(str(tmp_path))
    for text, is_refused in (("VALUE = 1", False), ("VALUE = 2", True)):
        (tmp_path / "theirs_helper.py").write_text(text)
        with plugins.for_now():
            plugins.add([str(tmp_path / "helped.py")])
            if is_refused:
                with pytest.raises(BadInput, match="helped was imported in this process"):
                    plugins.check_alone(["bc"], ["moon"])
            else:
                plugins.check_alone(["bc"], ["moon"])
                plugins.load([], ["moon"])


def test_an_inline_run_after_a_plugin_is_refused_before_anything_is_written(
    both: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    plugins.load(["mine"], [])
    out = tmp_path / "run"
    asked = ["run", "--methods", "bc", "--envs", "gridworld", "--budget", "smoke", "--out", str(out)]
    assert cli.main([*asked, "--engine", "inline"]) == 2
    assert "the plug-in mine was imported in this process" in capsys.readouterr().err
    assert not out.exists()


def test_experts_of_two_plugins_are_not_trained_in_one_process(
    both: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main(["experts", "train", "moon", "mars", "--budget", "smoke"]) == 2
    assert "train those of one at a time" in capsys.readouterr().err
    assert not imported()


ENDING = {
    "leaves": ("import os\nos._exit(0)", "ended its process while it was loaded: exit code 0"),
    "crashes": (
        "import ctypes\nctypes.string_at(0)",
        "ended its process while it was loaded: killed by SIGSEGV",
    ),
    "hangs": ("import time\ntime.sleep(1000)", "was not loaded within 2 s"),
    "memory": (
        "import resource\nbytearray(resource.getrlimit(resource.RLIMIT_DATA)[0])",
        "cannot be loaded: MemoryError",
    ),
    "out of memory": (
        "import os, signal\nos.kill(os.getpid(), signal.SIGKILL)",
        "ended its process while it was loaded: killed by SIGKILL (out of memory?)",
    ),
    "keyboard": ("raise KeyboardInterrupt", "cannot be loaded: KeyboardInterrupt"),
    "variable": (
        "import os\nos.environ['MY_DATA']",
        "cannot be loaded: KeyError: 'MY_DATA'; of the environment's",
    ),
    "envs": ("import envs.of_mine", "'envs' is this program's package: give yours another name"),
}


@pytest.mark.parametrize("how", ENDING)
def test_however_a_plugin_ends_while_it_is_loaded_is_a_line(
    how: str, tmp_path: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    text, said = ENDING[how]
    (tmp_path / "odd.py").write_text(text)
    monkeypatch.setenv("MY_DATA", "mine")
    monkeypatch.setattr(plugins, "LONGEST", 2 if how == "hangs" else 100)
    assert cli.main(["list", "--plugin", str(tmp_path / "odd.py")]) == 2
    out, err = capfd.readouterr()
    assert (out, err.count("\n")) == ("", 1)
    assert said in err


@pytest.mark.skipif(sys.platform != "linux", reason="the system gives orphans to nobody here")
@pytest.mark.parametrize("then", ["", "import os; os._exit(0)", "import time; time.sleep(1000)"])
def test_nothing_that_a_plugin_starts_while_it_is_loaded_outlives_that(
    then: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    lines = [
        f"import subprocess\nfile = open({str(tmp_path / 'pid')!r}, 'w')",
        "print(subprocess.Popen(['sleep', '60'], start_new_session=True).pid, file=file)",
        "file.close()\nMETHODS = {}",
    ]
    (tmp_path / "starts.py").write_text("\n".join([*lines, then]))
    monkeypatch.setattr(plugins, "LONGEST", 4 if "sleep" in then else 100)
    with pytest.raises(BadInput) if then else nullcontext():
        plugins.add([str(tmp_path / "starts.py")])
    pid = int((tmp_path / "pid").read_text())
    assert not psutil.pid_exists(pid) or psutil.Process(pid).status() == psutil.STATUS_ZOMBIE


def test_variables_that_cells_lack_are_named_where_one_is_missing(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("MY_DATA", "IRL_BENCH_MY_DATA", "IRL_BENCH_PLUGINS", "IRL_BENCH_CACHE"):
        monkeypatch.setenv(name, "here")
    given = environment.of_cells(True)
    assert ("MY_DATA" in given, "IRL_BENCH_PLUGINS" in given) == (False, False)
    assert environment.of_user() == {"IRL_BENCH_MY_DATA": "here"}
    for mapping, is_told in ((os.environ, True), ({}, False)):
        with pytest.raises(KeyError) as raised:
            mapping["NOT_THERE"]
        told = describe(raised.value)
        assert ("cells have only LC_*, XDG_*, IRL_BENCH_*, CONDA_PREFIX, " in told) == is_told


@pytest.mark.usefixtures("here")
def test_a_variable_of_the_user_is_part_of_the_keys_of_plugins(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "mine.py").write_text(MINE)
    plugins.add([str(tmp_path / "mine.py")])
    cells = [Cell("swingup", "mine", 0), Cell("swingup", "bc", 0)]
    before = keys.cell_keys(cells, CONDITIONS, {})
    monkeypatch.setenv("IRL_BENCH_RATE", "1")
    after = keys.cell_keys(cells, CONDITIONS, {})
    assert [before[cell] == after[cell] for cell in cells] == [False, True]


@pytest.mark.usefixtures("here")
def test_a_check_has_the_variables_of_cells(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("MY_DATA", "mine")
    fit = "\n\n    def fit(self, demos, world, rng):\n        import os; os.environ['MY_DATA']"
    (tmp_path / "mine.py").write_text(MINE.replace("steps: int = 30", f"steps: int = 30{fit}"))
    assert cli.main(["check", "mine", "--plugin", str(tmp_path / "mine.py")]) == 1
    assert "KeyError: 'MY_DATA'; of the environment's variables cells have only " in capsys.readouterr().out
    assert os.environ["MY_DATA"] == "mine"


SUBCLASSES = """
from dataclasses import dataclass, make_dataclass
from methods.adversarial import Game
from methods.airl import AIRL
from methods.bc import BehaviourCloning
from methods.gail import GAIL
from methods.maxmargin import MaxMargin

@dataclass(frozen=True)
class Rate(GAIL):
    learning_rate: float = 1e-4

@dataclass(frozen=True)
class Long(GAIL):
    iterations: int = 30

class Plain(GAIL): ...

class Init(GAIL):
    def __init__(self, rl_share=0.077, final_share=0.5):
        super().__init__(rl_share=rl_share, final_share=final_share)

@dataclass(frozen=True)
class Mine(Game):
    def fit(self, demos, world, rng): ...

class Unlike:
    iterations = 3
    def fit(self, demos, world, rng): ...

METHODS = {"rate": Rate, "long": Long, "plain": Plain, "init": Init, "game": Mine, "unlike": Unlike,
           "itself": GAIL, "airl_itself": AIRL, "margin": type("Margin", (MaxMargin,), {}),
           "made": make_dataclass("Made", [("batch", int, 7)], bases=(BehaviourCloning,), frozen=True)}
"""


@pytest.mark.usefixtures("here")
@pytest.mark.parametrize(
    ("env", "budget"), [("swingup", "smoke"), ("hopper", "full"), ("gridworld", "quick")]
)
def test_what_derives_from_a_method_gets_its_settings(tmp_path: Path, env: str, budget: str) -> None:
    (tmp_path / "subclasses.py").write_text(SUBCLASSES)
    plugins.add([str(tmp_path / "subclasses.py")])
    gail, airl = settings_for("gail", env, budget), settings_for("airl", env, budget)
    of = lambda name: plugins.settings_for(name, env, budget)  # noqa: E731
    assert of("rate") == of("plain") == of("itself") == gail
    assert of("long") == {name: value for name, value in gail.items() if name != "iterations"}
    assert of("init") == {name: value for name, value in gail.items() if name == "final_share"}
    assert of("game") == {name: value for name, value in gail.items() if airl.get(name) == value}
    assert of("airl_itself") == airl
    assert of("margin") == settings_for("maxmargin", env, budget)
    assert of("made") == settings_for("bc", env, budget)
    assert of("unlike") == {}
    for name in PLUGINS["method"]:
        load_method(name)(**of(name))
    more = plugins.times_as_many("long", env, budget)
    assert (more > effort.MOST) == (budget == "smoke")
    assert plugins.times_as_many("rate", env, budget) == plugins.times_as_many("made", env, budget) == 1


@pytest.mark.usefixtures("here")
def test_settings_of_the_original_are_part_of_the_key(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from methods import settings

    (tmp_path / "subclasses.py").write_text(SUBCLASSES)
    plugins.add([str(tmp_path / "subclasses.py")])
    cells = [Cell("swingup", name, 0) for name in ("rate", "long", "unlike")]
    before = keys.cell_keys(cells, CONDITIONS, {})
    more = (("gail", "gail_mean", "gail_mean_state"), settings.ANY, settings.ANY, {"iterations": 2})
    monkeypatch.setattr(settings, "SETTINGS", [*settings.SETTINGS, more])
    after = keys.cell_keys(cells, CONDITIONS, {})
    assert [before[cell] == after[cell] for cell in cells] == [False, True, True]


def result(method: str, steps: int, like: list[str] | None = None, env: str = "swingup") -> CellResult:
    row = Row(env, method, 0, "pi_star", "absorbing", env_steps=steps, check_steps=100)
    return CellResult(Cell(env, method, 0), [row], like=like or [])


@pytest.mark.parametrize(
    ("results", "said"),
    [
        ([result("gail", 900), result("mine", 2900, ["gail"])], ""),
        (
            [result("gail", 900), result("mine", 2901, ["gail"])],
            "mine in swingup took 3,001 .* 1,000 of gail:",
        ),
        ([result("gail", 900), result("airl", 9000)], ""),
        ([result("mine", 36_236, ["gail"])], ""),
        ([result("mine", 7000)], ""),
        ([result("mine", 36_236)], "mine in swingup took 36,236 .* of RL at this budget:"),
        ([result("gail", 20_000), result("mine", 36_236)], ""),
        (
            [result("bc", 0), result("mine", 36_236, ["bc"])],
            "took 36,236 .* of RL at this budget:|100 of bc:",
        ),
        ([result("bc", 0, env="moon"), result("mine", 36_236, env="moon")], ""),
    ],
)
def test_a_method_that_takes_many_more_steps_is_told(results: list[CellResult], said: str) -> None:
    import re

    found = effort.warnings(results, "smoke")
    assert len(found) == bool(said)
    assert all(re.search(said, line) for line in found), found


@pytest.mark.usefixtures("here")
def test_keys_of_many_methods_ask_no_distribution_twice(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """66 methods in a file that imports torch took 12 minutes before the first cell."""
    many = "METHODS = {f'm{i}': type(f'M{i}', (Mine,), {}) for i in range(66)}"
    (tmp_path / "many.py").write_text(f"import numpy, torch\n{MINE}\n{many}\n")

    def asked() -> dict[str, list[str]]:
        raise AssertionError("all distributions were asked")

    def walked(folder: Path) -> Iterator[tuple[Path, str]]:
        raise AssertionError(f"{folder} was walked")

    keys.program()
    plugins._packages("Pendulum-v1")  # which ask and read once in a process
    monkeypatch.setattr(plugin_sources.importlib.metadata, "packages_distributions", asked)
    monkeypatch.setattr(plugin_sources, "_files", walked)
    read: list[Path] = []
    of_path = Path.read_bytes
    monkeypatch.setattr(Path, "read_bytes", lambda self: [read.append(self), of_path(self)][1])
    plugins.add([str(tmp_path / "many.py")])
    cells = [Cell("swingup", f"m{i}", 0) for i in range(66)]
    assert len(set(keys.cell_keys(cells, CONDITIONS, {}).values())) == 66
    assert len(read) < 66


@pytest.mark.usefixtures("here")
def test_links_to_sub_packages_of_plugins_are_followed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Into keys, and onto other machines; but not around in a circle."""
    (tmp_path / "elsewhere/sub").mkdir(parents=True)
    (tmp_path / "elsewhere/sub/deep.py").write_text("VALUE = 1")
    (tmp_path / "theirs").mkdir()
    (tmp_path / "theirs/__init__.py").write_text(MINE)
    (tmp_path / "theirs/sub").symlink_to(tmp_path / "elsewhere/sub")
    (tmp_path / "theirs/around").symlink_to(tmp_path / "theirs")
    (tmp_path / "theirs/gone").symlink_to(tmp_path / "nowhere")
    monkeypatch.syspath_prepend(str(tmp_path))
    plugins.add(["theirs"])
    cell = Cell("swingup", "mine", 0)
    before = keys.cell_keys([cell], CONDITIONS, {})
    (tmp_path / "elsewhere/sub/deep.py").write_text("VALUE = 2")
    plugins.add(["theirs"])
    assert keys.cell_keys([cell], CONDITIONS, {}) != before
    (there,) = plugins.packed(tmp_path / "program").values()
    assert (tmp_path / "program" / there.place / "theirs/sub/deep.py").read_text() == "VALUE = 2"
    assert not (tmp_path / "program" / there.place / "theirs/around").exists()


def test_jobs_for_other_machines_name_plugins_where_they_were_copied(
    both: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    engine = object.__new__(cluster.Ray)
    engine._packed = plugins.packed(tmp_path / "program")
    engine._running, engine._shared, engine._how = {}, {}, None
    engine._begin = lambda sent, *rest: sent.plugins
    job = Job((Cell("moon", "other", 0),), False, CONDITIONS, "", plugins.needed(["other"], ["moon"]))
    engine._launch(cluster._Task(job))
    (sent,) = engine._running
    monkeypatch.chdir(tmp_path / "program")
    places = [Path(one.place) for one in plugins.unpacked(sent)]
    assert [place.read_text() for place in places] == [MINE, OTHER]
    assert all(place.is_relative_to(tmp_path / "program") for place in places)


def test_what_was_added_for_good_is_known_to_runs_and_what_a_run_names_is_not(both: list[str]) -> None:
    with plugins.for_now():
        plugins.add([os.path.relpath(both[0])])
        plugins._forget(plugins._named[1])
        assert "other" not in VARIANTS
    assert {"mine", "other"} <= VARIANTS.keys()
    assert dataclasses.astuple(plugins.needed(["mine"], [])[0])[0] == both[0]
