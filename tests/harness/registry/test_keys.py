"""A stored result counts as long as nothing that can change it has changed, and no longer."""

import ast
import dataclasses
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import pytest

from harness.records import Cell, Conditions
from harness.registry import ENVS, KNOWN, METHODS, VARIANTS, keys, loading, plugins, sources
from harness.registry.keys import ROOT
from harness.registry.ours import PROGRAM
from methods import settings
from tests.harness.plugged import MINE
from tests.harness.registry.conftest import CONDITIONS

CELL = Cell("cartpole", "bc", 0)
KEYED = [
    *(("cartpole", method) for method in ("bc", "maxent", "reference", "control_clone", "control_shuffled")),
    *(("highway", method) for method in ("bc", "reference")),
]


def cell_key(env: str, method: str) -> str:
    cell = Cell(env, method, 0)
    return keys.cell_keys([cell], CONDITIONS, {})[cell]


def changed(before: dict[tuple[str, str], str]) -> set[tuple[str, str]]:
    return {cell for cell in KEYED if cell_key(*cell) != before[cell]}


@pytest.fixture
def before() -> dict[tuple[str, str], str]:
    return {cell: cell_key(*cell) for cell in KEYED}


@pytest.fixture
def edit(monkeypatch: pytest.MonkeyPatch) -> Callable[..., None]:
    """Replaces files of the program, where keys read them."""
    program = keys.program()

    def edited(files: dict[str, bytes]) -> None:
        monkeypatch.setattr(keys, "program", lambda: program | files)

    return edited


BLOCK = '''
NO_NUMBERS = {"Held.drawn": "It draws pictures."}
NUMBER = 1
DATA = "numbers.txt"


def helped(rate=0.1):
    """Help."""
    return rate * NUMBER


class Held:
    size = 3

    def drawn(self):
        return "drawn"
'''
EDITS = {
    "constant": ("NUMBER = 1", "NUMBER = 2", True),
    "default": ("rate=0.1", "rate=0.2", True),
    "attribute": ("size = 3", "size = 4", True),
    "helper": ("rate * NUMBER", "rate + NUMBER", True),
    "data file": ("1.5", "2.5", True),
    "comment": ("size = 3", "size = 3  # metres", False),
    "docstring": ("Help.", "Help more.", False),
    "marked place": ('return "drawn"', "return 3", False),
}
MODULES = {
    "env": "envs/balancing/cartpole.py",
    "method": "methods/bc.py",
    "rl": "harness/rl/solving.py",
    "judge": "harness/judge/evaluation.py",
    "plug-in": "plugged.py",
    "helper": "plugged_helper.py",
}


@pytest.fixture
def write(
    tmp_path: Path, edit: Callable[..., None], monkeypatch: pytest.MonkeyPatch
) -> Iterator[Callable[[str, str, str], str]]:
    """Writes a block of code at the end of a module, and its data file. Returns the key of a cell."""
    monkeypatch.setattr(loading, "in_a_process", loading.look)
    monkeypatch.syspath_prepend(str(tmp_path))
    (tmp_path / "plugged_helper.py").write_text("")
    program = keys.program()

    def written(kind: str, code: str, data: str) -> str:
        file = MODULES[kind]
        if file in program:
            # The first declaration of a module counts.
            whole = program[file].decode().replace("\nNO_NUMBERS = {", "\n_OTHER = {") + code
            edit({file: whole.encode(), f"{Path(file).parent.as_posix()}/numbers.txt": data.encode()})
            return cell_key("cartpole", "bc")
        (tmp_path / "plugged.py").write_text(f"import plugged_helper\n{MINE}")
        with (tmp_path / file).open("w") as handle:
            handle.write(code if kind == "helper" else f"import plugged_helper\n{MINE}{code}")
        (tmp_path / "numbers.txt").write_text(data)
        plugins.add([str(tmp_path / "plugged.py")])
        return cell_key("cartpole", "mine")

    with KNOWN.for_now():
        yield written
    sys.modules.pop("plugged_helper", None)


@pytest.mark.parametrize("kind", MODULES)
@pytest.mark.parametrize("what", EDITS)
def test_whatever_changes_a_number_changes_the_key_and_nothing_else_does(
    kind: str, what: str, write: Callable[[str, str, str], str]
) -> None:
    old, new, counts = EDITS[what]
    assert (old in BLOCK) != (what == "data file")
    usual = write(kind, BLOCK, "1.5")
    assert (write(kind, BLOCK.replace(old, new), "1.5".replace(old, new)) != usual) == counts
    assert write(kind, BLOCK, "1.5") == usual


def test_a_cells_key_covers_all_source_that_computes_it() -> None:
    code = f"import sys, {', '.join(keys.RUNNING)}, methods.maxmargin, envs.driving.highway\n"
    code += "import envs.mujoco_batch\n"
    code += "print(*(m.__file__ for m in list(sys.modules.values()) if getattr(m, '__file__', None)))"
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    files = map(Path, done.stdout.split())
    imported = {f.relative_to(ROOT).as_posix() for f in files if f.is_relative_to(ROOT)}
    imported = {name for name in imported if name.split("/")[0] in PROGRAM}
    assert "harness/rl/solving.py" in imported
    covered = keys.sources(*keys.RUNNING, "methods.maxmargin", "envs.driving.highway")
    assert imported - covered.keys() - without_numbers() == set()
    assert covered.keys().isdisjoint({"methods/maxent.py", "envs/balancing/cartpole.py"})


def stripped(file: str, left_out: Sequence[str]) -> set[tuple[object, ...]]:
    """Return the kind and the place of each node that counts."""
    tree = ast.parse(keys.program()[file])
    sources.strip(tree, left_out)
    return {place_of(node) for node in ast.walk(tree)}


def place_of(node: ast.AST) -> tuple[object, ...]:
    return type(node), getattr(node, "lineno", 0), getattr(node, "col_offset", 0)


def trees() -> dict[str, ast.Module]:
    return {name: ast.parse(data) for name, data in keys.program().items() if name.endswith(".py")}


def without_numbers() -> set[str]:
    return {name for name, tree in trees().items() if isinstance(sources.no_numbers(tree), str)}


def test_what_is_left_out_of_keys_is_there_and_has_a_reason() -> None:
    places = 0
    for name, tree in trees().items():
        declared = sources.no_numbers(tree)
        assert declared or b"\nNO_NUMBERS = " not in keys.program()[name], name
        if isinstance(declared, str):
            assert len(declared.split()) >= 3, name
            continue
        for place, why in declared.items():
            assert len(why.split()) >= 3, f"{name}: {place}"
            assert stripped(name, []) != stripped(name, [place]), f"{name} has no {place}"
            places += 1
    assert places > 10


def edit_constant(node: ast.AST) -> bool:
    if not (isinstance(node, ast.Constant) and type(node.value) in (int, float)):
        return False
    node.value = 12345.5
    return True


def edit_decorator(node: ast.AST) -> bool:
    if not isinstance(node, ast.FunctionDef | ast.ClassDef):
        return False
    node.decorator_list.append(ast.Name("edited", ast.Load()))
    return True


BETWEEN = keys.sources(
    *keys.RUNNING,
    *(entry.target.partition(":")[0] for entry in (METHODS | VARIANTS | ENVS).values()),
)
"""Files between a request and a row: some cell's key is of every place in them."""


@pytest.mark.parametrize("change", [edit_constant, edit_decorator])
def test_an_edit_anywhere_between_a_request_and_a_row_is_another_key(
    change: Callable[[ast.AST], bool],
) -> None:
    edited = 0
    for file in BETWEEN:
        source = keys.program()[file]
        tree = ast.parse(source)
        counted = stripped(file, ["NO_NUMBERS", *sources.no_numbers(tree)])
        # The deepest places come last: methods, functions in functions.
        if any(change(node) for node in reversed([*ast.walk(tree)]) if place_of(node) in counted):
            edited += 1
            assert sources.read_code(ast.unparse(tree).encode()) != sources.read_code(source), file
    assert edited > 20


CONCERNED = {
    "methods/bc.py": {("cartpole", "bc"), ("highway", "bc"), ("cartpole", "control_clone")},
    "methods/network.py": {*KEYED},
    "envs/driving/traffic.py": {("highway", "bc"), ("highway", "reference")},
    "harness/cell/run.py": {*KEYED},
    "harness/registry/names.py": {*KEYED},
    "harness/recordings/episode.py": set(),
    "harness/schedule/progress.py": set(),
}
"""The cells whose key an edit of a file changes."""


@pytest.mark.parametrize("file", CONCERNED)
def test_an_edit_concerns_the_cells_that_it_can_change(
    file: str, before: dict[tuple[str, str], str], edit: Callable[..., None]
) -> None:
    edit({file: keys.program()[file] + b"EDITED = 1\n"})
    assert changed(before) == CONCERNED[file]


@pytest.mark.parametrize(
    ("file", "counts"),
    [
        ("envs/balancing/cartpole.py", True),
        ("harness/judge/evaluation.py", True),
        ("harness/rl/seeds.py", True),
        ("harness/rl/solving.py", False),
        ("envs/driving/highway.py", False),
    ],
)
def test_a_tasks_version_is_of_what_scores_mean_and_not_how_they_come(
    file: str, counts: bool, edit: Callable[..., None]
) -> None:
    usual = keys.task_version("cartpole")
    edit({file: keys.program()[file] + b"EDITED = 1\n"})
    assert (keys.task_version("cartpole") != usual) == counts


def test_a_tasks_experts_are_part_of_its_keys(edit: Callable[..., None]) -> None:
    usual = cell_key("cartpole", "bc"), keys.task_version("cartpole")
    file = next(iter(keys.expert_files("cartpole")))
    edit({file: keys.program()[file] + b"0"})
    now = cell_key("cartpole", "bc"), keys.task_version("cartpole")
    assert all(one != other for one, other in zip(usual, now, strict=True))


@dataclass(frozen=True)
class MoreConditions(Conditions):
    """Conditions of a later version."""

    more: str = "usual"


def test_conditions_that_change_no_number_change_no_key() -> None:
    (usual,) = keys.cell_keys([CELL], CONDITIONS, {}).values()
    same = [dataclasses.replace(CONDITIONS, record="none"), MoreConditions(**vars(CONDITIONS))]
    others = [dataclasses.replace(CONDITIONS, rl="sb3"), dataclasses.replace(same[1], more="else")]
    assert {keys.cell_keys([CELL], c, {})[CELL] for c in same} == {usual}
    assert usual not in {keys.cell_keys([CELL], c, {})[CELL] for c in others}


def test_another_name_in_the_same_file_is_another_method(
    before: dict[tuple[str, str], str], monkeypatch: pytest.MonkeyPatch
) -> None:
    table = KNOWN.entries["method"]
    monkeypatch.setitem(table, "bc", table["bc"]._replace(target="methods.bc:Other"))
    assert changed(before) == CONCERNED["methods/bc.py"]


def test_settings_concern_the_cells_that_they_are_of(
    before: dict[tuple[str, str], str], monkeypatch: pytest.MonkeyPatch
) -> None:
    more = (("bc",), ("highway",), settings.ANY, {"steps": 7})
    monkeypatch.setattr(settings, "SETTINGS", [*settings.SETTINGS, more])
    assert changed(before) == {("highway", "bc")}
