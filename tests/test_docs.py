"""What the documents say is there, and their generated parts read as they should."""

import csv
import dataclasses
import importlib
import inspect
import re
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any, cast

import numpy as np
import pytest
from docutils.utils.math.latex2mathml import tex2mathml

from harness.judge.statistics import mean_interval
from harness.registry import BUILT_IN, KNOWN, THESIS, load_method

ROOT = Path(__file__).parents[1]
PAGES = (
    *sorted(ROOT.glob("*.md")),
    *sorted((ROOT / "docs").glob("*.md")),
    *sorted((ROOT / "results").glob("*/README.md")),
)
GENERATED = ("methods", "tasks", "api", "others", "thesis", "studies", "changes")
"""Folders of docs/ whose pages are made as the others are built, which checks links to them."""


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


def test_the_page_of_faults_lists_every_test_that_injects_one(extension: Any) -> None:
    lists = extension("fault_lists")
    page = (ROOT / "docs/faults.md").read_text(encoding="utf-8")
    assert "<!-- generated: fault_lists.lists -->\n" in page
    sections = re.split(r"^## ", lists.lists(), flags=re.MULTILINE)[1:]
    assert [section.splitlines()[0] for section in sections] == [*lists.SECTIONS]
    for section, folders in zip(sections, lists.SECTIONS.values(), strict=True):
        tests = [file.read_text(encoding="utf-8") for folder in folders for file in lists.files((folder,))]
        names = re.findall(r"^ *def test_(\w+)\(", "\n".join(tests), re.MULTILINE)
        assert len(names) > 5, folders
        listed = re.findall(r"^- (.*)\.$", section, re.MULTILINE)
        assert sorted(line.lower().replace(" ", "_") for line in listed) == sorted(map(str.lower, names))


def test_every_column_option_and_event_has_a_meaning(extension: Any) -> None:
    public, commands = extension("public_lists"), extension("command_lists")
    lists = (public.scores, public.leaderboard, public.names, public.files, public.forms, commands.events)
    for table in (one() for one in lists):
        rows = [line.split(" | ") for line in table.splitlines()[2:]]
        assert len(rows) > 5
        assert all(len(row[-1].strip(" |")) > 3 for row in rows), table
    options = commands.options()
    assert all(f"### {name}\n" in options for name in ("irl-bench run", "irl-bench demos import"))
    assert "- `--budget smoke|quick|full`: default quick" in options


def test_the_readme_and_the_pages_are_short() -> None:
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    pages = [page.read_text(encoding="utf-8") for page in (ROOT / "docs").glob("*.md")]
    assert readme.count("\n") <= 90
    assert sum(len(text.split()) for text in (readme, *pages)) <= 12_000


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_links_lead_somewhere(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    for link, heading in re.findall(r"\]\(([^)#]*)(?:#([^)]+))?\)", text):
        if link.startswith("https:") or link.split("/")[0] in GENERATED:
            continue
        there = page.parent / link if link else page
        assert there.exists(), link
        if heading:
            headings = re.findall(r"^#+ (.*)", there.read_text(encoding="utf-8"), re.MULTILINE)
            assert heading in {re.sub(r"[^\w\- ]", "", one.lower()).replace(" ", "-") for one in headings}


def test_every_command_and_option_of_the_documents_exists() -> None:
    from harness.cli.arguments import parser

    pages = (ROOT / "README.md", *(ROOT / "docs").glob("*.md"))
    commands = "\n".join(re.findall(r"irl-bench (.*)", "\n".join(page.read_text("utf-8") for page in pages)))
    files = (ROOT / f"harness/cli/{name}.py" for name in ("arguments", "options"))
    lists = "".join(file.read_text(encoding="utf-8") for file in files)
    for option in set(re.findall(r"--[a-z][a-z-]+", commands)):
        assert f'"{option}"' in lists, option
    for command in re.findall(r"^([a-z]+) (?=[-a-z])", commands, re.MULTILINE):
        assert command in parser().format_help(), command


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


def test_every_method_stands_beside_other_code(extension: Any) -> None:
    page = extension("other_code").page()
    assert not [name for name in BUILT_IN["method"] if name not in THESIS and f"| `{name}` |" not in page]


@pytest.mark.parametrize("name", BUILT_IN["env"])
def test_every_task_says_what_pays(extension: Any, name: str) -> None:
    module, _, variable = KNOWN.entries["env"][name].target.partition(":")
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


def test_scores_are_those_of_the_board(extension: Any) -> None:
    boards = extension("boards")
    row = {"score_mean": "0.123", "score_low": "0.1", "score_high": "-0.001", "unsolved": "0"}
    assert boards.score(row) == "0.12\u00a0[0.10,\u00a00.00]"
    some = {**row, "unsolved": "1", "seeds_scored": "2", "seeds_ok": "3"}
    assert boards.score(some) == "0.12\u00a0[0.10,\u00a00.00], 2 of 3 seeds"
    assert boards.score({**row, "score_mean": "", "score_unsolved": "0.3"}) == "not solved (0.30)"
    assert boards.score(None) == ""
    found = {(row["run"], row["method"], row["policy"]) for row in boards.rows()}
    assert ("swingup_5", "csil", "pi_R") in found


def test_the_table_of_the_thesiss_arms_is_that_of_the_file(extension: Any) -> None:
    file = ROOT / "results/studies/thesis_arms.csv"
    rows = list(csv.DictReader(file.read_text(encoding="utf-8").splitlines()))
    returns = {
        (row["arm"], row["env"], row["seed"], name): float(row[name])
        for row in rows
        for name in ("pi_R", "variant")
        if row[name]
    }

    lines = extension("thesis_arms").arms().splitlines()[2:]
    assert len(lines) > 10
    for line in lines:
        env, arm, count, shown, away, *scores, solved = (cell.strip(" `") for cell in line[1:-1].split("|"))
        its = [row for row in rows if (row["env"], row["arm"]) == (env, arm)]
        assert int(count) == len(its)
        for text, name in ((shown, "eig_shown"), (away, "eig_away")):
            assert float(text) == pytest.approx(np.mean([float(row[name]) for row in its]), rel=0.06)
        for text, name in zip(scores, ("star", "pi_R", "zero", "ddpg", "variant"), strict=True):
            place, top = ("variant", "true") if name == "variant" else ("pi_R", "expert")
            values = []
            for row in (row for row in its if row[name]):
                least, most = (returns[reference, env, row["seed"], place] for reference in ("random", top))
                values.append((float(row[name]) - least) / (most - least))
            found = [float(number) for number in re.findall(r"-?[\d.]+", text)]
            expected = (
                [np.mean(values), *(mean_interval(values) if len(values) > 2 else ())] if values else []
            )
            assert found == pytest.approx(expected, abs=0.0051), (env, arm, name)
        counts = [sum(row[f"solved_{name}"] == "1" for row in its) for name in ("pi_R", "zero", "variant")]
        assert solved == ", ".join(map(str, counts))


def test_the_table_of_the_search_is_that_of_the_file(extension: Any) -> None:
    with (ROOT / "results/studies/swingup_search.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    lines = extension("searches").trials().splitlines()[2:]
    for line, row in zip(lines, rows, strict=True):
        method, trial, settings, score, _ = (cell.strip() for cell in line[1:-1].split("|"))
        assert (method, trial) == (f"`{row['method']}`", row["trial"].replace("-1", "as it is"))
        assert settings.count("=") == row["name"].count("+")
        scores = [float(one["score"] or "-inf") for one in rows if one["method"] == row["method"]]
        number = float(row["score"] or "nan")
        told = f"{number:z.2f}" if row["score"] else "failed"
        assert score == (f"**{told}**" if number == max(scores) else told)
    assert {row["trial"] for row in rows} == {"-1", "0", "1", "2", "3"}
