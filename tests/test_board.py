"""The board is whole, and README, findings and picture have its numbers."""

import contextlib
import importlib.util
import re
import sqlite3
import textwrap
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from scipy.stats import kendalltau

from harness.api.exported import export, load_learned
from harness.judge.evaluation import evaluate
from harness.records import CONTROLS, NOMINAL, Cell, Shown
from harness.registry import BUILT_IN, SPECS
from harness.rl.seeds import evaluation_seeds
from harness.store.database import FILE
from harness.store.opening import open_to_verify
from tests.pages import BOARD, ROOT, cells_of, leaderboard, marked, rows_of

RUNS = sorted(path.parent for path in BOARD.glob("*/run.sqlite"))
SCORE = ("score_mean", "score_low", "score_high")
NUMBER = r"-?\d+\.\d\d"
CLAIM = "|".join(
    [
        r"`(?P<name>\w+)(?:\.(?P<dynamics>\w+))?`",
        rf"(?P<score>{NUMBER} \[{NUMBER}, {NUMBER}\])",
        rf"(?P<by_seed>by seed {NUMBER} to {NUMBER})",
        rf"(?P<returns>sums to {NUMBER} to {NUMBER})",
        rf"(?P<shown>{NUMBER} to {NUMBER} for the demonstrations)",
        r"(?P<solved>solved R\\\* on \d of \d seeds)",
        r"(?P<policy>π\\\*|π_R)",
    ]
)
"""A name in a page's text, a policy, or what is said of the one that was named last."""


@pytest.fixture(scope="module")
def board() -> Any:
    """The script that makes the board's files."""
    spec = importlib.util.spec_from_file_location("drawn_board", BOARD / "board.py")
    assert spec
    assert spec.loader
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize("name", ["board", "solves", "over_tasks"])
def test_tables_of_the_board_are_of_the_runs(board: Any, name: str) -> None:
    made = getattr(board, name)().to_csv(index=False, lineterminator="\n")
    assert made == (BOARD / f"{name}.csv").read_text(encoding="utf-8")


def test_the_findings_name_each_method_that_differs_over_tasks() -> None:
    page = (ROOT / "docs/findings.md").read_text(encoding="utf-8")
    differ = [row for row in rows_of(BOARD / "over_tasks.csv") if row["p"] and float(row["p"]) <= 0.05]
    said = re.findall(r"`(\w+)` \(([+-]\d\.\d\d)\)", page)
    assert sorted(said) == sorted((row["method"], f"{float(row['beside']):+.2f}") for row in differ)


def test_the_picture_of_the_board_is_of_the_runs(board: Any) -> None:
    """Its numbers are those of the runs' files."""
    lines = rows_of(BOARD / "board.csv")
    assert {f"{line['task']}_{line['demos']}" for line in lines} == {run.name for run in RUNS}
    for line in lines:
        entry = leaderboard(f"{line['task']}_{line['demos']}")[
            line["dynamics"], line["method"], line["policy"]
        ]
        for name, theirs in board.NUMBERS.items():
            assert line[theirs] == entry[name] == "" or float(line[theirs]) == pytest.approx(
                float(entry[name])
            )
        assert line["unsolved"] == entry["unsolved"]
    texts = [text.get_text() for axes in board.figure(board.board()).axes for text in axes.texts]
    drawn = [line for line in lines if line["policy"] == "pi_R" or line["dynamics"] == NOMINAL]
    assert sorted(text for text in texts if re.fullmatch(rf"{NUMBER}|/", text)) == sorted(
        f"{float(line['mean']):z.2f}" if line["mean"] else "/" for line in drawn
    )


def claims(page: str) -> Iterator[tuple[str, str]]:
    """Yield each number of the board on a page, as it is there and by the files. It is of the run, the
    dynamics, the method and the policy that were named last before it."""
    run, dynamics, method, policy = "", "", "", ""
    text = " ".join((ROOT / page).read_text(encoding="utf-8").split())
    for found in re.finditer(CLAIM, text):
        if found["policy"]:
            policy = {"π\\*": "pi_star", "π_R": "pi_R"}[found["policy"]]
        elif not found["name"]:
            entries = leaderboard(run)
            entry, retrained = entries[dynamics, method, policy], entries[dynamics, method, "pi_R"]
            rows = [
                row
                for row in rows_of(BOARD / run / "scores.csv")
                if (row["dynamics"], row["method"], row["policy"]) == (dynamics, method, policy)
            ]
            says = {
                "score": "{} [{}, {}]".format(*(f"{float(entry[name] or 'nan'):z.2f}" for name in SCORE)),
                "by_seed": "by seed " + span(rows, "normalized_score"),
                "returns": "sums to " + span(rows, "own_return"),
                "shown": span(rows, "own_return_shown") + " for the demonstrations",
                "solved": f"solved R\\* on {retrained['seeds_scored']} of {retrained['seeds_ok']} seeds",
            }
            yield found[0], says[str(found.lastgroup)]
        elif (BOARD / found["name"]).is_dir():
            run, dynamics = found["name"], found["dynamics"] or NOMINAL
        elif found["name"] in (*BUILT_IN["method"], *CONTROLS):
            method = found["name"]


def span(rows: list[dict[str, str]], name: str) -> str:
    """Return the least and the largest value."""
    values = [float(row[name] or "nan") for row in rows]
    return f"{min(values):z.2f} to {max(values):z.2f}"


def test_what_the_findings_say_of_the_board_is_in_its_files() -> None:
    found = [*claims("docs/findings.md")]
    assert len(found) > 25
    assert [said for said, _ in found] == [true for _, true in found]


def test_the_readmes_scores_are_those_of_the_board() -> None:
    heading, *lines = cells_of(marked("README.md", "scores with 100 demonstrations"))
    assert len(lines) > 1
    for run, *shown in lines:
        entries = leaderboard(run.strip("`"))
        for method, pair in zip(heading[1:], shown, strict=True):
            found = []
            for policy in ("pi_star", "pi_R"):
                entry = entries.get((NOMINAL, method.strip("`"), policy))
                some = f" ({entry['seeds_scored']})" if entry and entry["unsolved"] != "0" else ""
                scored = entry and entry["score_mean"]
                found.append(f"{float(scored):z.2f}{some}" if scored else "-")
            assert pair == ", ".join(found), (run, method)


def test_the_readmes_four_lines_load_a_reward_and_a_policy_of_the_board(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "results").symlink_to(ROOT / "results")
    names: dict[str, Any] = {}
    lines = textwrap.dedent(marked("README.md", "the four lines"))
    assert lines.count("\n") == 4
    exec(lines, names)
    env, policy = names["env"], names["policy"]
    obs, _ = env.reset(seed=0)
    _, paid, *_, info = env.step(policy(np.float32([obs]))[0])
    assert np.isfinite(paid)
    assert paid != info["true_reward"]
    *imports, last = textwrap.dedent(marked("docs/results.md", "a row's return")).splitlines()
    exec("\n".join(imports), names)
    (stored,) = [
        float(row["return_mean"])
        for row in rows_of(BOARD / "swingup_5/scores.csv")
        if (row["method"], row["seed"], row["policy"], row["dynamics"]) == ("f_irl", "0", "pi_star", NOMINAL)
    ]
    assert eval(last, names) == pytest.approx(stored, rel=0.01)


def test_the_failed_solves_of_the_findings_are_those_of_the_file() -> None:
    rows = rows_of(BOARD / "solves.csv")
    lines = []
    for run in dict.fromkeys((row["task"], row["demos"]) for row in rows):
        its = [row for row in rows if (row["task"], row["demos"]) == run]
        counts = {name: sum(int(row[name]) for row in its) for name in list(its[0])[3:]}
        failed = {row["method"]: int(row["rewards_failed"]) for row in its if row["rewards_failed"] >= "3"}
        by_method = sorted(failed, key=lambda name: (-failed[name], name))
        lines.append(
            [
                f"`{'_'.join(run)}`",
                f"{counts['solves_failed']} of {counts['solves']}",
                f"{counts['rewards_failed']} of {counts['rewards']}",
                ", ".join(f"`{name}` {failed[name]}" for name in by_method),
            ]
        )
    assert cells_of(marked("docs/findings.md", "failed solves"))[1:] == lines


def test_what_the_findings_say_of_a_second_learner_is_in_its_file() -> None:
    """A line for each reward, beside the board's own row of it."""
    found, key = pd.read_csv(BOARD / "second_learner.csv"), ["method", "seed"]
    numbers = []
    for env in ("highway", "swingup"):
        rows = pd.read_csv(BOARD / f"{env}_5" / "scores.csv").query("policy == 'pi_R' and solves > 1")
        rows, lines = (it.set_index(key).sort_index() for it in (rows, found[found["env"] == env]))
        assert lines.index.equals(rows.index)
        assert np.allclose(lines["score_pi_R"], rows["normalized_score"], atol=1e-3)
        assert (lines["solved_pi_R"] == rows["solved"]).all()
        means = lines.groupby("method")[["score", "score_pi_R"]].mean()
        numbers.append((lines["solved"].sum(), lines["solved_pi_R"].sum(), kendalltau(*means.T.values)[0]))
    (ddpg, ppo, order), (its_ddpg, its_ppo, its_order) = numbers
    assert (
        f"solved {ddpg} of 85 in `highway_5` and {its_ddpg} of 85 in `swingup_5`, where the best of three "
        f"solves by PPO did {ppo} and {its_ppo}. Kendall's τ of the methods' mean scores under both, solved "
        f"or not, is {order:.2f} and {its_order:.2f}"
    ) in " ".join((ROOT / "docs/findings.md").read_text(encoding="utf-8").split())


def test_what_was_learned_has_less_than_25_mb() -> None:
    sizes = []
    for run in RUNS:
        with contextlib.closing(sqlite3.connect(f"file:{run / FILE}?mode=ro", uri=True)) as database:
            sizes += [size for (size,) in database.execute("select length(data) from learned")]
    assert len(sizes) > 100
    assert sum(sizes) < 25e6


@pytest.mark.parametrize("path", RUNS, ids=lambda path: path.name)
def test_runs_of_the_board_are_whole_and_policies_score_as_they_say(path: Path, tmp_path: Path) -> None:
    with open_to_verify(path) as run:
        assert not run.damaged()
        results, unusable = run.load()
        assert set(results) == set(run.request.cells)
    assert not unusable
    env, _, demos = path.name.rpartition("_")
    kept = [name for name in ("gail", "shaped") if results[Cell(env, name, 0, Shown(int(demos)))].learned]
    if not kept:
        assert [other.name.rpartition("_")[0] for other in RUNS].count(env) == 2
        return
    (row,) = [row for row in results[Cell(env, kept[0], 0, Shown(int(demos)))].rows if row.policy == "pi_R"]
    found = load_learned(export(path, env, kept[0], policy="pi_R", to=tmp_path / "learned"))
    assert found.reward is not None
    scored = evaluate(SPECS[env], found.policy, evaluation_seeds(0, row.episodes), found.reward)
    # This process has other instructions than the run.
    assert scored.returns.mean() == pytest.approx(row.return_mean, rel=0.01)
    assert scored.own_return == pytest.approx(row.own_return, rel=0.01)
