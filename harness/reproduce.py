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
from typing import Any

import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from harness.judge.leaderboard import Entry, leaderboard, scored_rows
from harness.judge.results import COLUMNS, CONTROLS, REFERENCE, CellResult
from harness.registry import BadInput
from harness.run.files import write_atomic
from harness.run.marked import open_marked
from harness.run.study import ARMS, CLONES, DECAYS, THESIS, TRAJECTORIES, name_of
from harness.show.figures import BLUE, ORANGE, plot_seeds, png, styled
from harness.show.report import as_csv

ENVS, PROTOCOLS = ("cartpole", "pendulum"), ("absorbing", "native")
GREEN, YELLOW = "#009e73", "#e69f00"
MARKER, MARK = "study.json", b'{"study": "thesis", "format": 1}\n'


@contextmanager
def open_study(path: Path) -> Iterator[None]:
    """Starts a study in `path`, which is made, or continues the one there; held until the context ends.
    Raises BadInput, having changed nothing, where `path` is anything else, or cannot be written."""
    for protocol in PROTOCOLS:
        if (path / protocol).is_symlink():
            raise BadInput(f"cannot use {path / protocol}: it is a link")
    unfinished = r"scores\.csv|study\.(csv|md)|\w+\.png"
    with open_marked(path, MARKER, MARK, "study", lambda data: data == MARK, unfinished):
        yield


def write_study(directory: Path, runs: dict[str, list[CellResult]]) -> None:
    """Writes tables and figures into `directory` from the results of each protocol's run."""
    rows = [row for results in runs.values() for row in scored_rows(results)]
    write_atomic(directory / "scores.csv", as_csv(rows, COLUMNS))
    entries = [entry for results in runs.values() for entry in leaderboard(scored_rows(results))]
    order = (*ARMS, *CONTROLS, REFERENCE)
    entries.sort(key=lambda e: (ENVS.index(e.env), PROTOCOLS.index(e.protocol), order.index(e.method)))
    table = pd.DataFrame([_line(entry) for entry in entries if entry.method != REFERENCE])
    write_atomic(directory / "study.csv", table.to_csv(index=False, lineterminator="\n"))
    write_atomic(directory / "study.md", _markdown(table))
    for env in dict.fromkeys(entry.env for entry in entries):
        mine = [entry for entry in entries if entry.env == env]
        results = {p: [r for r in found if r.cell.env == env] for p, found in runs.items()}
        with styled():
            write_atomic(directory / f"{env}_figure_5_3.png", png(_figure_5_3(env, results)))
            write_atomic(directory / f"{env}_study.png", png(_study(env, mine)))


def _line(entry: Entry) -> dict[str, str | int | float]:
    arm = ARMS.get(entry.method)
    return {
        "env": entry.env,
        "protocol": entry.protocol,
        "method": arm.method if arm else entry.method,
        "trajectories": (arm.demonstrations if arm else None) or "",
        "weight decay": arm.settings.get("weight_decay", "") if arm else "",
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
        curves: dict[tuple[str, str], list[list[tuple[float, float]]]] = {}
        stars = []
        for result in runs[protocol]:
            for name, points in result.curves.items():
                curves.setdefault((result.cell.method, name), []).append(points)
            if result.cell.method == THESIS:
                stars += [row.return_mean for row in result.rows if row.policy == "pi_star"]
        axes: Axes = figure.add_subplot(1, 2, place + 1)
        under = axes.twinx()
        under.spines["right"].set_visible(True)
        plot_seeds(axes, curves.get(("control_true", "pi_R_true"), []), BLUE)
        plot_seeds(under, curves.get((THESIS, "pi_R"), []), YELLOW)
        plot_seeds(axes, curves.get((THESIS, "pi_R_true"), []), ORANGE)
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
    found = {(e.protocol, e.method, e.policy): e for e in entries}
    first: Axes | None = None
    for place, protocol in enumerate(PROTOCOLS):
        axes: Axes = figure.add_subplot(1, 2, place + 1, sharey=first)
        first = first or axes
        for policy, colour, label in (("pi_star", BLUE, r"$\pi^*$"), ("pi_R", ORANGE, r"$\pi_R$")):
            if policy == "pi_star":
                clones = {n: found.get((protocol, name, policy)) for name, (_, n, _) in CLONES.items()}
                known = [(n, e.score_mean) for n, e in clones.items() if e and math.isfinite(e.score_mean)]
                if known:
                    axes.plot(*zip(*known, strict=True), color=GREEN, marker="^", label="behaviour cloning")
            for shift, decay in enumerate(DECAYS):
                points = [
                    (n * (0.94 + 0.06 * shift + 0.03 * (policy == "pi_R")), entry)
                    for n in TRAJECTORIES
                    if (entry := found.get((protocol, name_of(n, decay), policy)))
                    and math.isfinite(entry.score_mean)
                ]
                style: dict[str, Any] = {"linestyle": "--" if decay else "-", "marker": "s" if decay else "o"}
                axes.errorbar(
                    [x for x, _ in points],
                    [e.score_mean for _, e in points],
                    [
                        [max(0.0, e.score_mean - e.score_low) for _, e in points],  # of equals, rounding
                        [max(0.0, e.score_high - e.score_mean) for _, e in points],
                    ],
                    color=colour,
                    label=f"{label}, weight decay {decay:g}",
                    markersize=4,
                    linewidth=1.2,
                    **style,
                )
        for level, names in _controls(found, protocol).items():
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


def _controls(found: dict[tuple[str, str, str], Entry], protocol: str) -> dict[float, str]:
    """The controls' scores, and the names of all that are about as high."""
    scores = {name: found[key].score_mean for name in CONTROLS if (key := (protocol, name, "pi_R")) in found}
    levels: dict[float, str] = {}
    for name, score in sorted(scores.items(), key=lambda item: item[1]):
        near = [level for level in levels if score - level < 0.03]
        if near:
            levels[near[0]] += f", {name[8:]}"
        elif math.isfinite(score):
            levels[score] = name[8:]
    return levels
