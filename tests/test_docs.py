"""What the documents say is there."""

import csv
import dataclasses
import importlib.util
import itertools
import os
import re
import statistics
import subprocess
import sys
import textwrap
from collections.abc import Mapping
from pathlib import Path
from typing import Any, cast

import pytest

from harness.registry import ENVS, METHODS, VARIANTS, load_method
from harness.show.terminal import found
from harness.store.opening import open_to_verify
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
    assert (ROOT / "README.md").read_text(encoding="utf-8").count("\n") < 120


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


def test_the_readmes_table_is_that_of_the_files() -> None:
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    marked = re.search(r"<!-- (\w+) of (\S+) -->\n(.*?)<!-- end", text, re.DOTALL)
    assert marked is not None
    entries = {key[1:]: entry for key, entry in leaderboard_of(marked[2]).items() if key[0] == marked[1]}
    _, _, *shown = cells_of(marked[3])
    assert {line[0].strip("`") for line in shown} == {method for method, _ in entries}
    for method, _, *scores in shown:
        for policy, score in zip(("pi_star", "pi_R"), scores, strict=True):
            entry = entries.get((method.strip("`"), policy), {"score_mean": ""})
            expected = ""
            if entry["score_mean"]:
                mean, low, high = (float(entry[f"score_{name}"]) for name in ("mean", "low", "high"))
                expected = f"{mean:z.2f} [{low:z.2f}, {high:z.2f}]"
            assert score == expected, (method, policy)


def test_the_end_of_a_run_is_as_the_readme_has_it() -> None:
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    ((run, lines),) = re.findall(r"<!-- the end of (\S+) -->\n(.*?)<!-- end", text, re.DOTALL)
    with open_to_verify(ROOT / run) as stored:
        results, _ = stored.load()
        now = found(stored.request, list(results.values()), Path("results/latest"))
    assert textwrap.dedent(lines).splitlines() == now


def test_the_means_of_the_pages_are_those_of_the_files() -> None:
    """Of each table, every method and every task that it names."""
    text = "".join(page.read_text(encoding="utf-8") for page in PAGES)
    tables = re.findall(r"<!-- means of (\S+) -->\n(.*?)<!-- end", text, re.DOTALL)
    assert len(tables) > 1
    for run, table in tables:
        entries = leaderboard_of(run)
        heading, _, *lines = [re.split(r" ?\| ?", line.strip("| ")) for line in table.splitlines()]
        shown = {}
        for method, *scores in lines:
            for task, score in itertools.zip_longest(heading, scores, fillvalue=""):
                shown[task, method.strip("`")] = score
        expected: dict[tuple[str, str], list[str]] = {}
        for (task, method, _), entry in sorted(entries.items(), key=lambda item: item[0][2], reverse=True):
            means = [f"{float(entry['score_mean']):z.2f}"] if entry["score_mean"] else []
            if task in heading:
                expected[task, method] = expected.get((task, method), []) + means
        assert shown == {key: " / ".join(means) for key, means in expected.items()}, run


def test_the_returns_of_adversarial_methods_are_those_of_their_runs() -> None:
    text = (ROOT / "docs/adversarial.md").read_text(encoding="utf-8")
    ((file, table),) = re.findall(r"<!-- returns of (\S+) -->\n(.*?)<!-- end", text, re.DOTALL)
    runs = list(csv.DictReader((ROOT / file).read_text(encoding="utf-8").splitlines()))
    _, _, *lines = cells_of(table)
    columns = ("expert", "pi_star", "pi_R", "pi_star_flipped", "pi_R_flipped")
    for method, fits, *shown in lines:
        its = [
            run
            for run in runs
            if (run["env"], run["method"], run["settings"]) == ("swingup", method.strip("`"), "")
        ]
        assert len(its) == int(fits)
        found = [[float(run[column]) for run in its if run[column]] for column in columns]
        assert shown == [f"{sum(v) / len(v):.0f} ({min(v):.0f})" if v else "" for v in found]


def test_the_table_of_demonstrations_is_that_of_the_file() -> None:
    """Of each method the mean over seeds, and the least."""
    text = (ROOT / "docs/findings.md").read_text(encoding="utf-8")
    ((run, table),) = re.findall(r"<!-- demonstrations of (\S+) -->\n(.*?)<!-- end", text, re.DOTALL)
    rows = list(csv.DictReader((ROOT / run / "scores.csv").read_text(encoding="utf-8").splitlines()))
    heading, _, *lines = cells_of(table)
    shown = {
        (line[0].strip("`"), demos): score
        for line in lines
        for demos, score in zip(heading[1:], line[1:], strict=True)
    }
    found: dict[tuple[str, str], list[float]] = {}
    for row in rows:
        if row["policy"] == "pi_star":
            found.setdefault((row["method"], row["demos"]), []).append(float(row["normalized_score"]))
    assert shown == {key: f"{sum(v) / len(v):.2f} ({min(v):.2f})" for key, v in found.items()}


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


def test_what_rl_earns_of_rewards_with_good_policies_is_that_of_the_files() -> None:
    text = (ROOT / "docs/findings.md").read_text(encoding="utf-8")
    (table,) = re.findall(r"<!-- of R\*, RL and pi\* -->\n(.*?)<!-- end", text, re.DOTALL)
    _, _, *lines = cells_of(table)
    assert len(lines) > 4
    for run, *shown in lines:
        file = ROOT / "results/reference/board" / run.strip("`") / "scores.csv"
        fits: dict[tuple[str, str], dict[str, tuple[float, float]]] = {}
        for row in csv.DictReader(file.read_text(encoding="utf-8").splitlines()):
            if row["dynamics"] == "nominal" and row["own_return"] and row["method"] in METHODS | VARIANTS:
                its = float(row["normalized_score"]), float(row["own_return"])
                fits.setdefault((row["method"], row["seed"]), {})[row["policy"]] = its
        good = [fit for fit in fits.values() if len(fit) == 2 and fit["pi_star"][0] >= 0.9]
        found = [len(good)]
        for retrained in (False, True):
            such = [fit for fit in good if (fit["pi_R"][0] >= 0.9) == retrained]
            found += [len(such), sum(fit["pi_R"][1] < fit["pi_star"][1] for fit in such)]
        assert [int(count) for count in shown] == found, run


def single_and_chosen_solves() -> list[list[str]]:
    """Of each task and method."""
    found: dict[tuple[str, str], list[dict[str, str]]] = {}
    for solve in csv.DictReader((ROOT / "results/reference/rl_solves.csv").read_text("utf-8").splitlines()):
        found.setdefault((solve["env"], solve["method"]), []).append(solve)
    lines = []
    for (env, method), solves in found.items():
        chosen = [solve for solve in solves if solve["chosen"] == "1"]
        failed = [sum(its["solved"] == "0" for its in some) for some in (solves, chosen)]
        scores = [statistics.mean(float(its[name]) for its in chosen) for name in ("score_star", "score")]
        counts = [f"{failed[0]} of {len(solves)}", f"{failed[1]} of {len(chosen)}"]
        lines.append([f"`{env}`", f"`{method}`", *counts, *(f"{score:z.2f}" for score in scores)])
    return lines


def test_which_solves_fail_is_that_of_the_file() -> None:
    text = (ROOT / "docs/findings.md").read_text(encoding="utf-8")
    (table,) = re.findall(r"<!-- single and chosen solves -->\n(.*?)<!-- end", text, re.DOTALL)
    assert cells_of(table)[2:] == single_and_chosen_solves()


def test_what_more_solves_found_is_that_of_the_file() -> None:
    text = (ROOT / "docs/findings.md").read_text(encoding="utf-8")
    (table,) = re.findall(r"<!-- solves -->\n(.*?)<!-- end", text, re.DOTALL)
    solves: dict[tuple[str, ...], list[dict[str, str]]] = {}
    for solve in csv.DictReader((ROOT / "results/reference/solves.csv").read_text("utf-8").splitlines()):
        solves.setdefault((solve["env"], solve["method"], solve["seed"]), []).append(solve)
    expected = []
    for (env, method, seed), its in solves.items():
        most = max(its, key=lambda solve: float(solve["own_return"]))
        own = [f"{float(most[name]):,.1f}" for name in ("own_return", "own_return_star")]
        scores = [f"{float(solve['score']):z.2f}" for solve in its]
        expected.append(
            [f"`{env}`", f"`{method}`", seed, ", ".join(scores), *own, f"{float(most['score']):z.2f}"]
        )
    assert cells_of(table)[2:] == expected


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


def test_the_scripts_of_what_methods_cost_print_their_line() -> None:
    seed, reached, seconds, *used, score = costs_of("ours.py", "gridworld", "bc", "0")
    assert (seed, used) == ("0", ["0", "0", "0"])
    assert float(seconds) > 0
    assert reached == str(float(score) >= 0.95)
    protocol, seed, reached, seconds, steps, score, told = costs_of("games.py", "gridworld", "gail", "0", "5")
    assert (protocol, seed, told) == ("absorbing", "0", "5 demonstrations")
    assert float(seconds) > 0
    assert int(steps) > 0
    assert reached == str(float(score) >= 0.95)


def costs_of(script: str, *arguments: str) -> list[str]:
    """What it prints after environment and method."""
    costs = ROOT / "results/reference/costs"
    env = {**os.environ, "PYTHONPATH": str(ROOT)}
    command = [sys.executable, str(costs / script), *arguments]
    done = subprocess.run(command, cwd=ROOT, env=env, capture_output=True, text=True, check=True)
    told = done.stdout.strip().split(",")
    assert told[:2] == list(arguments[:2])
    return told[2:]


def test_every_command_and_option_of_the_documents_exists() -> None:
    from harness.arguments import parser

    text = "".join(
        (ROOT / page).read_text(encoding="utf-8")
        for page in ("README.md", "docs/commands.md", "docs/getting_started.md", "docs/reproduce.md")
    )
    helps = parser().format_help()
    for command in re.findall(r"irl-bench (\w+)", text):
        assert command in helps, command
    options = set(re.findall(r"--[a-z][a-z-]+", text)) - {"--bind"}  # rerun's
    for option in options:
        assert f'"{option}"' in (ROOT / "harness/arguments.py").read_text(encoding="utf-8"), option
