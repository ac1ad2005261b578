"""Methods and tasks of others: named, installed, broken, computed, and never mistaken for one another."""

import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import gymnasium
import msgspec
import pandas as pd
import pytest
from gymnasium.envs.registration import EnvSpec, WrapperSpec

from harness import registry
from harness.cli import main
from harness.judge.results import Cell, CellResult, Conditions
from harness.registry import SPECS, VARIANTS, BadInput, load_method
from harness.run import keys, plugins
from harness.run.engines import Job, compute, describe
from harness.run.environment import of_this_process
from harness.registry.known import Plugin
from tests.harness import fake_cells
from tests.harness.plugged import MINE

CONDITIONS = Conditions("smoke", "absorbing", "sbx")


@pytest.fixture(autouse=True)
def registered(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """What is made known here is forgotten again."""
    before = set(sys.modules)
    monkeypatch.setattr(plugins, "_in_a_process", plugins.look)  # a process takes a second
    with plugins.for_now():
        yield
    for name in set(sys.modules) - before:
        if name.startswith((plugins.FILE_MODULE, "theirs", "its_helper", "far_")):
            del sys.modules[name]
    plugins._replaced.clear()


@pytest.fixture
def mine(tmp_path: Path) -> Path:
    (tmp_path / "mine.py").write_text(MINE)
    return tmp_path / "mine.py"


def key(cell: Cell) -> str:
    return keys.cell_keys([cell], CONDITIONS, {})[cell]


def test_a_key_is_of_what_a_plugin_imports(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Modules beside it, packages, and this program's; not what is installed, whose version counts. What is
    edited counts when it is named again, or in a cell."""
    (tmp_path / "theirs").mkdir()
    (tmp_path / "theirs/__init__.py").write_text("")
    (tmp_path / "theirs/deep.py").write_text("from its_helper import VALUE")
    (tmp_path / "its_helper.py").write_text("VALUE = 1")
    (tmp_path / "imports.py").write_text(f"import theirs.deep\n{MINE}")
    monkeypatch.syspath_prepend(str(tmp_path))
    plugins.add([str(tmp_path / "imports.py")])
    cell, program = Cell("swingup", "mine", 0), keys.program()
    before = key(cell)
    for file in ("its_helper.py", "theirs/deep.py", "theirs/__init__.py"):
        was = (tmp_path / file).read_text()
        (tmp_path / file).write_text(f"{was}\nMORE = 1\n")
        plugins.add([str(tmp_path / "imports.py")])
        assert key(cell) != before, file
        (tmp_path / file).write_text(was)
    plugins.add([str(tmp_path / "imports.py")])
    assert key(cell) == before
    for file, counts in (("methods/bc.py", True), ("methods/gail.py", False), ("harness/frames.py", False)):
        edited = program | {file: program[file] + b"\nMORE = 1\n"}
        monkeypatch.setattr(keys, "program", lambda edited=edited: edited)
        assert (key(cell) != before) == counts, file


def test_a_file_that_was_edited_is_read_anew(mine: Path) -> None:
    """As from a notebook, in one process."""
    plugins.add([str(mine)])
    assert SPECS["moon"].name == "moon"
    mine.write_text(MINE.replace("steps: int = 30", "steps: int = 40"))
    plugins.add([str(mine)])
    assert load_method("mine")().steps == 40


RAISING = {
    "exits": "raise SystemExit(0)",
    "leaves": "raise GeneratorExit('no')",
    "odd": "class Odd(BaseException): ...\nraise Odd('no')",
    "mute": "class Mute(Exception):\n    def __str__(self): raise ValueError\nraise Mute",
    "attributes": "def __getattr__(name): raise ValueError('no')",
    "table": "class D(dict):\n    def items(self): raise ValueError\nMETHODS = D(a=1)",
    "repr": "class R:\n    def __repr__(self): raise ValueError\nMETHODS = {'mine': R()}",
}


@pytest.mark.parametrize("how", RAISING)
def test_whatever_a_plugin_raises_is_a_line(
    how: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / f"{how}.py").write_text(RAISING[how])
    assert main(["list", "--plugin", str(tmp_path / f"{how}.py")]) == 2
    err = capsys.readouterr().err
    assert err.startswith("irl-bench: error: the plug-in ")
    assert err.count("\n") == 1


def test_what_a_plugin_prints_while_it_is_loaded_goes_to_standard_error(
    mine: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Standard output may be read by a program."""
    mine.write_text(f"print('hello')\n{MINE}")
    assert main(["list", "--plugin", str(mine)]) == 0
    out, err = capsys.readouterr()
    assert ("hello" in out, err) == (False, "hello\n")


def test_a_method_that_exits_fails_its_check(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    text = MINE.replace(
        "    steps: int = 30", "    def fit(self, demos, world, rng):\n        raise SystemExit(0)"
    )
    (tmp_path / "exits.py").write_text(text)
    assert main(["check", "mine", "--plugin", str(tmp_path / "exits.py")]) == 1
    assert "FAILED  mine: " in capsys.readouterr().out


def test_a_files_methods_and_tasks_are_known_and_not_part_of_all(mine: Path) -> None:
    plugins.add([str(mine)])
    assert load_method("mine").__name__ == "Mine"
    assert SPECS["moon"].name == "moon"
    assert "mine" not in registry.choose("method", "all", registry.METHODS, VARIANTS)
    assert plugins.needed(["mine"], []) == plugins.needed([], ["moon"]) == (Plugin(str(mine), str(mine)),)
    assert not plugins.needed(["bc"], ["swingup"])
    plugins.add([str(mine)])  # once more


def test_of_a_task_that_is_not_imported_it_is_known_how_rl_takes_place(mine: Path) -> None:
    plugins.add([str(mine)])
    told, spec = plugins.task("moon"), SPECS["moon"]
    assert isinstance(told, plugins.Offer)
    for name in ("discrete", "rl_steps", "ddpg_steps", "solves"):
        assert getattr(told, name) == getattr(spec, name)
    assert plugins.task("swingup") is SPECS["swingup"]


def test_a_key_is_of_the_plugins_source_and_of_no_others(mine: Path) -> None:
    plugins.add([str(mine)])
    cells = [Cell("swingup", "mine", 0), Cell("moon", "bc", 0), Cell("swingup", "bc", 0)]
    before = [key(cell) for cell in cells]
    mine.write_text(MINE + "# edited\n")
    plugins.add([str(mine)])
    after = [key(cell) for cell in cells]
    assert [a == b for a, b in zip(after, before, strict=True)] == [False, False, True]
    assert keys.task_of(before[0]) == keys.task_of(before[2]) == keys.task_of(after[0])


def test_a_plugin_that_is_edited_while_a_run_goes_on_computes_nothing_more(mine: Path) -> None:
    plugins.add([str(mine)])
    cell = Cell("swingup", "mine", 0)
    (its_key,) = keys.cell_keys([cell], CONDITIONS, of_this_process()).values()
    mine.write_text(MINE + "# edited\n")
    with pytest.raises(RuntimeError, match="are not those that the run began with"):
        compute("harness.run.cells", Job((cell,), False, CONDITIONS, its_key, plugins.needed(["mine"], [])))


def test_of_what_is_imported_late_it_is_said_why_the_cell_does_not_count(
    tmp_path: Path, mine: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    mine.write_text(f"{MINE}\ndef late():\n    import found_late")
    (tmp_path / "late").mkdir()
    (tmp_path / "late/found_late.py").write_text("")
    plugins.add([str(mine)])
    cell = Cell("swingup", "mine", 0)
    (its_key,) = keys.cell_keys([cell], CONDITIONS, of_this_process()).values()

    def run_cell(*asked: object) -> tuple[CellResult, dict[str, bytes]]:
        monkeypatch.syspath_prepend(str(tmp_path / "late"))
        return fake_cells.faked(cell, CONDITIONS, tmp_path), {}

    monkeypatch.setattr(fake_cells, "run_cell", run_cell)
    job = Job((cell,), False, CONDITIONS, its_key, plugins.needed(["mine"], []))
    with pytest.raises(RuntimeError) as raised:
        compute("tests.harness.fake_cells", job)
    assert "change sys.path and then import from there? Do that as the module is imported." in describe(
        raised.value
    )


BROKEN = {
    "syntax": ("def broken(:", "cannot be loaded: SyntaxError"),
    "raises": ("1 / 0", "cannot be loaded: ZeroDivisionError"),
    "exits": ("import sys; sys.exit(3)", "cannot be loaded: SystemExit"),
    "import": ("import nowhere_to_be_found", "cannot be loaded: ModuleNotFoundError"),
    "nothing": ("", "says neither METHODS nor ENVS"),
    "no dict": ("METHODS = 3", "METHODS must be a dict"),
    "no class": ("METHODS = {'mine': 3}", "must be a class with a method fit, not 3"),
    "no fit": ("class A: ...\nMETHODS = {'mine': A}", "must be a class with a method fit"),
    "no default": (
        "class A:\n fit = print\n def __init__(self, steps, *, rate, **more): ...\nMETHODS = {'mine': A}",
        "the method mine has no default for steps, rate",
    ),
    "shadows": ("class A:\n fit = print\nMETHODS = {'bc': A}", "'bc': the name is this program's"),
    "control": ("class A:\n fit = print\nMETHODS = {'control_x': A}", "the name is this program's"),
    "all": ("class A:\n fit = print\nMETHODS = {'all': A}", "the name is this program's"),
    "odd name": ("class A:\n fit = print\nMETHODS = {'a b': A}", "'a b' is no name of methods"),
    "two parts": ("class A:\n fit = print\nMETHODS = {'a__b': A}", "'a__b' is no name of methods"),
    "no spec": ("ENVS = {'moon': 3}", "must be an EnvSpec of that name, not 3"),
    "other name": (
        MINE.replace('"moon": from', '"mars": from'),
        "the env mars must be an EnvSpec of that name",
    ),
}


@pytest.mark.parametrize("how", BROKEN)
def test_a_broken_plugin_is_one_line_and_nothing_is_written(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], how: str
) -> None:
    text, reason = BROKEN[how]
    (tmp_path / "odd.py").write_text(text)
    out = tmp_path / "run"
    assert main(["run", "--plugin", str(tmp_path / "odd.py"), "--methods", "bc", "--out", str(out)]) == 2
    err = capsys.readouterr().err
    assert reason in err
    assert err.count("\n") == 1
    assert not out.exists()


def test_what_is_no_plugin_is_said(tmp_path: Path) -> None:
    for name in ("nowhere.py", str(tmp_path / "folder.py"), "no_such_module"):
        (tmp_path / "folder.py").mkdir(exist_ok=True)
        with pytest.raises(BadInput, match=r"there is no plug-in|cannot be loaded"):
            plugins.add([name])


def test_the_way_to_a_file_is_that_of_the_system(
    tmp_path: Path, mine: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Behind a link, '..' is the folder above the one that it leads to."""
    (tmp_path / "real/sub").mkdir(parents=True)
    (tmp_path / "link").symlink_to("real/sub")
    there = mine.rename(tmp_path / "real/mine.py")
    mine.write_text("raise ValueError('another one')")
    monkeypatch.chdir(tmp_path)
    plugins.add(["link/../mine.py", "real/mine.py"])
    assert {one.place for one in plugins.needed(["mine"], [])} == {str(there.resolve())}


@pytest.mark.skipif(sys.platform != "linux", reason="names of files are texts here")
def test_names_that_are_no_text_are_shown_in_escapes(tmp_path: Path) -> None:
    """In what a process tells, in keys, and in lists."""
    folder = tmp_path / os.fsdecode(b"b\xffd")
    folder.mkdir()
    file = folder / os.fsdecode(b"of\xe9.py")
    file.write_text(MINE)
    plugins.add([str(file)])
    told = plugins.look([plugins._plugin(str(file))], [])
    assert msgspec.json.decode(msgspec.json.encode(told), type=plugins.Told) == told
    assert registry.PLUGINS["method"]["mine"].summary.endswith(r"b\udcffd/of\udce9.py")
    assert key(Cell("swingup", "mine", 0))


def test_a_key_is_of_a_file_with_a_dot_in_its_name(tmp_path: Path) -> None:
    file = tmp_path / "mine.v2.py"
    file.write_text(MINE)
    plugins.add([str(file)])
    before = key(Cell("swingup", "mine", 0))
    file.write_text(MINE.replace("30", "31"))
    plugins.add([str(file)])
    assert key(Cell("swingup", "mine", 0)) != before


def test_a_key_is_of_what_a_task_is_registered_with(monkeypatch: pytest.MonkeyPatch) -> None:
    entry = "gymnasium.envs.classic_control:PendulumEnv"

    def key_with(horizon: int = 200, **kwargs: object) -> str:
        spec = EnvSpec("Heavy-v0", entry, max_episode_steps=horizon, kwargs=kwargs)
        monkeypatch.setitem(gymnasium.registry, "Heavy-v0", spec)
        return key(Cell(plugins.add_task("Heavy-v0"), "bc", 0))

    found = {key_with(g=10.0), key_with(g=2.0), key_with(horizon=100, g=2.0)}
    assert len(found) == 3
    with pytest.raises(BadInput, match="registered with arguments that are neither numbers nor texts"):
        key_with(g=object())


def test_a_plugin_of_several_files_is_named_as_a_module(tmp_path: Path) -> None:
    (tmp_path / "several.py").write_text("import not_there_at_all")
    with pytest.raises(BadInput, match="is named as a module"):
        plugins.add([str(tmp_path / "several.py")])
    (tmp_path / "mine.txt").write_text(MINE)
    with pytest.raises(BadInput, match=r"does not end in \.py"):
        plugins.add([str(tmp_path / "mine.txt")])


def test_two_plugins_may_not_name_the_same(tmp_path: Path, mine: Path) -> None:
    (tmp_path / "other.py").write_text(MINE.replace("moon", "mars"))
    with pytest.raises(
        BadInput, match=r"two plug-ins name a method 'mine': of .*mine\.py, and of .*other\.py"
    ):
        plugins.add([str(mine), str(tmp_path / "other.py")])
    (tmp_path / "folder").mkdir()
    (tmp_path / "folder/mine.py").write_text(MINE)
    with pytest.raises(BadInput, match=r"two plug-ins are called mine\.py"):
        plugins.add([str(mine), str(tmp_path / "folder/mine.py")])


def test_a_task_of_gymnasium_needs_its_id_alone() -> None:
    assert plugins.task_or_name("gym:Pendulum-v1") == "gym_Pendulum-v1"
    assert SPECS["gym_Pendulum-v1"].env_id == "Pendulum-v1"
    plugins.load([], ["gym_Pendulum-v1"])
    assert key(Cell("gym_Pendulum-v1", "bc", 0)) != key(Cell("swingup", "bc", 0))


@pytest.mark.parametrize(
    ("name", "reason"),
    [
        ("gym:NoSuchTask-v0", "NameNotFound"),
        ("gym:Pendulum", "Pendulum names no version of the task"),
        ("gym:Blackjack-v1", "observations must be a flat box"),
        ("gym:../run-v0", "no id of Gymnasium"),
        ("gym:", "no id of Gymnasium|cannot be loaded"),
    ],
)
def test_of_a_task_that_cannot_be_derived_it_is_said_why(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str, reason: str
) -> None:
    out = tmp_path / "run"
    assert main(["run", "--methods", "bc", "--envs", name, "--out", str(out)]) == 2
    err = capsys.readouterr().err
    assert pd.Series([err]).str.contains(reason).all(), err
    assert err.count("\n") == 1
    assert not out.exists()


def test_a_run_from_python_gives_frames(tmp_path: Path, mine: Path) -> None:
    code = f"""
import irl_bench
if __name__ == "__main__":
    found = irl_bench.run(["mine"], ["swingup"], seeds=[1, 3], budget="smoke", plugins=[{str(mine)!r}],
                          options=["--no-retrain", "--record", "none"], out="run")
    print(sorted(set(found.scores.seed)), sorted(found.leaderboard.method))
    try:
        irl_bench.load("nowhere")
    except Exception as error:
        print(type(error).__name__, error)
"""
    (tmp_path / "script.py").write_text(code)
    env = {**os.environ, "IRL_BENCH_CACHE": str(tmp_path / "cache")}
    done = subprocess.run(
        [sys.executable, "script.py"], cwd=tmp_path, env=env, capture_output=True, text=True, check=True
    )
    said = done.stdout.splitlines()[-2:]
    assert said[0] == "[1, 3] ['mine', 'mine', 'reference', 'reference']"
    assert said[1].startswith("BadInput nowhere holds no finished run")


@pytest.mark.parametrize("kind", ["plug-in", "gymnasium"])
def test_a_key_is_of_modules_that_a_task_is_registered_with(
    kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Gymnasium's registry names them as text: nothing imports them."""
    (tmp_path / "far_env.py").write_text(
        "from gymnasium.envs.classic_control import PendulumEnv as Far\nimport far_away"
    )
    (tmp_path / "far_wrap.py").write_text("from gymnasium import Wrapper as Pay")
    (tmp_path / "far_away.py").write_text("")
    (tmp_path / "far.py").write_text(
        "from irl_bench import from_gymnasium\nENVS = {'far': from_gymnasium('Far-v0', 'far')}"
    )
    monkeypatch.syspath_prepend(str(tmp_path))
    wrappers = (WrapperSpec("Pay", "far_wrap:Pay", {}),)
    spec = EnvSpec("Far-v0", "far_env:Far", max_episode_steps=200, additional_wrappers=wrappers)
    monkeypatch.setitem(gymnasium.registry, "Far-v0", spec)

    def key_now() -> str:
        if kind == "plug-in":
            plugins.add([str(tmp_path / "far.py")])
        return key(Cell("far" if kind == "plug-in" else plugins.add_task("Far-v0"), "bc", 0))

    names = ("far_env", "far_wrap", "far_away")
    found = [key_now()]
    for name in names:
        with (tmp_path / f"{name}.py").open("a") as file:
            file.write("\nMORE = 1\n")
        found.append(key_now())
    assert len(set(found)) == 4
