"""The thesis's evaluation (sections 5.1 to 5.3), and the study of its open question: why does RL on R* fail
where pi* succeeds? Files:

DIR/study.json              The mark of the directory.
DIR/native, DIR/absorbing   A run's directory for each protocol.
DIR/scores.csv              Their scores.
DIR/study.csv, .md          The scores' means over seeds, with intervals.
DIR/<env>_figure_5_3.png    The thesis's figure.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pandas as pd
from matplotlib.figure import Figure

from harness.judge.leaderboard import Entry, leaderboard, scored_rows
from harness.judge.rows import SURVIVAL
from harness.records import ALL_SHOWN, COLUMNS, CONTROLS, REFERENCE, UNSHOWN, CellResult, Shown
from harness.registry import BadInput, LearnerName
from harness.report.columns import score
from harness.report.figures import BLUE, ORANGE, as_file, plot_seeds, styled
from harness.report.tables import as_csv, frame_of
from harness.store.files import write_atomic
from harness.store.marked import open_marked
from harness.store.opening import STUDY

ENVS, PROTOCOLS = ("cartpole", "pendulum"), ("absorbing", "native")
TRAJECTORIES = (1, 5, 20, 100)
LEARNER: LearnerName = "ddpg"
"""The thesis's learner."""
SOLVES = 3
"""RL solves of each learned reward."""
STUDIED = ("shaped_thesis", "shaped", "shaped_decay", "bc")
"""The thesis's model to the letter, this benchmark's, the latter with the weight regularisation that section
5.3 suspects, and behaviour cloning."""
THESIS = ("shaped_thesis", Shown(100))
"""The method and demonstrations that the thesis evaluates."""
GREEN, YELLOW = "#009e73", "#e69f00"
TABLE = {
    **{"env": "env", "protocol": "protocol", "method": "method", "demos": "trajectories", "policy": "policy"},
    **{"seeds_ok": "seeds", "score_mean": "score", "score_low": "low", "score_high": "high"},
    **{"return_mean": "return", "discounted_mean": "discounted return"},
}
"""The study's columns, by the leaderboard's."""
MARK = b'{"study": "thesis", "format": 1}\n'
Runs = dict[str, list[CellResult]]
"""The results of each protocol's run."""


@contextmanager
def open_study(path: Path) -> Iterator[None]:
    """Hold a new or continued study in `path` until the context ends.

    Raises BadInput, having changed nothing, where `path` is anything else or cannot be written.
    """
    for protocol in PROTOCOLS:
        if (path / protocol).is_symlink():
            raise BadInput(f"cannot use {path / protocol}: it is a link")
    with open_marked(path, STUDY, MARK, "study", lambda data: data == MARK):
        yield


def write_study(directory: Path, runs: Runs) -> None:
    """Write tables and figures into `directory`."""
    rows = [row for results in runs.values() for row in scored_rows(results)]
    write_atomic(directory / "scores.csv", as_csv(frame_of(rows, COLUMNS)))
    entries = [entry for results in runs.values() for entry in leaderboard(scored_rows(results))]
    order = (*STUDIED, *CONTROLS, REFERENCE)
    entries.sort(
        key=lambda e: (ENVS.index(e.env), PROTOCOLS.index(e.protocol), order.index(e.method), e.demos)
    )
    lines = [vars(entry) for entry in entries if entry.method != REFERENCE]
    table = pd.DataFrame(lines)[list(TABLE)].rename(columns=TABLE)
    trajectories = table["trajectories"].astype(object)
    table["trajectories"] = trajectories.where(~table["method"].isin(UNSHOWN), "")
    table = table.drop_duplicates(ignore_index=True)
    write_atomic(directory / "study.csv", as_csv(table))
    write_atomic(directory / "study.md", _markdown(table))
    for env in dict.fromkeys(entry.env for entry in entries):
        with styled():
            write_atomic(directory / f"{env}_figure_5_3.png", as_file(_figure_5_3(env, runs), "png"))


def closing_lines(runs: Runs, directory: Path) -> list[str]:
    """Return the terminal's last lines: for each protocol and task the scores of the thesis's method and of
    the control that only pays for staying alive."""
    lines = []
    for protocol, results in runs.items():
        boards: dict[str, dict[tuple[str, str], Entry]] = {}
        for entry in leaderboard(scored_rows(results)):
            if entry.shown == THESIS[1]:
                name = SURVIVAL if entry.role == SURVIVAL else entry.method
                boards.setdefault(entry.env, {})[name, entry.policy] = entry
        for env, board in boards.items():
            star, trained = (score(board[THESIS[0], policy]) for policy in ("pi_star", "pi_R"))
            alive = board[SURVIVAL, "pi_R"]
            scores = f"pi* {star}, pi_R {trained}; {alive.method} {score(alive)}"
            lines.append(f"{env}, {protocol}: {scores}")
    return [*lines, f"look at {directory / 'study.md'}, and the figures there"]


def _markdown(table: pd.DataFrame) -> str:
    texts = table.map(lambda value: f"{value:.3g}" if isinstance(value, float) else str(value))
    lines = [[*table.columns], ["---"] * len(table.columns), *texts.to_numpy().tolist()]
    return "".join("| " + " | ".join(line) + " |\n" for line in lines)


def _figure_5_3(env: str, runs: Runs) -> Figure:
    """Draw learning curves on the true reward and on R*, the latter under both, and the level of pi*."""
    figure = Figure(figsize=(9, 3.6), layout="constrained")
    for axes, protocol in zip(figure.subplots(1, 2), PROTOCOLS, strict=True):
        curves: dict[tuple[str, Shown, str], list[list[tuple[float, float]]]] = {}
        for result in (result for result in runs[protocol] if result.cell.env == env):
            cell = result.cell
            for name, points in result.curves.items():
                curves.setdefault((cell.method, cell.shown, name), []).append(points)
            if (cell.method, cell.shown) == THESIS:
                star = next(row.return_mean for row in result.rows if row.policy == "pi_star")
                axes.axhline(star, color=GREEN, linestyle=":", linewidth=1.5)
        under = axes.twinx()
        under.spines["right"].set_visible(True)
        plot_seeds(axes, curves.get(("control_true", ALL_SHOWN, "pi_R_true"), []), BLUE)
        plot_seeds(under, curves.get((*THESIS, "pi_R"), []), YELLOW)
        plot_seeds(axes, curves.get((*THESIS, "pi_R_true"), []), ORANGE)
        axes.set(title=f"{env}, {protocol}", xlabel="environment steps", ylabel="true return")
        under.set_ylabel("return under R*", color=YELLOW)
    lines = {
        "DDPG on the true reward": (BLUE, "-"),
        "π*": (GREEN, ":"),
        "DDPG on R*, under R*": (YELLOW, "-"),
        "the same, true return": (ORANGE, "-"),
    }
    handles = [axes.plot([], [], color=c, linestyle=s, label=name)[0] for name, (c, s) in lines.items()]
    figure.legend(handles=handles, loc="outside upper center", ncols=4, frameon=False)
    return figure
