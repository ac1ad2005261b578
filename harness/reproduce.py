"""The thesis's evaluation (sections 5.1 to 5.3) once more, and the study that its open question asks for:
why does RL on R* fail where pi* succeeds? What is written:

DIR/study.json              marks the directory
DIR/native, DIR/absorbing       a run's directory for each protocol
DIR/scores.csv                  their scores
DIR/study.csv, .md              the same over seeds, with 95 % intervals
DIR/<env>_figure_5_3.png        the thesis's figure
DIR/<env>_study.png             scores against the number of trajectories
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from harness.judge.leaderboard import Entry, leaderboard, scored_rows
from harness.judge.results import ALL_SHOWN, COLUMNS, CONTROLS, REFERENCE, UNSHOWN, CellResult, Shown
from harness.judge.roles import SURVIVAL
from harness.registry import BadInput, LearnerName
from harness.show.figures import BLUE, ORANGE, plot_seeds, png, styled
from harness.show.report import frame_of
from harness.show.spreadsheet import as_csv
from harness.show.terminal import score_of
from harness.store.files import write_atomic
from harness.store.marked import open_marked
from harness.store.opening import STUDY

ENVS, PROTOCOLS = ("cartpole", "pendulum"), ("absorbing", "native")
TRAJECTORIES = (1, 5, 20, 100)
LEARNER: LearnerName = "ddpg"
"""The thesis's learner."""
SOLVES = 3
"""RL solves of each learned reward."""
STUDIED = ("shaped", "shaped_decay", "bc")
"""The thesis's model, without and with the weight regularisation that its section 5.3 suspects, and behaviour
cloning on as much."""
THESIS = ("shaped", Shown(100))
"""What the thesis evaluates."""
GREEN, YELLOW = "#009e73", "#e69f00"
LINES = (
    ("shaped", "pi_star", BLUE, "-", r"$\pi^*$"),
    ("shaped_decay", "pi_star", BLUE, "--", r"$\pi^*$, with weight decay"),
    ("bc", "pi_star", GREEN, "-", "behaviour cloning"),
    ("shaped", "pi_R", ORANGE, "-", r"$\pi_R$"),
    ("shaped_decay", "pi_R", ORANGE, "--", r"$\pi_R$, with weight decay"),
)
"""Method, policy, colour, style and label of each line of the study's figure."""
MARK = b'{"study": "thesis", "format": 1}\n'


@contextmanager
def open_study(path: Path) -> Iterator[None]:
    """Starts a study in `path`, which is made, or continues the one there; held until the context ends.
    Raises BadInput, having changed nothing, where `path` is anything else, or cannot be written."""
    for protocol in PROTOCOLS:
        if (path / protocol).is_symlink():
            raise BadInput(f"cannot use {path / protocol}: it is a link")
    unfinished = r"scores\.csv|study\.(csv|md)|\w+\.png"
    with open_marked(path, STUDY, MARK, "study", lambda data: data == MARK, unfinished):
        yield


def write_study(directory: Path, runs: dict[str, list[CellResult]]) -> None:
    """Writes tables and figures into `directory` from the results of each protocol's run."""
    rows = [row for results in runs.values() for row in scored_rows(results)]
    write_atomic(directory / "scores.csv", as_csv(frame_of(rows, COLUMNS)))
    entries = [entry for results in runs.values() for entry in leaderboard(scored_rows(results))]
    order = (*STUDIED, *CONTROLS, REFERENCE)
    entries.sort(
        key=lambda e: (ENVS.index(e.env), PROTOCOLS.index(e.protocol), order.index(e.method), e.demos)
    )
    lines = [_line(entry) for entry in entries if entry.method != REFERENCE]
    table = pd.DataFrame(lines).drop_duplicates(ignore_index=True)
    write_atomic(directory / "study.csv", as_csv(table))
    write_atomic(directory / "study.md", _markdown(table))
    for env in dict.fromkeys(entry.env for entry in entries):
        mine = [entry for entry in entries if entry.env == env]
        results = {p: [r for r in found if r.cell.env == env] for p, found in runs.items()}
        with styled():
            write_atomic(directory / f"{env}_figure_5_3.png", png(_figure_5_3(env, results)))
            write_atomic(directory / f"{env}_study.png", png(_study(env, mine)))


def found(runs: dict[str, list[CellResult]], directory: Path) -> list[str]:
    """What the terminal shows: what the thesis evaluates, by task and protocol, beside the control that only
    says "stay alive"; and where all is."""
    lines = []
    for protocol, results in runs.items():
        boards: dict[str, dict[tuple[str, str], Entry]] = {}
        for entry in leaderboard(scored_rows(results)):
            if entry.shown == THESIS[1]:
                boards.setdefault(entry.env, {})[entry.role, entry.policy] = entry
                boards[entry.env][entry.method, entry.policy] = entry
        for env, its in boards.items():
            star, trained = its[THESIS[0], "pi_star"], its[THESIS[0], "pi_R"]
            alive = its[SURVIVAL, "pi_R"]
            lines.append(
                f"{env}, {protocol}: pi* {score_of(star)}, pi_R {score_of(trained)}; "
                f"{alive.method} {score_of(alive)}"
            )
    return [*lines, f"look at {directory / 'study.md'}, and the figures there"]


def _line(entry: Entry) -> dict[str, str | int | float]:
    return {
        "env": entry.env,
        "protocol": entry.protocol,
        "method": entry.method,
        "trajectories": "" if entry.method in UNSHOWN else entry.demos,
        "policy": entry.policy,
        "seeds": entry.seeds_ok,
        "score": entry.score_mean,
        "low": entry.score_low,
        "high": entry.score_high,
        "return": entry.return_mean,
        "discounted return": entry.discounted_mean,
    }


def _markdown(table: pd.DataFrame) -> str:
    def text(value: object) -> str:
        return f"{value:.3g}" if isinstance(value, float) else str(value)

    lines = [list(table.columns), ["---"] * len(table.columns)]
    lines += [[text(value) for value in line] for line in table.itertuples(index=False)]
    return "".join("| " + " | ".join(line) + " |\n" for line in lines)


def _figure_5_3(env: str, runs: dict[str, list[CellResult]]) -> Figure:
    """Learning curves on the true reward and on R*, the latter under both rewards, and the level of pi*."""
    figure = Figure(figsize=(9, 3.6), layout="constrained")
    for place, protocol in enumerate(PROTOCOLS):
        curves: dict[tuple[str, Shown, str], list[list[tuple[float, float]]]] = {}
        stars = []
        for result in runs[protocol]:
            for name, points in result.curves.items():
                curves.setdefault((result.cell.method, result.cell.shown, name), []).append(points)
            if (result.cell.method, result.cell.shown) == THESIS:
                stars += [row.return_mean for row in result.rows if row.policy == "pi_star"]
        axes: Axes = figure.add_subplot(1, 2, place + 1)
        under = axes.twinx()
        under.spines["right"].set_visible(True)
        plot_seeds(axes, curves.get(("control_true", ALL_SHOWN, "pi_R_true"), []), BLUE)
        plot_seeds(under, curves.get((*THESIS, "pi_R"), []), YELLOW)
        plot_seeds(axes, curves.get((*THESIS, "pi_R_true"), []), ORANGE)
        for level in stars:
            axes.axhline(level, color=GREEN, linestyle=":", linewidth=1.5)
        axes.set_title(f"{env}, {protocol}")
        axes.set_xlabel("environment steps")
        axes.set_ylabel("true return")
        under.set_ylabel("return under R*", color=YELLOW)
    lines = {
        "DDPG on the true reward": (BLUE, "-"),
        "$\\pi^*$": (GREEN, ":"),
        "DDPG on R*, under R*": (YELLOW, "-"),
        "the same, true return": (ORANGE, "-"),
    }
    handles = [axes.plot([], [], color=c, linestyle=s, label=name)[0] for name, (c, s) in lines.items()]
    figure.legend(handles=handles, loc="outside upper center", ncols=4, frameon=False)
    return figure


def _study(env: str, entries: Sequence[Entry]) -> Figure:
    """Scores of pi* and pi_R against trajectories, and the controls as lines."""
    figure = Figure(figsize=(9, 3.8), layout="constrained")
    found = {(e.protocol, e.method, e.demos, e.policy): e for e in entries}
    first: Axes | None = None
    for place, protocol in enumerate(PROTOCOLS):
        axes: Axes = figure.add_subplot(1, 2, place + 1, sharey=first)
        first = first or axes
        for shift, (method, policy, colour, style, label) in enumerate(LINES):
            points = [
                (n * (0.94 + 0.03 * shift), entry)
                for n in TRAJECTORIES
                if (entry := found.get((protocol, method, n, policy))) and math.isfinite(entry.score_mean)
            ]
            axes.errorbar(
                [x for x, _ in points],
                [e.score_mean for _, e in points],
                [
                    [max(0.0, e.score_mean - e.score_low) for _, e in points],  # of equals, rounding
                    [max(0.0, e.score_high - e.score_mean) for _, e in points],
                ],
                color=colour,
                linestyle=style,
                label=label,
                marker="o",
                markersize=4,
                linewidth=1.2,
            )
        for level, names in _controls([e for e in entries if e.protocol == protocol]).items():
            axes.axhline(level, color="#999999", linewidth=0.8, linestyle=":")
            axes.text(1.01, level, names, transform=axes.get_yaxis_transform(), fontsize=7, va="center")
        axes.set_xscale("log")
        axes.set_xticks(TRAJECTORIES, [str(n) for n in TRAJECTORIES])
        axes.minorticks_off()
        axes.set_title(f"{env}, {protocol}")
        axes.set_xlabel("trajectories")
    assert first is not None
    first.set_ylabel("normalized score, 95 % intervals")
    figure.legend(*first.get_legend_handles_labels(), loc="outside upper center", ncols=4, frameon=False)
    return figure


def _controls(entries: Sequence[Entry]) -> dict[float, str]:
    """The controls' scores, of as many trajectories as the thesis has, and the names of all that are about as
    high."""
    mine = [e for e in entries if e.method in CONTROLS and e.demos == THESIS[1].demos]
    scores = {e.method: e.score_mean for e in mine}
    levels: dict[float, str] = {}
    for name, score in sorted(scores.items(), key=lambda item: item[1]):
        near = [level for level in levels if score - level < 0.03]
        if near:
            levels[near[0]] += f", {name[8:]}"
        elif math.isfinite(score):
            levels[score] = name[8:]
    return levels
