"""The board: how well each method's policy (pi*) does in each task, and how well a policy does that is
trained from scratch on its reward (pi_R). Tasks are those of three seeds or more; scores are means over
seeds.

board.png is the picture, and board.csv its numbers, both of the runs' leaderboard.csv beside this file. From
the root:

    python results/reference/board/board.py
"""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from harness.registry import METHODS
from harness.report.figures import as_file, styled

HERE = Path(__file__).parent


class Column(NamedTuple):
    """A task: its runs, the first of which counts where several have a method."""

    task: str
    demos: int
    runs: tuple[str, ...]


COLUMNS = (
    Column("cartpole", 100, ("cartpole",)),
    Column("pendulum", 100, ("pendulum",)),
    Column("highway", 100, ("highway",)),
    Column("reacher", 5, ("reacher_5",)),
    Column("swingup", 5, ("swingup_5",)),
    Column("cartpole_swingup", 5, ("cartpole_swingup_5",)),
    Column("point_maze", 5, ("point_maze_5",)),
    Column("halfcheetah", 5, ("halfcheetah_5_retrained", "halfcheetah_5")),
    Column("hopper", 5, ("hopper_5",)),
)
VARIANTS = ("gail_mean", "airl", "maxent_state")
CONTROLS = ("control_true", "control_clone", "control_shuffled", "control_survival")
POLICIES = {
    "pi_star": "π*: the policy that the method returns",
    "pi_R": "π_R: a policy trained on the reward that it returns",
}
LIGHT, DARK = "#ffffff", "#08306b"


def board() -> pd.DataFrame:
    """A row for each score: task, demos, seeds, method, policy, mean, low, high, run."""
    rows = []
    for task, demos, runs in COLUMNS:
        seen: set[tuple[str, str]] = set()
        for run in runs:
            found = pd.read_csv(HERE / run / "leaderboard.csv")
            full = 0 if demos == 100 else demos  # all that the budget gives are 100
            here = found[
                (found["dynamics"] == "nominal") & (found["demos"] == full) & (found["status"] == "ok")
            ]
            for row in here.itertuples():
                if row.method in (*METHODS, *VARIANTS, *CONTROLS) and (row.method, row.policy) not in seen:
                    seen.add((row.method, row.policy))
                    score = (row.score_mean, row.score_low, row.score_high)
                    rows.append((task, demos, row.seeds_ok, row.method, row.policy, *score, run))
    names = ["task", "demos", "seeds", "method", "policy", "mean", "low", "high", "run"]
    return pd.DataFrame(rows, columns=names)


def figure(scores: pd.DataFrame) -> Figure:
    """A panel a policy, a row a method, a column a task."""
    methods = [*METHODS, *VARIANTS, *CONTROLS]
    seeds = {
        task: "-".join(f"{number}" for number in sorted({min(its), max(its)}))
        for task, its in scores.groupby("task")["seeds"]
    }
    drawn = Figure(figsize=(10, 6.6), layout="constrained")
    for place, (policy, title) in enumerate(POLICIES.items()):
        axes = drawn.add_subplot(1, 2, place + 1)
        its = scores[scores["policy"] == policy].set_index(["task", "method"])["mean"]
        for x, column in enumerate(COLUMNS):
            for y, method in enumerate(methods):
                if (column.task, method) in its.index:
                    _cell(axes, x, y, float(its[column.task, method]))
            for below, number in enumerate((column.demos, seeds[column.task])):
                axes.text(x, len(methods) + 0.1 + below, f"{number}", ha="center", va="center", fontsize=9)
        names = [column.task for column in COLUMNS]
        axes.set_xticks(range(len(names)), names, rotation=40, ha="left", rotation_mode="anchor")
        labels = [*methods, "demonstrations", "seeds"] if place == 0 else []
        axes.set_yticks([y + 0.1 * (y >= len(methods)) for y in range(len(labels))], labels)
        axes.xaxis.tick_top()
        axes.tick_params(length=0)
        axes.spines[:].set_visible(False)
        axes.set_xlim(-0.5, len(COLUMNS) - 0.5)
        axes.set_ylim(len(methods) + 1.6, -0.5)
        for line in (len(METHODS), len(METHODS) + len(VARIANTS), len(methods)):
            axes.axhline(line - 0.5, color="#888888", linewidth=0.8)
        axes.set_title(title, fontsize=10.5, fontweight="bold")
    drawn.supxlabel(
        "score: 0 is a random policy, 1 the expert; empty: not run, or learns no reward", fontsize=9
    )
    return drawn


def _cell(axes: Axes, x: int, y: int, score: float) -> None:
    share = min(max(score, 0.0), 1.0)
    light, dark = ([int(c[i : i + 2], 16) / 255 for i in (1, 3, 5)] for c in (LIGHT, DARK))
    colour = tuple(a + share * (b - a) for a, b in zip(light, dark, strict=True))
    axes.fill_between([x - 0.48, x + 0.48], y - 0.46, y + 0.46, facecolor=colour, edgecolor="#cccccc", lw=0.4)
    axes.text(
        *(x, y + 0.03, f"{score:z.2f}"),
        ha="center",
        va="center",
        fontsize=9,
        color="white" if share > 0.45 else "#222222",
    )


if __name__ == "__main__":
    found = board()
    found.to_csv(HERE / "board.csv", index=False, lineterminator="\n")
    with styled():
        (HERE / "board.png").write_bytes(as_file(figure(found), "png"))
