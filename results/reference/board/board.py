"""The board: the score of each method's policy (pi*) in each task, and that of a policy trained from scratch
on its reward (pi_R), over five seeds, three on `drive`.

board.csv has the numbers and board.png the picture, both of the leaderboard.csv of the runs beside this file.
solves.csv says of how many solves RL did not solve the reward, and of how many rewards the chosen solve did
not. over_tasks.csv has each policy over all tasks with five demonstrations. From the root:

    python results/reference/board/board.py
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import NamedTuple

import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from harness.judge.across_tasks import indistinct, overall
from harness.judge.leaderboard import leaderboard, scored_rows
from harness.records import CONTROLS, NOMINAL, CellResult
from harness.registry import METHODS, VARIANTS
from harness.report.figures import ORANGE, as_file, styled
from harness.store.opening import open_to_verify

HERE = Path(__file__).parent


class Column(NamedTuple):
    task: str
    demos: int
    dynamics: str = NOMINAL

    @property
    def run(self) -> str:
        return f"{self.task}_{self.demos}"


COLUMNS = [
    Column("cartpole", 100),
    Column("pendulum", 100),
    Column("highway", 100),
    Column("cartpole", 5),
    Column("highway", 5),
    Column("reacher", 5),
    Column("swingup", 5),
    Column("cartpole_swingup", 5),
    Column("point_maze", 5),
    Column("drive", 5),
    Column("swingup", 5, "flipped"),
    Column("point_maze", 5, "wall_moved"),
]
POLICIES = {
    "pi_star": "π*: the policy that the method returns",
    "pi_R": "π_R: a policy trained on the reward that it returns",
}
NUMBERS = {"score_mean": "mean", "score_low": "low", "score_high": "high", "score_unsolved": "mean_unsolved"}
LIGHT, DARK = "#ffffff", "#08306b"


def board() -> pd.DataFrame:
    """A row for each policy of a method or a control in a column: its mean over the seeds on which RL solved
    R*, that mean's interval, and the mean over the others."""
    its = ["method", "policy", "seeds", "seeds_scored", "unsolved", *NUMBERS]
    tables = []
    for column in COLUMNS:
        found = pd.read_csv(HERE / column.run / "leaderboard.csv")
        here = (found["dynamics"] == column.dynamics) & (found["status"] == "ok")
        chosen = found[here & (found["role"] != "reference")]
        tables.append(chosen[its].assign(**column._asdict()))
    return pd.concat(tables)[[*Column._fields, *its]].rename(columns=NUMBERS)


def results_of(column: Column) -> list[CellResult]:
    """Return the results of its cells."""
    with open_to_verify(HERE / column.run) as run:
        results, damaged = run.load()
    assert not damaged
    return [result for cell, result in results.items() if cell.dynamics == column.dynamics]


def over_tasks() -> pd.DataFrame:
    """A row for each policy over the tasks with five demonstrations that tell rewards from uninformed ones.

    Columns: method, policy, runs (seeds of all tasks, less the `unsolved` ones), interquartile_mean, low and
    high (its 90 % interval), reach_0.9 (the share of runs), beside (the mean difference to the mean of the
    other methods, paired by seed), p (of that, after Holm), better_than.
    """
    shown = [column for column in COLUMNS if (column.demos, column.dynamics) == (5, NOMINAL)]
    shown.remove(Column("drive", 5))  # which has four methods
    scored = scored_rows([result for column in shown for result in results_of(column)])
    lines = overall(scored, [*indistinct(leaderboard(scored))])
    rows = [
        {
            **{"method": line.method, "policy": line.policy, "runs": line.runs, "unsolved": line.unsolved},
            **{"interquartile_mean": line.score, "low": line.low, "high": line.high},
            **{"reach_0.9": line.reached, "beside": line.beside and line.beside.mean},
            **{"p": line.beside and line.beside.p, "better_than": " ".join(line.better_than)},
        }
        for line in lines
    ]
    return pd.DataFrame(rows).round(3)


def solves() -> pd.DataFrame:
    """A row for each method in a run: task, demos, method, its solves and rewards, and those of them that
    failed. Rewards without a verdict are left out."""
    rows = []
    for column in (column for column in COLUMNS if column.dynamics == NOMINAL):
        for result in results_of(column):
            chosen = [
                row.solved for row in result.rows if row.policy == "pi_R" and not math.isnan(row.solved)
            ]
            if chosen:
                single = [solve.solved for solve in result.solves]
                numbers = (len(single), single.count(0), 1, chosen.count(0))
                rows.append((column.task, column.demos, result.cell.method, *numbers))
    names = ["task", "demos", "method", "solves", "solves_failed", "rewards", "rewards_failed"]
    return pd.DataFrame(rows, columns=names).groupby(names[:3], sort=False, as_index=False).sum()


def figure(scores: pd.DataFrame) -> Figure:
    """A panel for each policy, a row for each method, a column for each task."""
    present = set(scores["method"])
    groups = [[name for name in names if name in present] for names in (METHODS, VARIANTS, CONTROLS)]
    methods = [name for names in groups for name in names]
    at = scores.set_index([*Column._fields, "policy", "method"])
    columns = {
        policy: [c for c in COLUMNS if policy == "pi_R" or c.dynamics == NOMINAL] for policy in POLICIES
    }
    drawn = Figure(figsize=(11, 8.6), layout="constrained")
    panels = drawn.subplots(1, 2, width_ratios=[len(its) for its in columns.values()])
    for axes, (policy, its) in zip(panels, columns.items(), strict=True):
        for x, column in enumerate(its):
            for y, method in enumerate(methods):
                if (*column, policy, method) in at.index:
                    row = at.loc[(*column, policy, method)]
                    _cell(axes, x, y, float(row["mean"]), int(row["unsolved"]))
            axes.text(x, len(methods) + 0.1, f"{column.demos}", ha="center", va="center", fontsize=9)
        names = [c.task if c.dynamics == NOMINAL else f"{c.task}.{c.dynamics}" for c in its]
        axes.set_xticks(range(len(its)), names, rotation=50, ha="left", rotation_mode="anchor", fontsize=9)
        labels = [*methods, "demonstrations"] if policy == "pi_star" else []
        axes.set_yticks([y + 0.1 * (y >= len(methods)) for y in range(len(labels))], labels)
        axes.xaxis.tick_top()
        axes.tick_params(length=0)
        axes.spines[:].set_visible(False)
        axes.set_xlim(-0.5, len(its) - 0.5)
        axes.set_ylim(len(methods) + 0.6, -0.5)
        for line in (len(groups[0]), len(groups[0]) + len(groups[1]), len(methods)):
            axes.axhline(line - 0.5, color="#888888", linewidth=0.8)
        if policy == "pi_R":
            top = 0
            for title, names in zip(("methods", "variants", "controls"), groups, strict=True):
                middle = top + (len(names) - 1) / 2
                axes.text(len(its) - 0.3, middle, title, rotation=270, va="center", fontsize=9)
                top += len(names)
        axes.set_title(POLICIES[policy], fontsize=10.5, fontweight="bold", y=1.17, pad=0)
    drawn.supxlabel(
        "Score: 0 is a random policy, 1 the expert. A dot is a seed on which RL did not solve the reward, so "
        "that it is left out, and / says that all are.\nIn other dynamics 1 is what RL reaches on the true "
        "reward, and no dot means little: π* carried over is the measure.\nEmpty: there is no such policy, "
        "or it was not run (drive, three seeds).",
        fontsize=9,
    )
    return drawn


def _cell(axes: Axes, x: int, y: int, score: float, unsolved: int) -> None:
    share = min(max(score, 0.0), 1.0) if score == score else 0.0
    light, dark = ([int(c[i : i + 2], 16) / 255 for i in (1, 3, 5)] for c in (LIGHT, DARK))
    colour = tuple(a + share * (b - a) for a, b in zip(light, dark, strict=True))
    axes.fill_between([x - 0.48, x + 0.48], y - 0.46, y + 0.46, facecolor=colour, edgecolor="#cccccc", lw=0.4)
    axes.text(
        *(x, y, f"{score:z.2f}" if score == score else "/"),
        ha="center",
        va="center_baseline",
        fontsize=8.5,
        color="white" if share > 0.45 else "#222222",
    )
    if unsolved:
        places = [x + 0.18 * (number - (unsolved - 1) / 2) for number in range(unsolved)]
        axes.plot(places, [y + 0.36] * unsolved, "o", color=ORANGE, markersize=2.2, linestyle="")


if __name__ == "__main__":
    found = board()
    found.to_csv(HERE / "board.csv", index=False, lineterminator="\n")
    solves().to_csv(HERE / "solves.csv", index=False, lineterminator="\n")
    over_tasks().to_csv(HERE / "over_tasks.csv", index=False, lineterminator="\n")
    with styled():
        (HERE / "board.png").write_bytes(as_file(figure(found), "png"))
