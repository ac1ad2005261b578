"""Methods and tasks of others: named, broken, keyed, and never mistaken for one another."""

import os
import sys
from collections.abc import Callable
from pathlib import Path

import msgspec
import pytest

from harness.cli.main import main
from harness.engines.compute import compute, describe
from harness.engines.jobs import Job
from harness.process.environment import of_this_process
from harness.records import Cell, CellResult, Conditions
from harness.registry import KNOWN, METHODS, SPECS, BadInput, keys, load_method, loading, plugins
from harness.registry.known import Offer, Plugin
from tests.harness import fake_cells
from tests.harness.plugged import MINE

CONDITIONS = Conditions("smoke", "absorbing", "sbx")
Key = Callable[..., str]
pytestmark = pytest.mark.usefixtures("here")


def test_a_key_is_of_what_a_plugin_imports(tmp_path: Path, key: Key, monkeypatch: pytest.MonkeyPatch) -> None:
    """Modules beside it, packages, links in them, and this program's; not what is installed."""
    texts = {
        "theirs/__init__.py": "",
        "theirs/deep.py": "from its_helper import VALUE",
        "its_helper.py": "VALUE = 1",
        "elsewhere/linked.py": "",
    }
    for name, text in texts.items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(text)
    (tmp_path / "theirs/sub").symlink_to(tmp_path / "elsewhere")
    (tmp_path / "theirs/around").symlink_to(tmp_path / "theirs")
    (tmp_path / "theirs/gone").symlink_to(tmp_path / "nowhere")
    plugin = tmp_path / "imports.py"
    plugin.write_text(f"import theirs.deep\n{MINE}")
    monkeypatch.syspath_prepend(str(tmp_path))
    before, program = key(plugin=plugin), keys.program()
    for name, text in texts.items():
        (tmp_path / name).write_text(f"{text}\nMORE = 1\n")
        assert key(plugin=plugin) != before, name
        (tmp_path / name).write_text(text)
    assert key(plugin=plugin) == before
    for file, counts in (
        ("methods/bc.py", True),
        ("methods/gail.py", False),
        ("harness/api/results.py", False),
    ):
        edited = program | {file: program[file] + b"\nMORE = 1\n"}
        monkeypatch.setattr(keys, "program", lambda edited=edited: edited)
        assert (key() != before) == counts, file


def test_links_to_sub_packages_of_plugins_are_followed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Onto other machines; but not around in a circle."""
    for name, text in (("elsewhere/deep.py", "VALUE = 2"), ("theirs/__init__.py", MINE)):
        (tmp_path / name).parent.mkdir()
        (tmp_path / name).write_text(text)
    (tmp_path / "theirs/sub").symlink_to(tmp_path / "elsewhere")
    (tmp_path / "theirs/around").symlink_to(tmp_path / "theirs")
    monkeypatch.syspath_prepend(str(tmp_path))
    plugins.add(["theirs"])
    (there,) = plugins.packed(tmp_path / "program").values()
    assert (tmp_path / "program" / there.place / "theirs/sub/deep.py").read_text() == "VALUE = 2"
    assert not (tmp_path / "program" / there.place / "theirs/around").exists()


def test_a_file_that_was_edited_is_read_anew(mine: Path) -> None:
    """As from a notebook, in one process."""
    plugins.add([str(mine)])
    assert SPECS["moon"].name == "moon"
    mine.write_text(MINE.replace("steps: int = 30", "steps: int = 40"))
    plugins.add([str(mine)])
    assert load_method("mine")().steps == 40


def test_what_a_plugin_prints_while_it_is_loaded_goes_to_standard_error(
    mine: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Standard output may be read by a program."""
    mine.write_text(f"print('hello')\n{MINE}")
    assert main(["list", "--plugin", str(mine)]) == 0
    out, err = capsys.readouterr()
    assert ("hello" in out, err) == (False, "hello\n")


def test_a_method_that_exits_fails_its_check(mine: Path, capsys: pytest.CaptureFixture[str]) -> None:
    fit = "    def fit(self, demos, world, rng):\n        raise SystemExit(0)"
    mine.write_text(MINE.replace("    steps: int = 30", fit))
    assert main(["check", "mine", "--plugin", str(mine)]) == 1
    assert "FAILED  mine: " in capsys.readouterr().out


def test_a_files_methods_and_tasks_are_known_and_not_part_of_all(mine: Path) -> None:
    plugins.add([str(mine)])
    assert load_method("mine").__name__ == "Mine"
    assert KNOWN.chosen_methods("all") == (*METHODS,)
    assert KNOWN.chosen_methods("plugins") == ("mine",)
    assert KNOWN.chosen_envs("plugins") == ("moon",)
    assert plugins.needed(["mine"], []) == plugins.needed([], ["moon"]) == (Plugin(str(mine), str(mine)),)
    assert not plugins.needed(["bc"], ["swingup"])
    plugins.add([str(mine)])  # once more
    facts, spec = plugins.task("moon"), SPECS["moon"]
    assert isinstance(facts, Offer)
    for name in ("discrete", "rl_steps", "ddpg_steps", "solves"):
        assert getattr(facts, name) == getattr(spec, name)
    assert plugins.task("swingup") is SPECS["swingup"]


def test_a_key_is_of_the_plugins_source_and_of_no_others(mine: Path, key: Key) -> None:
    asked = [("mine", "swingup"), ("bc", "moon"), ("bc", "swingup")]
    plugins.add([str(mine)])
    before = [key(*cell) for cell in asked]
    mine.write_text(f"{MINE}\nEDITED = 1\n")
    plugins.add([str(mine)])
    after = [key(*cell) for cell in asked]
    assert [a == b for a, b in zip(after, before, strict=True)] == [False, False, True]
    assert keys.task_of(before[0]) == keys.task_of(before[2]) == keys.task_of(after[0])


def job() -> Job:
    cell = Cell("swingup", "mine", 0)
    (key,) = keys.cell_keys([cell], CONDITIONS, of_this_process()).values()
    return Job((cell,), False, CONDITIONS, key, plugins.needed(["mine"], []))


def test_a_plugin_that_is_edited_while_a_run_goes_on_computes_nothing_more(mine: Path) -> None:
    plugins.add([str(mine)])
    asked = job()
    mine.write_text(f"{MINE}\nEDITED = 1\n")
    with pytest.raises(RuntimeError, match="are not those that the run began with"):
        compute("harness.process.cells", asked)


def test_of_what_is_imported_late_it_is_said_why_the_cell_does_not_count(
    tmp_path: Path, mine: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    mine.write_text(f"{MINE}\ndef late():\n    import found_late")
    (tmp_path / "late").mkdir()
    (tmp_path / "late/found_late.py").write_text("")
    plugins.add([str(mine)])
    asked = job()

    def run_cell(*_: object) -> tuple[CellResult, dict[str, bytes]]:
        monkeypatch.syspath_prepend(str(tmp_path / "late"))
        return fake_cells.faked(asked.cells[0], CONDITIONS, tmp_path), {}

    monkeypatch.setattr(fake_cells, "run_cell", run_cell)
    with pytest.raises(RuntimeError) as raised:
        compute("tests.harness.fake_cells", asked)
    why = "change sys.path and then import from there? Do that as the module is imported."
    assert why in describe(raised.value)


HEAD = "from dataclasses import dataclass\n@dataclass(frozen=True)\nclass A:\n fit = print\n"
BROKEN = {
    "syntax": ("def broken(:", "cannot be loaded: SyntaxError"),
    "raises": ("1 / 0", "cannot be loaded: ZeroDivisionError"),
    "exits": ("raise SystemExit(3)", "cannot be loaded: SystemExit"),
    "leaves": ("raise GeneratorExit('no')", "cannot be loaded: GeneratorExit"),
    "odd": ("class Odd(BaseException): ...\nraise Odd('no')", "cannot be loaded: Odd: no"),
    "mute": ("class Mute(Exception):\n def __str__(self): 1 / 0\nraise Mute", "Mute: (no words)"),
    "attributes": ("def __getattr__(name): raise ValueError('no')", "cannot be loaded: ValueError"),
    "table": ("class D(dict):\n def items(self): raise ValueError\nMETHODS = D(a=1)", "ValueError"),
    "repr": ("class R:\n def __repr__(self): raise ValueError\nMETHODS = {'mine': R()}", "ValueError"),
    "import": ("import nowhere_to_be_found", "is named as a module that Python can import"),
    "nothing": ("", "says neither METHODS nor ENVS"),
    "no dict": ("METHODS = 3", "METHODS must be a dict"),
    "no class": ("METHODS = {'mine': 3}", "must be a class with a method fit, not 3"),
    "no fit": ("class A: ...\nMETHODS = {'mine': A}", "must be a class with a method fit"),
    "no dataclass": (
        "class A:\n def fit(self, demos, world, rng): ...\nMETHODS = {'mine': A}",
        "the method mine: A must be a dataclass, whose fields are its hyper-parameters (docs/plugins.md)",
    ),
    "no default": (
        "class A:\n fit = print\n def __init__(self, steps, *, rate, **more): ...\nMETHODS = {'mine': A}",
        "the method mine has no default for steps, rate",
    ),
    "shadows": (f"{HEAD}METHODS = {{'bc': A}}", "'bc': the name is this program's"),
    "control": (f"{HEAD}METHODS = {{'control_x': A}}", "the name is this program's"),
    "all": (f"{HEAD}METHODS = {{'all': A}}", "the name is this program's"),
    "odd name": (f"{HEAD}METHODS = {{'a b': A}}", "'a b' is no name of methods"),
    "two parts": (f"{HEAD}METHODS = {{'a__b': A}}", "'a__b' is no name of methods"),
    "no spec": ("ENVS = {'moon': 3}", "must be an EnvSpec of that name, not 3"),
    "other name": (MINE.replace('"moon": from', '"mars": from'), "the env mars must be an EnvSpec of that"),
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
    (tmp_path / "folder.py").mkdir()
    (tmp_path / "mine.txt").write_text(MINE)
    for name in ("nowhere.py", str(tmp_path / "folder.py"), "no_such_module", str(tmp_path / "mine.txt")):
        with pytest.raises(BadInput, match=r"there is no plug-in|cannot be loaded|does not end in \.py"):
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
def test_names_that_are_no_text_are_shown_in_escapes(tmp_path: Path, key: Key) -> None:
    """In reports, in keys, and in lists."""
    folder = tmp_path / os.fsdecode(b"b\xffd")
    folder.mkdir()
    file = folder / os.fsdecode(b"of\xe9.py")
    file.write_text(MINE)
    plugins.add([str(file)])
    offers = loading.look([plugins.plugin(str(file))], [])
    assert msgspec.json.decode(msgspec.json.encode(offers), type=list[Offer]) == offers
    assert KNOWN.entries["method"]["mine"].summary.endswith(r"b\udcffd/of\udce9.py")
    assert key()


def test_a_key_is_of_a_file_with_a_dot_in_its_name(tmp_path: Path, key: Key) -> None:
    file = tmp_path / "mine.v2.py"
    file.write_text(MINE)
    before = key(plugin=file)
    file.write_text(MINE.replace("30", "31"))
    assert key(plugin=file) != before


def test_two_plugins_may_not_name_the_same(tmp_path: Path, mine: Path) -> None:
    (tmp_path / "other.py").write_text(MINE.replace("moon", "mars"))
    twice = r"two plug-ins name a method 'mine': of .*mine\.py, and of .*other\.py"
    with pytest.raises(BadInput, match=twice):
        plugins.add([str(mine), str(tmp_path / "other.py")])
    (tmp_path / "folder").mkdir()
    (tmp_path / "folder/mine.py").write_text(MINE)
    with pytest.raises(BadInput, match=r"two plug-ins are called mine\.py"):
        plugins.add([str(mine), str(tmp_path / "folder/mine.py")])
