"""A stored result counts as long as nothing that can change it has changed, and no longer."""

import ast
import dataclasses
import subprocess
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import pytest

from harness.records import Cell, Conditions
from harness.registry import ENVS, KNOWN, METHODS, OTHER_ENVS, VARIANTS, keys, sources
from harness.registry.keys import ROOT
from harness.registry.ours import PROGRAM
from methods import settings
from tests.harness.plugged import MINE
from tests.harness.registry.conftest import CONDITIONS, key_of

KEYED = [
    *(("cartpole", method) for method in ("bc", "maxent", "reference", "control_clone", "control_shuffled")),
    *(("highway", method) for method in ("bc", "reference")),
]
Cells = dict[tuple[str, str], str]
Edit = Callable[[dict[str, bytes]], None]


def changed(before: Cells) -> set[tuple[str, str]]:
    return {(env, method) for env, method in KEYED if key_of(method, env) != before[env, method]}


@pytest.fixture
def before() -> Cells:
    return {(env, method): key_of(method, env) for env, method in KEYED}


@pytest.fixture
def edit(monkeypatch: pytest.MonkeyPatch) -> Edit:
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
    def drawn(self):
        return "drawn"
'''
EDITS = {
    "constant": ("NUMBER = 1", "NUMBER = 2", True),
    "default": ("rate=0.1", "rate=0.2", True),
    "helper": ("rate * NUMBER", "rate + NUMBER", True),
    "data file": ("1.5", "2.5", True),
    "comment": ("NUMBER = 1", "NUMBER = 1  # metre", False),
    "docstring": ("Help.", "Help more.", False),
    "marked place": ('return "drawn"', "return 3", False),
}
MODULES = {
    "env": "envs/balancing/cartpole.py",
    "method": "methods/bc.py",
    "rl": "harness/rl/solving.py",
    "plug-in": "plugged.py",
    "helper": "its_helper.py",
}


@pytest.fixture
def write(
    tmp_path: Path, edit: Edit, here: None, monkeypatch: pytest.MonkeyPatch
) -> Callable[[str, str, str], str]:
    """Writes a block of code at the end of a module, and its data file. Returns the key of a cell."""
    monkeypatch.syspath_prepend(str(tmp_path))
    program = keys.program()

    def written(kind: str, code: str, data: str) -> str:
        file = MODULES[kind]
        if file in program:
            # The first declaration of a module counts.
            whole = program[file].decode().replace("\nNO_NUMBERS = {", "\n_OTHER = {") + code
            edit({file: whole.encode(), f"{Path(file).parent.as_posix()}/numbers.txt": data.encode()})
            return key_of("bc", "cartpole")
        texts = {"plugged.py": f"import its_helper\n{MINE}", "its_helper.py": "", "numbers.txt": data}
        texts[file] += code
        for name, text in texts.items():
            (tmp_path / name).write_text(text)
        return key_of("mine", "cartpole", tmp_path / "plugged.py")

    return written


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


def trees() -> dict[str, ast.Module]:
    return {name: ast.parse(data) for name, data in keys.program().items() if name.endswith(".py")}


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
    without_numbers = {name for name, tree in trees().items() if isinstance(sources.no_numbers(tree), str)}
    assert imported - covered.keys() - without_numbers == set()
    assert covered.keys().isdisjoint({"methods/maxent.py", "envs/balancing/cartpole.py"})


def place_of(node: ast.AST) -> tuple[object, ...]:
    return type(node), getattr(node, "lineno", 0), getattr(node, "col_offset", 0)


def stripped(file: str, left_out: Sequence[str]) -> set[tuple[object, ...]]:
    """Return the kind and the place of each node that counts."""
    tree = ast.parse(keys.program()[file])
    sources.strip(tree, left_out)
    return {place_of(node) for node in ast.walk(tree)}


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


def test_another_number_anywhere_between_a_request_and_a_row_is_another_key() -> None:
    targets = (entry.target.partition(":")[0] for entry in (METHODS | VARIANTS | ENVS | OTHER_ENVS).values())
    edited = 0
    for file in keys.sources(*keys.RUNNING, *targets):
        source = keys.program()[file]
        tree = ast.parse(source)
        counted = stripped(file, ["NO_NUMBERS", *sources.no_numbers(tree)])
        numbers = [
            node
            for node in ast.walk(tree)
            if isinstance(node, ast.Constant) and type(node.value) in (int, float)
            if place_of(node) in counted
        ]
        if numbers:  # the deepest comes last, in a method or a function in a function
            numbers[-1].value = 12345.5
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
def test_an_edit_concerns_the_cells_that_it_can_change(file: str, before: Cells, edit: Edit) -> None:
    edit({file: keys.program()[file] + b"EDITED = 1\n"})
    assert changed(before) == CONCERNED[file]


def test_another_class_or_setting_concerns_the_cells_that_it_is_of(
    before: Cells, monkeypatch: pytest.MonkeyPatch
) -> None:
    more = (("bc",), ("highway",), settings.ANY, {"steps": 7})
    with monkeypatch.context() as patch:
        patch.setattr(settings, "SETTINGS", [*settings.SETTINGS, more])
        assert changed(before) == {("highway", "bc")}
    table = KNOWN.entries["method"]
    monkeypatch.setitem(table, "bc", table["bc"]._replace(target="methods.bc:Other"))
    assert changed(before) == CONCERNED["methods/bc.py"]


@pytest.mark.parametrize(
    ("file", "counts"),
    [
        ("envs/balancing/cartpole.py", True),
        ("harness/judge/evaluation.py", True),
        ("harness/rl/seeds.py", True),
        (next(iter(keys.expert_files("cartpole"))), True),
        ("harness/rl/solving.py", False),
        ("envs/driving/highway.py", False),
    ],
)
def test_a_tasks_version_is_of_what_scores_mean_and_not_how_they_come(
    file: str, counts: bool, edit: Edit
) -> None:
    usual = keys.task_version("cartpole"), key_of("bc", "cartpole")
    edit({file: keys.program()[file] + b"EDITED = 1\n"})
    assert (keys.task_version("cartpole") != usual[0]) == counts
    assert (key_of("bc", "cartpole") != usual[1]) == (file != "envs/driving/highway.py")


@dataclass(frozen=True)
class MoreConditions(Conditions):
    """Conditions of a later version."""

    more: str = "usual"


def test_conditions_that_change_no_number_change_no_key() -> None:
    cell = Cell("cartpole", "bc", 0)
    same = [CONDITIONS, dataclasses.replace(CONDITIONS, record="none"), MoreConditions(**vars(CONDITIONS))]
    others = [dataclasses.replace(CONDITIONS, rl="sb3"), dataclasses.replace(same[2], more="else")]
    (usual,) = {keys.cell_keys([cell], conditions, {})[cell] for conditions in same}
    assert usual not in {keys.cell_keys([cell], conditions, {})[cell] for conditions in others}


def test_an_encoders_name_and_source_count(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    cell, file = Cell("swingup_pixels", "bc", 0), tmp_path / "own_encoder.py"
    monkeypatch.syspath_prepend(tmp_path)
    found = set()
    for encoder, text in (
        ("", ""),
        ("nature", ""),
        ("own_encoder:Own", "A = 1"),
        ("own_encoder:Own", "A = 2"),
    ):
        file.write_text(text)
        conditions = dataclasses.replace(CONDITIONS, encoder=encoder)
        found.add(keys.cell_keys([cell], conditions, {})[cell])
    assert len(found) == 4
