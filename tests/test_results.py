"""What is committed below results/ is described, and pages have its numbers."""

import ast
import csv
import importlib
import importlib.util
import re
from collections import Counter
from pathlib import Path

import pytest

from harness.api.exported import export, load_learned
from harness.judge.evaluation import evaluate
from harness.records import Cell, Shown
from harness.registry import SPECS
from harness.rl.seeds import evaluation_seeds
from harness.store.opening import open_to_verify

ROOT = Path(__file__).parent.parent
REFERENCE = ROOT / "results/reference"
SCRIPTS = sorted((ROOT / "results").rglob("*.py"))


PARTS = sorted((ROOT / "results/parts/board").iterdir())


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


def test_the_picture_of_the_board_is_of_the_runs() -> None:
    """Its numbers are those of the runs' files, and the picture is drawn of them by one command."""
    spec = importlib.util.spec_from_file_location("drawn_board", REFERENCE / "board/board.py")
    assert spec
    assert spec.loader
    board = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(board)
    lines = rows_of(REFERENCE / "board/board.csv")
    assert len(lines) > 100
    assert board.board().to_csv(index=False, lineterminator="\n").splitlines() == (
        (REFERENCE / "board/board.csv").read_text(encoding="utf-8").splitlines()
    )
    names = ("env", "dynamics", "demos", "method", "policy")
    for line in lines:
        demos = "0" if line["demos"] == "100" else line["demos"]
        asked = (line["task"], "nominal", demos, line["method"], line["policy"])
        entries = rows_of(REFERENCE / "board" / line["run"] / "leaderboard.csv")
        (entry,) = [entry for entry in entries if tuple(entry[name] for name in names) == asked]
        for name in ("mean", "low", "high"):
            assert float(line[name]) == pytest.approx(float(entry[f"score_{name}"]), rel=1e-12)
        assert line["seeds"] == entry["seeds_ok"]
    texts = [text.get_text() for axes in board.figure(board.board()).axes for text in axes.texts]
    assert sorted(text for text in texts if "." in text) == sorted(f"{float(x['mean']):z.2f}" for x in lines)


def test_what_rl_earns_of_the_thesiss_reward_is_that_of_the_files() -> None:
    """R* of demonstrations is that where they were shown, in the task's own dynamics."""
    _, *lines = cells_of(marked("results/reference/thesis/FINDINGS.md", "own returns of shaped"))
    assert len(lines) > 10
    for run, quoted, *shown in lines:
        rows = rows_of(REFERENCE / "board" / run.strip("`") / "leaderboard.csv")
        demos = min(row["demos"] for row in rows)
        entries = {
            (row["env"], row["dynamics"], row["method"]): row
            for row in rows
            if (row["demos"], row["every"], row["policy"]) == (demos, "1", "pi_R")
        }
        env, _, variant = quoted.strip("`").partition(".")
        there, own, true = (
            entries[env, dynamics, method]
            for dynamics, method in (
                *((variant or "nominal", "shaped"), ("nominal", "shaped")),
                (variant or "nominal", "control_true"),
            )
        )
        returns = [f"{float(x):,.1f}" for x in (own["own_return_shown"], there["own_return"])]
        scores = [f"{float(row['score_mean']):z.2f}" for row in (there, true)]
        assert shown == [there["seeds_ok"], *returns, *scores], (run, quoted)


def test_the_failed_solves_of_the_findings_are_those_of_the_file() -> None:
    rows = rows_of(ROOT / "results/studies/rl_solves.csv")
    failed = [row for row in rows if row["solved"] == "0"]
    chosen, failed_chosen = (sum(row["chosen"] == "1" for row in some) for some in (rows, failed))
    methods, failures = (Counter(row["method"] for row in some) for some in (rows, failed))
    by_method = sorted(methods, key=lambda method: (-failures[method], method))
    counts = ", ".join(f"`{method}` {failures[method]} of {methods[method]}" for method in by_method)
    assert marked("docs/findings.md", "failed solves").splitlines() == [
        f"Of single solves {len(failed)} of {len(rows)} fail, "
        f"and of chosen ones {failed_chosen} of {chosen}.",
        f"By method, single solves on both tasks: {counts}.",
    ]


@pytest.mark.parametrize("env", ["cartpole", "pendulum"])
def test_the_tables_of_the_two_by_two_are_those_of_the_files(env: str) -> None:
    heading, *lines = cells_of(marked("docs/termination.md", f"the 2 x 2 on {env}"))
    scores = {}
    for protocol in heading[1:]:
        for row in rows_of(REFERENCE / "termination" / protocol / "leaderboard.csv"):
            if (row["env"], row["policy"]) == (env, "pi_R"):
                mean, low, high = (float(row[f"score_{name}"]) for name in ("mean", "low", "high"))
                scores[f"`{row['method']}`", protocol] = f"{mean:z.2f} [{low:z.2f}, {high:z.2f}]"
    shown = {
        (line[0], name): score for line in lines for name, score in zip(heading[1:], line[1:], strict=True)
    }
    assert shown == scores


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


@pytest.mark.parametrize("part", PARTS, ids=lambda part: part.name)
def test_parts_of_the_board_are_whole_and_policies_score_as_they_say(part: Path, tmp_path: Path) -> None:
    with open_to_verify(part) as run:
        assert not run.damaged()
        results, unusable = run.load()
        assert set(results) == set(run.request.cells)
    assert not unusable
    env, _, demos = part.name.rpartition("_")
    gail = Cell(env, "gail", 0, Shown(int(demos)))
    if not results[gail].learned:
        assert [other.name.rpartition("_")[0] for other in PARTS].count(env) == 2
        return
    (row,) = [row for row in results[gail].rows if row.policy == "pi_R"]
    found = load_learned(export(part, env, "gail", policy="pi_R", to=tmp_path / "learned"))
    assert found.reward is not None
    scored = evaluate(SPECS[env], found.policy, evaluation_seeds(0, row.episodes), found.reward)
    # This process has other instructions than the run.
    assert scored.returns.mean() == pytest.approx(row.return_mean, rel=0.01)
    assert scored.own_return == pytest.approx(row.own_return, rel=0.01)
