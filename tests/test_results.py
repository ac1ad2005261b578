"""What is committed below results/ is described, and pages have its numbers."""

import ast
import csv
import importlib
import importlib.util
import re
import textwrap
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from harness.api.exported import export, load_learned
from harness.judge.evaluation import evaluate
from harness.judge.leaderboard import scored_rows
from harness.records import CONTROLS, NOMINAL, Cell, Shown
from harness.registry import BUILT_IN, SPECS
from harness.rl.seeds import evaluation_seeds
from harness.store.opening import open_to_verify

ROOT = Path(__file__).parent.parent
REFERENCE = ROOT / "results/reference"
SCRIPTS = sorted((ROOT / "results").rglob("*.py"))


BOARD = REFERENCE / "board"
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


def rows_of(path: Path) -> list[dict[str, str]]:
    return list(csv.DictReader(path.read_text(encoding="utf-8").splitlines()))


def marked(page: str, name: str) -> str:
    """Return the text between a page's marks of this name."""
    text = (ROOT / page).read_text(encoding="utf-8")
    (found,) = re.findall(rf"<!-- {name} -->\n(.*?)<!-- end", text, re.DOTALL)
    return str(found)


def cells_of(table: str) -> list[list[str]]:
    """Return the cells of each line of a table, but for its rule."""
    lines = [[cell.strip() for cell in line.strip("|").split("|")] for line in table.splitlines()]
    return [lines[0], *lines[2:]]


def test_the_page_of_studies_has_every_file() -> None:
    folder = ROOT / "results/studies"
    named = re.findall(r"^\| \[(\S+)\]\(\1\)", (folder / "README.md").read_text("utf-8"), re.MULTILINE)
    assert sorted(named) == sorted(path.name for path in folder.iterdir() if path.suffix in (".csv", ".json"))


@pytest.mark.parametrize("path", SCRIPTS, ids=lambda path: path.name)
def test_scripts_of_results_import_what_is_there(path: Path) -> None:
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and node.module:
            module = importlib.import_module(node.module)
            assert all(hasattr(module, alias.name) for alias in node.names), node.module


def leaderboard(run: str) -> dict[tuple[str, str, str], dict[str, str]]:
    """Return the lines of a run of the board, by dynamics, method and policy."""
    rows = rows_of(BOARD / run / "leaderboard.csv")
    return {(row["dynamics"], row["method"], row["policy"]): row for row in rows}


def test_the_picture_of_the_board_is_of_the_runs() -> None:
    """Its numbers are those of the runs' files, and the picture is drawn of them by one command."""
    spec = importlib.util.spec_from_file_location("drawn_board", BOARD / "board.py")
    assert spec
    assert spec.loader
    board = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(board)
    lines = rows_of(BOARD / "board.csv")
    assert board.board().to_csv(index=False, lineterminator="\n").splitlines() == (
        (BOARD / "board.csv").read_text(encoding="utf-8").splitlines()
    )
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
    assert sorted(text for text in texts if not text.isdigit()) == sorted(
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


def test_the_readmes_four_lines_load_a_reward_of_the_board(
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


def test_what_rl_earns_of_the_thesiss_reward_is_that_of_the_files() -> None:
    """R* of demonstrations is that where they were shown, in the task's own dynamics."""
    _, *lines = cells_of(marked("results/reference/thesis/FINDINGS.md", "own returns of shaped"))
    assert len(lines) > 4
    for named, *shown in lines:
        run, _, variant = named.strip("`").partition(".")
        entries = leaderboard(run)
        there, own, true = (
            entries[dynamics, method, "pi_R"]
            for dynamics, method in (
                *((variant or NOMINAL, "shaped"), (NOMINAL, "shaped")),
                (variant or NOMINAL, "control_true"),
            )
        )
        returns = [f"{float(x):,.1f}" for x in (own["own_return_shown"], there["own_return"])]
        scores = [f"{float(row['score_mean']):z.2f}" for row in (there, true)]
        assert shown == [there["seeds_scored"], *returns, *scores], named


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


def test_the_table_of_the_two_by_two_is_that_of_the_files() -> None:
    """Means over all seeds, on cart-pole and on the pendulum. Each column has a twin, which is the same."""
    _, *lines = cells_of(marked("docs/termination.md", "the 2 x 2"))
    for place, protocols in enumerate((("native", "state"), ("absorbing", "offset")), start=1):
        for protocol in protocols:
            scores: dict[tuple[str, str], list[float]] = {}
            with open_to_verify(REFERENCE / "termination" / protocol) as run:
                rows = scored_rows([*run.load()[0].values()])
            for row in rows:
                if row.policy == "pi_R":
                    scores.setdefault((row.method, row.env), []).append(row.normalized_score)
            assert {len(values) for values in scores.values()} == {5}
            assert len(scores) == 2 * len(lines)
            for line in lines:
                means = (np.mean(scores[line[0].strip("`"), env]) for env in ("cartpole", "pendulum"))
                assert line[place] == ", ".join(f"{mean:z.2f}" for mean in means), (line[0], protocol)


def claims_of_arms(rows: list[dict[str, str]]) -> list[str]:
    """Return what the page says of the thesis's arms. Scores of one arm are by seed."""
    returns = {(row["arm"], row["env"], row["seed"]): row["pi_R"] for row in rows}
    fits = [row for row in rows if row["star"]]
    arms = dict.fromkeys(row["arm"] for row in fits if not row["arm"].startswith("ep"))

    def scores(name: str, env: str, *names: str) -> list[float]:
        found = []
        for row in (row for row in fits if row["env"] == env and row["arm"] in names and row[name]):
            least, most = (float(returns[arm, env, row["seed"]]) for arm in ("random", "expert"))
            found.append((float(row[name]) - least) / (most - least))
        return found

    def each(name: str, env: str, *names: str) -> str:
        return ", ".join(f"{score:z.2f}" for score in scores(name, env, *names))

    def share(name: str, least: float) -> str:
        shares = []
        for env in ("cartpole", "pendulum", "highway"):
            found = scores(name, env, *arms)
            shares.append(f"{sum(score >= least for score in found)} of {len(found)} on `{env}`")
        return ", ".join(shares)

    def solved(name: str) -> str:
        its = [row[f"solved_{name}"] == "1" for row in fits]
        return f"{sum(its)} of {len(its)}"

    shown, away = (max(float(row[name]) for row in fits) for name in ("eig_shown", "eig_away"))
    good = ("standardised", "soap", "shaped")
    well = scores("pi_R", "swingup", *good)
    poor = scores("pi_R", "swingup", *(arm for arm in arms if arm not in good))
    told = ("10 epochs", "one", "100", "10 with epsilon 1e-7")
    trained = dict(zip(told, ("thesis", "epochs_1", "epochs_100", "epsilon_1e-7"), strict=True))
    after = [
        ", ".join(f"{each(name, 'cartpole', arm)} after {epochs}" for epochs, arm in trained.items())
        for name in ("zero", "star")
    ]
    return [
        f"Over {len(fits)} fits the mean eigenvalue of LLᵀ is at most {shown:.1g} at demonstrations and "
        f"{away:.2g} in a random policy's episodes.",
        f"Where an end pays 0, π_R scores 0.3 or more for {share('zero', 0.3)}.",
        f"With the default, π_R scores 0.9 or more for {share('pi_R', 0.9)}.",
        f"RL solved R\\* in {solved('pi_R')} fits with the default, in {solved('zero')} where an end pays 0.",
        "On the swing-up π_R of `standardised`, `soap` and `shaped` scores "
        f"{min(well):.2f} to {max(well):.2f}, that of the other arms {min(poor):.2f} to {max(poor):.2f}.",
        "DDPG under `native` scores with `thesis` "
        + ", ".join(
            f"{each('ddpg', env, 'thesis')} on `{env}`"
            for env in ("cartpole", "pendulum", "swingup", "highway")
        )
        + ".",
        f"π\\* of `batch` scores {each('star', 'cartpole', 'batch')} on cart-pole, that of `thesis` "
        f"{each('star', 'cartpole', 'thesis')}.",
        f"With an end that pays 0, π_R on cart-pole scores {after[0]}.",
        f"π\\* there scores {after[1]}.",
    ]


def test_what_the_thesiss_arms_show_is_that_of_the_file() -> None:
    claims = claims_of_arms(rows_of(ROOT / "results/studies/thesis_arms.csv"))
    page = marked("results/reference/thesis/FINDINGS.md", "what the arms show").splitlines()
    assert page == [f"- {claim}" for claim in claims]


@pytest.mark.parametrize("path", RUNS, ids=lambda path: path.name)
def test_runs_of_the_board_are_whole_and_policies_score_as_they_say(path: Path, tmp_path: Path) -> None:
    with open_to_verify(path) as run:
        assert not run.damaged()
        results, unusable = run.load()
        assert set(results) == set(run.request.cells)
    assert not unusable
    env, _, demos = path.name.rpartition("_")
    gail = Cell(env, "gail", 0, Shown(int(demos)))
    if not results[gail].learned:
        assert [other.name.rpartition("_")[0] for other in RUNS].count(env) == 2
        return
    (row,) = [row for row in results[gail].rows if row.policy == "pi_R"]
    found = load_learned(export(path, env, "gail", policy="pi_R", to=tmp_path / "learned"))
    assert found.reward is not None
    scored = evaluate(SPECS[env], found.policy, evaluation_seeds(0, row.episodes), found.reward)
    # This process has other instructions than the run.
    assert scored.returns.mean() == pytest.approx(row.return_mean, rel=0.01)
    assert scored.own_return == pytest.approx(row.own_return, rel=0.01)
