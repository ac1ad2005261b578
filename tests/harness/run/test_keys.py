"""What is stored counts as long as nothing that can change it has changed, and no longer."""

import ast
import dataclasses
import re
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import pytest

from harness import registry
from harness.judge.results import Cell, Conditions
from harness.run import keys
from harness.registry.keys import PROGRAM, ROOT
from methods import settings

CONDITIONS = Conditions("smoke", "absorbing", "sbx")
CELL = Cell("cartpole", "bc", 0)


def cell_key(env: str, method: str) -> str:
    cell = Cell(env, method, 0)
    return keys.cell_keys([cell], CONDITIONS, {})[cell]


KEYED = [
    *(("cartpole", method) for method in ("bc", "maxent", "reference", "control_clone", "control_shuffled")),
    *(("highway", method) for method in ("bc", "reference")),
]


def test_a_cells_key_covers_all_source_that_computes_it() -> None:
    code = f"import sys, {', '.join(keys.RUNNING)}, methods.maxmargin, envs.driving.highway\n"
    code += "import envs.mujoco_batch\n"
    code += "print(*(m.__file__ for m in list(sys.modules.values()) if getattr(m, '__file__', None)))"
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    files = map(Path, done.stdout.split())
    imported = {f.relative_to(ROOT).as_posix() for f in files if f.is_relative_to(ROOT)}
    imported = {name for name in imported if name.split("/")[0] in PROGRAM}
    assert "harness/learn/rl.py" in imported
    covered = keys.sources(*keys.RUNNING, "methods.maxmargin", "envs.driving.highway")
    without_reason = imported - covered - {*reasons("*")}
    assert without_reason == set()
    assert covered.isdisjoint({"methods/maxent.py", "envs/balancing/cartpole.py"})


def reasons(place: str) -> dict[str, str]:
    """Why files, with '*', or a place in them, change no number, by file."""
    declared = {
        name: keys.no_numbers(ast.parse(source))
        for name, source in keys.program().items()
        if name.endswith(".py")
    }
    tables = {name: {"*": why} if isinstance(why, str) else why for name, why in declared.items()}
    return {name: table[place] for name, table in tables.items() if place in table}


def test_what_is_left_out_of_keys_is_there_and_has_a_reason() -> None:
    places = 0
    for name, source in keys.program().items():
        if not name.endswith(".py"):
            continue
        tree = ast.parse(source)
        if f"\n{keys.DECLARATION} = " in source.decode():
            assert keys.no_numbers(tree), name
        declared = keys.no_numbers(tree)
        if isinstance(declared, str):
            assert len(declared.split()) >= 3, name
            continue
        usual = len([*keys.counted(tree, {})])
        for place, why in declared.items():
            assert len(why.split()) >= 3, f"{name}: {place}"
            assert len([*keys.counted(tree, {place})]) < usual, f"{name} has no {place}"
            places += 1
    assert places > 10


def edit_constant(node: ast.AST) -> bool:
    if not (isinstance(node, ast.Constant) and type(node.value) in (int, float)):
        return False
    node.value = 12345.5
    return True


def edit_default(node: ast.AST) -> bool:
    if not (isinstance(node, ast.FunctionDef | ast.Lambda) and node.args.defaults):
        return False
    node.args.defaults[-1] = ast.Constant("edited")
    return True


def edit_attribute(node: ast.AST) -> bool:
    if not isinstance(node, ast.ClassDef):
        return False
    node.body.append(ast.parse("edited = 1").body[0])
    return True


def edit_decorator(node: ast.AST) -> bool:
    if not isinstance(node, ast.FunctionDef | ast.ClassDef):
        return False
    node.decorator_list.append(ast.Name("edited", ast.Load()))
    return True


def edit_helper(node: ast.AST) -> bool:
    if not isinstance(node, ast.FunctionDef):
        return False
    node.body.append(ast.Pass())
    return True


BETWEEN = keys.sources(*keys.RUNNING) | keys.sources(
    *(
        entry.target.partition(":")[0]
        for entry in (registry.METHODS | registry.VARIANTS | registry.ENVS).values()
    )
)
"""Files between a request and a row: all whose places some cell's key is of."""


@pytest.mark.parametrize("edit", [edit_constant, edit_default, edit_attribute, edit_decorator, edit_helper])
def test_an_edit_anywhere_between_a_request_and_a_row_is_another_key(edit: Callable[[ast.AST], bool]) -> None:
    edited = 0
    for file in BETWEEN:
        source = keys.program()[file]
        declared = keys.no_numbers(ast.parse(source))
        assert not isinstance(declared, str)
        tree = ast.parse(source)
        counted = {id(part) for part in keys.counted(tree, declared.keys())}
        # The deepest places come last: methods, functions in functions.
        if any(edit(node) for node in reversed([*ast.walk(tree)]) if id(node) in counted):
            edited += 1
            assert keys._code(ast.unparse(tree).encode()) != keys._code(source), file
    assert edited > 20


def test_cells_are_computed_from_the_files_that_their_keys_are_of() -> None:
    """Every module that starts, feeds, computes or stores a cell is in its key, or says why not."""
    for file in ("cells", "engines", "watched", "processes", "cache", "grid", "store", "codec", "preload"):
        assert f"harness/run/{file}.py" in BETWEEN
    assert {"harness/registry.py", "harness/judge/results.py"} <= BETWEEN
    assert BETWEEN.isdisjoint(reasons("*"))


def test_a_key_is_of_names_and_contents(monkeypatch: pytest.MonkeyPatch) -> None:
    before = cell_key("cartpole", "bc")
    program = dict(keys.program())
    one, other = "harness/learn/rl.py", "harness/learn/world.py"
    program[one], program[other] = program[other], program[one]
    monkeypatch.setattr(keys, "program", lambda: program)
    assert cell_key("cartpole", "bc") != before


# What changes a file, and which cells' keys that changes.
EDITS = {
    "methods/bc.py": {("cartpole", "bc"), ("highway", "bc"), ("cartpole", "control_clone")},
    "methods/shaped.py": {("cartpole", "control_shuffled")},
    "methods/network.py": {*KEYED},
    "envs/driving/traffic.py": {("highway", "bc"), ("highway", "reference")},
    "harness/learn/rl.py": {*KEYED},
    "harness/run/stages.py": {*KEYED},
    "harness/run/cells.py": {*KEYED},
    "harness/run/store.py": {*KEYED},
    "harness/registry.py": {*KEYED},
    "harness/show/recordings.py": set(),
    "harness/judge/leaderboard.py": set(),
    "harness/run/progress.py": set(),
}


@pytest.mark.parametrize("file", EDITS)
def test_an_edit_concerns_the_cells_that_it_can_change(file: str, monkeypatch: pytest.MonkeyPatch) -> None:
    before = {cell: cell_key(*cell) for cell in KEYED}
    edited = {**keys.program(), file: keys.program()[file] + b"EDITED = 1\n"}
    monkeypatch.setattr(keys, "program", lambda: edited)
    assert {cell for cell in KEYED if cell_key(*cell) != before[cell]} == EDITS[file]


def test_of_a_tasks_version_are_what_scores_mean_and_not_how_they_come(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    edits = {
        "envs/balancing/cartpole.py": True,
        "harness/learn/simulator.py": True,
        "harness/judge/evaluation.py": True,
        "harness/learn/seeds.py": True,
        "harness/learn/rl.py": False,
        "methods/bc.py": False,
        "envs/driving/highway.py": False,
    }
    version = keys.task_version
    before, program = version("cartpole"), keys.program()
    for file, changes in edits.items():
        monkeypatch.setattr(keys, "program", lambda f=file: {**program, f: program[f] + b"EDITED = 1\n"})
        assert (version("cartpole") != before) == changes, file


SAYINGS = {
    "methods/bc.py": b"# said\n",
    "harness/learn/rl.py": b'"""Said."""\n',
    "envs/balancing/cartpole.py": b"""
def draw(env):
    import methods.maxent
""",
}


@pytest.mark.parametrize("file", SAYINGS)
def test_what_a_file_says_and_declares_to_draw_changes_no_key(
    file: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = {cell: cell_key(*cell) for cell in KEYED}
    edited = {**keys.program(), file: keys.program()[file] + SAYINGS[file]}
    monkeypatch.setattr(keys, "program", lambda: edited)
    assert {cell: cell_key(*cell) for cell in KEYED} == before


@pytest.mark.parametrize(
    ("file", "old", "new"),
    [
        ("methods/fourier.py", b"count)) / width\n", b"count)) / width * 2\n"),
        ("harness/run/experts.py", b"seeds(seed, shown", b"seeds(seed + 1, shown"),
        ("harness/registry.py", b'ASKING = ("dagger",)', b"ASKING = ()"),
    ],
)
def test_a_name_that_begins_like_a_pictures_is_no_reason(file: str, old: bytes, new: bytes) -> None:
    source = keys.program()[file]
    assert source.count(old) == 1
    before, after = keys._code(source), keys._code(source.replace(old, new))
    assert before.imports == after.imports != ()  # it can be parsed
    assert before.digest != after.digest


def test_fields_without_a_docstring_have_the_key_of_those_with_one(monkeypatch: pytest.MonkeyPatch) -> None:
    before, file = cell_key("cartpole", "bc"), "methods/bc.py"
    text = keys.program()[file].decode()
    fewer = re.sub(r'\n    """.*?"""', "", text, flags=re.DOTALL)
    assert fewer != text
    edited = {**keys.program(), file: fewer.encode()}
    monkeypatch.setattr(keys, "program", lambda: edited)
    assert cell_key("cartpole", "bc") == before


@dataclass(frozen=True)
class MoreConditions(Conditions):
    """As of a later version."""

    more: str = "usual"


def test_of_conditions_what_changes_no_number_changes_no_key() -> None:
    (before,) = keys.cell_keys([CELL], CONDITIONS, {}).values()
    same = [dataclasses.replace(CONDITIONS, record="none"), MoreConditions(**vars(CONDITIONS))]
    others = [dataclasses.replace(CONDITIONS, retrain=False), dataclasses.replace(same[1], more="else")]
    others += [dataclasses.replace(CONDITIONS, experts="trained"), dataclasses.replace(CONDITIONS, rl="sb3")]
    assert {keys.cell_keys([CELL], c, {})[CELL] for c in same} == {before}
    assert before not in {keys.cell_keys([CELL], c, {})[CELL] for c in others}


@pytest.mark.parametrize(
    ("table", "name", "changed"),
    [
        (registry.METHODS, "bc", {("cartpole", "bc"), ("highway", "bc"), ("cartpole", "control_clone")}),
        (registry.ENVS, "highway", {("highway", "bc"), ("highway", "reference")}),
    ],
)
def test_another_name_in_the_same_file_is_another_method_or_task(
    table: dict[str, registry.Entry],
    name: str,
    changed: set[tuple[str, str]],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    before = {cell: cell_key(*cell) for cell in KEYED}
    monkeypatch.setitem(table, name, table[name]._replace(target=f"{table[name].target}Other"))
    assert {cell for cell in KEYED if cell_key(*cell) != before[cell]} == changed


def test_settings_concern_the_cells_that_they_are_of(monkeypatch: pytest.MonkeyPatch) -> None:
    before = {cell: cell_key(*cell) for cell in KEYED}
    monkeypatch.setattr(
        settings, "SETTINGS", [*settings.SETTINGS, (("bc",), ("highway",), settings.ANY, {"steps": 7})]
    )
    assert {cell for cell in KEYED if cell_key(*cell) != before[cell]} == {("highway", "bc")}
