"""Who may import whom: envs <- methods <- harness, and each heavy library in one place."""

import ast
from pathlib import Path

ROOT = Path(__file__).parent.parent
FILES = {
    path.relative_to(ROOT).as_posix(): ast.parse(path.read_text())
    for package in ("envs", "methods", "harness")
    for path in sorted((ROOT / package).rglob("*.py"))
}
LOADS_CODE = {"pickle", "cPickle", "cloudpickle", "dill", "joblib", "shelve", "marshal"}


def imports(tree: ast.AST) -> set[str]:
    """The packages that a file imports, lazily or not."""
    found = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            found |= {alias.name.split(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, "imports are absolute"
            found.add((node.module or "").split(".")[0])
    return found


def importers(library: str) -> list[str]:
    return [name for name, tree in FILES.items() if library in imports(tree)]


def test_envs_know_no_method_and_no_harness() -> None:
    assert [n for n in importers("methods") + importers("harness") if n.startswith("envs/")] == []


def test_methods_know_no_harness() -> None:
    assert [name for name in importers("harness") if name.startswith("methods/")] == []


def test_each_heavy_library_has_one_home() -> None:
    # The benchmark of our own speed compares with it.
    assert importers("stable_baselines3") == ["harness/bench.py", "harness/rl.py"]
    assert importers("sbx") == ["harness/rl.py"]
    assert importers("rerun") == ["harness/recordings.py"]
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
