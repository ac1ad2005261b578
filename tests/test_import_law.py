"""Who may import whom, and each heavy library in one place."""

import ast
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
FILES = {
    path.relative_to(ROOT).as_posix(): ast.parse(path.read_text())
    for package in ("envs", "methods", "harness")
    for path in sorted((ROOT / package).rglob("*.py"))
}
LOADS_CODE = {"pickle", "cPickle", "cloudpickle", "dill", "joblib", "shelve", "marshal"}


ROOMS = (
    *("envs", "methods", "harness.registry.names", "harness.registry.built_in"),
    *("harness.registry.bounds", "harness.records"),
    *(
        "harness.judge.numbers",
        "harness.process",
        "harness.engines.containment",
        "harness.registry",
        "harness.rl",
    ),
    *("harness.registry.contract", "harness.judge", "harness.store", "harness.demonstrations"),
    *("harness.recordings", "harness.report", "harness.cell", "harness.engines", "harness.schedule"),
    *("harness.benchmarks", "harness.api", "harness.cli", "harness"),
)
"""Packages and modules; each may import itself and those before it."""


def modules(tree: ast.AST) -> set[str]:
    """What a file imports, lazily or not, with what it takes from there."""
    found = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, "imports are absolute"
            found |= {f"{node.module}.{alias.name}" for alias in node.names}
    return found


def imports(tree: ast.AST) -> set[str]:
    """The packages that a file imports."""
    return {name.split(".")[0] for name in modules(tree)}


def importers(library: str) -> list[str]:
    return [name for name, tree in FILES.items() if library in imports(tree)]


def room(module: str) -> int | None:
    """The number of the innermost room that a module belongs to, if it is of this program."""
    inside = [name for name in ROOMS if f"{module}.".startswith(f"{name}.")]
    return ROOMS.index(max(inside, key=len)) if inside else None


@pytest.mark.parametrize("file", FILES)
def test_rooms_import_only_those_before_them(file: str) -> None:
    own = room(file.removesuffix(".py").removesuffix("/__init__").replace("/", "."))
    assert own is not None
    later = {name for name in modules(FILES[file]) if (its := room(name)) is not None and its > own}
    assert later == set()


def test_every_package_is_installed() -> None:
    setup = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]
    folders = {Path(file).parent.as_posix().replace("/", ".") for file in FILES}
    assert folders <= {*setup["packages"]}


def test_each_heavy_library_has_one_home() -> None:
    at_home = [f"harness/rl/{name}.py" for name in ("models", "training_env")]
    assert importers("stable_baselines3") == at_home
    assert importers("sbx") == ["harness/rl/models.py"]
    assert {Path(file).parent.as_posix() for file in importers("rerun")} == {"harness/recordings"}
    (home,) = importers("cvxpy")
    assert home.startswith("methods/")


def test_nothing_that_can_execute_a_file_reads_one() -> None:
    for name, tree in FILES.items():
        assert not imports(tree) & LOADS_CODE, name
        for node in ast.walk(tree):
            if isinstance(node, ast.Attribute) and node.attr in ("load", "save"):
                assert not (isinstance(node.value, ast.Name) and node.value.id == "torch"), name
            assert not (isinstance(node, ast.keyword) and node.arg == "allow_pickle"), name
            if isinstance(node, ast.ImportFrom) and node.module == "torch":
                assert not {alias.name for alias in node.names} & {"load", "save"}, name
