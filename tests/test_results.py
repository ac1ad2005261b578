"""What is committed below results/ is described, and two pages have its numbers: thesis and termination."""

import ast
import importlib
import re
from pathlib import Path

import numpy as np
import pytest

from harness.judge.leaderboard import scored_rows
from harness.records import NOMINAL
from harness.store.opening import open_to_verify
from tests.pages import REFERENCE, ROOT, cells_of, leaderboard, marked, rows_of

SCRIPTS = sorted((ROOT / "results").rglob("*.py"))


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
