"""What the documents say is there."""

import csv
import dataclasses
import importlib.util
import re
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Any, cast

import pytest

from harness.registry import ENVS, METHODS, VARIANTS, load_method
from methods.settings import settings_for

ROOT = Path(__file__).parent.parent
ALL_SHOWN = ("0", "1", "expert")
"""How many demonstrations, which of their steps, and whose."""


def test_every_test_that_the_table_of_faults_names_exists() -> None:
    named = re.findall(r"`(\w+)::(test_\w+)`", (ROOT / "docs/faults.md").read_text(encoding="utf-8"))
    assert len(named) > 60
    for file, test in named:
        (path,) = (ROOT / "tests").rglob(f"test_{file}.py")
        assert f"def {test}(" in path.read_text(encoding="utf-8"), test


PAGES = (*sorted(ROOT.glob("*.md")), *sorted((ROOT / "docs").glob("*.md")))
GENERATED = ("methods", "tasks", "api", "thesis")
"""Folders of docs/ whose pages are made as the others are built, which checks links to them."""


def test_the_readme_is_short() -> None:
    assert (ROOT / "README.md").read_text(encoding="utf-8").count("\n") <= 90


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links_lead_somewhere(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    for link, heading in re.findall(r"\]\(([^)#]*)(?:#([^)]+))?\)", text):
        if link.startswith("https:") or link.split("/")[0] in GENERATED:
            continue
        there = page.parent / link if link else page
        assert there.exists(), link
        if heading:
            headings = re.findall(r"^#+ (.*)", there.read_text(encoding="utf-8"), re.MULTILINE)
            assert heading in {anchor(one) for one in headings}, heading


def anchor(heading: str) -> str:
    """What GitHub calls a heading in links."""
    return re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-")


def test_the_picture_of_the_board_is_of_the_runs() -> None:
    """Its numbers are those of the runs' files, and the picture is drawn of them by one command."""
    board = ROOT / "results/reference/board"
    lines = list(csv.DictReader((board / "board.csv").read_text(encoding="utf-8").splitlines()))
    assert len(lines) > 100
    for line in lines:
        found = csv.DictReader((board / line["run"] / "leaderboard.csv").read_text("utf-8").splitlines())
        demos = "0" if line["demos"] == "100" else line["demos"]
        asked = (line["task"], "nominal", demos, line["method"], line["policy"])
        names = ("env", "dynamics", "demos", "method", "policy")
        (its,) = [entry for entry in found if tuple(entry[name] for name in names) == asked]
        for name in ("mean", "low", "high"):
            assert float(line[name]) == pytest.approx(float(its[f"score_{name}"]), rel=1e-12)
        assert line["seeds"] == its["seeds_ok"]
    spec = importlib.util.spec_from_file_location("drawn_board", board / "board.py")
    assert spec
    assert spec.loader
    script = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(script)
    now = script.board().to_csv(index=False, lineterminator="\n")
    assert now == (board / "board.csv").read_text(encoding="utf-8")
    texts = [text.get_text() for axes in script.figure(script.board()).axes for text in axes.texts]
    drawn = sorted(text for text in texts if "." in text)
    assert drawn == sorted(f"{float(line['mean']):z.2f}" for line in lines)


def test_what_rl_earns_of_the_thesiss_reward_is_that_of_the_files() -> None:
    """On demonstrations R* is told where they were shown, in the nominal dynamics."""
    text = (ROOT / "results/reference/thesis/FINDINGS.md").read_text(encoding="utf-8")
    ((method, table),) = re.findall(r"<!-- own returns of (\S+) -->\n(.*?)<!-- end", text, re.DOTALL)
    _, _, *lines = cells_of(table)
    assert len(lines) > 10
    for run, quoted, *shown in lines:
        entries, task = leaderboard_of(f"results/reference/board/{run.strip('`')}"), quoted.strip("`")
        nominal, its = (entries[name, method, "pi_R"] for name in (task.partition(".")[0], task))
        found = [f"{float(value):,.1f}" for value in (nominal["own_return_shown"], its["own_return"])]
        scores = [entry["score_mean"] for entry in (its, entries[task, "control_true", "pi_R"])]
        assert shown == [its["seeds_ok"], *found, *(f"{float(score):z.2f}" for score in scores)], (run, task)


def test_the_failed_solves_of_the_findings_are_those_of_the_file() -> None:
    text = (ROOT / "docs/findings.md").read_text(encoding="utf-8")
    (sentences,) = re.findall(r"<!-- failed solves -->\n(.*?)<!-- end", text, re.DOTALL)
    rows = list(csv.DictReader((ROOT / "results/studies/rl_solves.csv").read_text("utf-8").splitlines()))
    chosen = [row for row in rows if row["chosen"] == "1"]
    failed, failed_chosen = (sum(row["solved"] == "0" for row in some) for some in (rows, chosen))
    methods = Counter(row["method"] for row in rows)
    failures = Counter(dict.fromkeys(methods, 0) | Counter(r["method"] for r in rows if r["solved"] == "0"))
    by_method = sorted(failures.items(), key=lambda item: (-item[1], item[0]))
    counts = ", ".join(f"`{method}` {count} of {methods[method]}" for method, count in by_method)
    assert sentences.splitlines() == [
        f"Of single solves {failed} of {len(rows)} fail, "
        f"and of chosen ones {failed_chosen} of {len(chosen)}.",
        f"By method, single solves on both tasks: {counts}.",
    ]


def cells_of(table: str) -> list[list[str]]:
    """Of each line of a table."""
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in table.splitlines()]


def leaderboard_of(run: str) -> dict[tuple[str, str, str], dict[str, str]]:
    """What a run's table holds of methods and controls by task, method and policy: shown all demonstrations,
    or what else the run shows, if that is one thing."""
    file = ROOT / run / "leaderboard.csv"
    shown: dict[tuple[str, ...], dict[tuple[str, str, str], dict[str, str]]] = {}
    for entry in csv.DictReader(file.read_text(encoding="utf-8").splitlines()):
        dynamics = entry.get("dynamics", "nominal")
        task = entry["env"] if dynamics == "nominal" else f"{entry['env']}.{dynamics}"
        its = (entry.get("demos", "0"), entry.get("every", "1"), entry.get("demonstrator", "expert"))
        if entry["role"] != "reference":
            shown.setdefault(its, {})[task, entry["method"], entry["policy"]] = entry
    if ALL_SHOWN in shown:
        return shown[ALL_SHOWN]
    ((_, entries),) = shown.items()
    return entries


def test_the_tables_of_the_two_by_two_are_those_of_the_files() -> None:
    text = (ROOT / "docs/termination.md").read_text(encoding="utf-8")
    tables = re.findall(r"<!-- the 2 x 2 on (\w+) -->\n(.*?)<!-- end", text, re.DOTALL)
    assert [env for env, _ in tables] == ["cartpole", "pendulum"]
    for env, table in tables:
        heading, _, *lines = [line.strip("| ").split(" | ") for line in table.splitlines()]
        found = {}
        for protocol in heading[1:]:
            file = ROOT / "results/reference/termination" / protocol / "leaderboard.csv"
            for entry in csv.DictReader(file.read_text(encoding="utf-8").splitlines()):
                if (entry["env"], entry["policy"]) == (env, "pi_R"):
                    mean, low, high = (float(entry[f"score_{name}"]) for name in ("mean", "low", "high"))
                    found[entry["method"], protocol] = f"{mean:z.2f} [{low:z.2f}, {high:z.2f}]"
        shown = {
            (method.strip("`"), protocol): score
            for method, *scores in lines
            for protocol, score in zip(heading[1:], scores, strict=True)
        }
        assert shown == found


def test_the_table_of_hyper_parameters_is_that_of_the_code() -> None:
    text = (ROOT / "docs/settings.md").read_text(encoding="utf-8")
    (table,) = re.findall(r"<!-- hyper-parameters -->\n(.*?)<!-- end", text, re.DOTALL)
    assert table == hyper_parameters()


def hyper_parameters() -> str:
    """Of each method, and what of them is otherwise in some environments at `full`."""
    lines = ["| Method | Hyper-parameters at `full` | Otherwise |", "| --- | --- | --- |"]
    for method in (*METHODS, *VARIANTS):
        found = {env: dict(settings_for(method, env, "full")) for env in ENVS}
        fields = {f.name: f.default for f in dataclasses.fields(cast(Any, load_method(method)))}
        usual = fields | {
            name: value
            for name, value in found["cartpole"].items()
            if all(its.get(name) == value for its in found.values())
        }
        others: dict[str, list[str]] = {}
        for env, its in found.items():
            if differs := told({name: value for name, value in its.items() if usual[name] != value}):
                others.setdefault(differs, []).append(env)
        elsewhere = "; ".join(f"{', '.join(envs)}: {differs}" for differs, envs in others.items())
        lines.append(f"| `{method}` | {told(usual)} | {elsewhere} |")
    return "".join(line + "\n" for line in lines)


def told(settings: Mapping[str, object]) -> str:
    """In a line."""
    values = {
        name: " ".join(map(str, value)) if isinstance(value, tuple) else f"{value}"
        for name, value in settings.items()
    }
    return ", ".join(f"{name} {value}" for name, value in values.items())


def test_every_command_and_option_of_the_documents_exists() -> None:
    from harness.cli.arguments import parser

    text = "".join(
        (ROOT / page).read_text(encoding="utf-8")
        for page in ("README.md", "docs/commands.md", "docs/getting_started.md", "docs/reproduce.md")
    )
    helps = parser().format_help()
    for command in re.findall(r"irl-bench (\w+)", text):
        assert command in helps, command
    options = set(re.findall(r"--[a-z][a-z-]+", text)) - {"--bind"}  # rerun's
    for option in options:
        assert f'"{option}"' in (ROOT / "harness/cli/arguments.py").read_text(encoding="utf-8"), option
