"""What pages of methods and tasks are made of is there, and reads as it should."""

import dataclasses
import importlib
import inspect
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any, cast

import pytest
from docutils.utils.math.latex2mathml import tex2mathml

from harness.registry import BUILT_IN, ENVS, load_method

ROOT = Path(__file__).parents[1]


@pytest.fixture(scope="module")
def extension() -> Iterator[Any]:
    """Modules of the docs' extension, by name."""
    sys.path.insert(0, str(ROOT / "docs/_ext"))
    before = set(sys.modules)

    def module(name: str) -> ModuleType:
        return importlib.import_module(name)

    yield module
    sys.path.remove(str(ROOT / "docs/_ext"))
    for name in set(sys.modules) - before:
        if (ROOT / f"docs/_ext/{name}.py").exists():
            del sys.modules[name]


@pytest.mark.parametrize("name", BUILT_IN["method"])
def test_every_method_has_an_equation_and_every_hyper_parameter_a_text(extension: Any, name: str) -> None:
    plain, pages = extension("plain_docstrings"), extension("method_pages")
    method = cast(Any, load_method(name))
    parts = plain.paragraphs(inspect.getdoc(sys.modules[method.__module__]))
    equations = [line for part in parts if plain.is_equation(part) for line in part.splitlines()]
    assert equations
    for line in equations:
        assert "<math" in tex2mathml(plain.latex(line.strip()), as_block=True)
    said = pages.field_docs(method)
    assert all(said[field.name] for field in dataclasses.fields(method))


@pytest.mark.parametrize("name", BUILT_IN["env"])
def test_every_task_says_what_pays(extension: Any, name: str) -> None:
    module, _, variable = ENVS[name].target.partition(":")
    importlib.import_module(module)
    assert extension("task_pages").doc_of(module, variable)


def test_running_text_is_no_markup_but_code(extension: Any) -> None:
    plain = extension("plain_docstrings")
    assert plain.inline("pi* of `a_b` is x_y * 2,\nR* <= |w|") == r"π\* of `a_b` is x\_y \* 2, R\* \<= \|w\|"
    assert plain.latex("R* = w^T phi     (eq. 4)") == r"R^* = w^\top \phi  \qquad \text{(eq. 4)}"


def test_clauses_are_lines_of_a_list(extension: Any) -> None:
    found = extension("plain_docstrings").bullets("f is bounded; as Lee et al. have (a; b). R* is the mean.")
    assert found.splitlines() == [
        "- f is bounded.",
        "- As Lee et al. have (a; b).",
        r"- R\* is the mean.",
    ]


def test_scores_are_those_of_the_boards(extension: Any) -> None:
    boards = extension("boards")
    row = {"score_mean": "0.123", "score_low": "0.1", "score_high": "-0.001", "seeds_ok": "3"}
    assert boards.score(row) == "0.12\u00a0[0.10,\u00a00.00]"
    assert boards.score({**row, "seeds_ok": "2"}) == "0.12"
    assert boards.score(None) == ""
    found = {(row["run"], row["method"], row["policy"]) for row in boards.rows()}
    assert ("highway", "shaped", "pi_R") in found
