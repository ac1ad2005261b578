"""Write coverage.csv: what intervals cover, how often equal methods differ, and what differences are found.

    python results/studies/coverage.py

Columns: what, how, n (seeds of a task), tasks, methods, rate and other (success rates of the first method and
of the others; empty for stored scores), value (a share of simulations), lowest (of the stored groups), width
(mean), simulations (of intervals, for each group of stored scores, or of boards).

- coverage: the share of intervals that hold the mean of scores. They are 0 or 1, or drawn from the stored
  scores of a method's seeds on a reference board.
- false: the share of boards that name a difference among equal methods, and two equal controls.
- power: the share of boards that name the difference of the first method, which is better. By `pair` it is
  that to the second method, by `any pair` to one of the others, by `beside the others` to their mean.
"""

import csv
import functools
import itertools
import math
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd
from scipy.special import stdtrit

from harness.judge.comparisons import CONTROLS, compare, pooled
from harness.judge.statistics import CONFIDENCE, RANGE, mean_interval

COLUMNS = ("what", "how", "n", "tasks", "methods", "rate", "other", "value", "lowest", "width", "simulations")
BOARDS = Path(__file__).parents[1] / "reference/board"
GROUP = ["run", "dynamics", "demos", "every", "method", "policy"]


def student(values: Sequence[float]) -> tuple[float, float]:
    """Return the interval of Student's t."""
    reach = stdtrit(len(values) - 1, 0.5 + CONFIDENCE / 2) * np.std(values, ddof=1) / math.sqrt(len(values))
    return float(np.mean(values) - reach), float(np.mean(values) + reach)


def student_with_ends(values: Sequence[float]) -> tuple[float, float]:
    """Return the same with an observation at each end of the range, which scores outside widen."""
    low, high = min(RANGE[0], *values), max(RANGE[1], *values)
    ends = student([*values, low, high])
    return max(low, ends[0]), min(high, ends[1])


INTERVALS: dict[str, Callable[[Sequence[float]], tuple[float, float]]] = {
    "mean_interval": mean_interval,
    "student_with_ends": student_with_ends,
    "student": student,
}


def stored() -> list[list[float]]:
    """Return the scores of every policy with five seeds or more on the reference boards."""
    frames = [pd.read_csv(file).assign(run=file.parent.name) for file in sorted(BOARDS.glob("*/scores.csv"))]
    scores = pd.concat(frames).query("method != 'reference' and normalized_score.notna()")
    groups = scores.groupby(GROUP)["normalized_score"]
    return [group.tolist() for _, group in groups if len(group) >= 5]


def coverage(name: str, pools: Sequence[Sequence[float]], n: int, draws: int) -> tuple[float, float, float]:
    """Return the mean over pools of the share of intervals of n scores that hold the pool's mean, the lowest
    such share, and the mean width."""
    interval = functools.cache(INTERVALS[name])
    shares, widths = [], []
    for number, pool in enumerate(pools):
        drawn = np.sort(np.random.default_rng(number).choice(pool, (draws, n)))
        low, high = np.array([interval(tuple(values)) for values in drawn.tolist()]).T
        mean = math.fsum(pool) / len(pool)
        shares.append(float(((low < mean + 1e-6) & (mean - 1e-6 < high)).mean()))
        widths.append(float((high - low).mean()))
    return float(np.mean(shares)), min(shares), float(np.mean(widths))


class Board(NamedTuple):
    """What a simulated board names: any difference on it or in its pooled comparisons, and those by which the
    first method is better: than the second one, than any other one, than the mean of the others."""

    names_any: bool
    pair: bool
    any_pair: bool
    stands_out: bool


def board(rates: Sequence[float], n: int, tasks: int, seed: int) -> Board:
    """Return what a board names whose methods succeed at these rates. Controls succeed as the last one does,
    and are left out over several tasks."""
    controls = CONTROLS if tasks == 1 else ()
    names = [*map(str, range(len(rates))), *controls]
    keys = [(str(task), seed) for task in range(tasks) for seed in range(n)]
    chances = np.append(rates, [rates[-1]] * len(controls))[:, None]
    won = (np.random.default_rng(seed).random((len(names), len(keys))) < chances).astype(float)
    scores = {name: dict(zip(keys, its.tolist(), strict=True)) for name, its in zip(names, won, strict=True)}
    beside, pairs = pooled(scores) if tasks > 1 else ({}, compare(scores, controls))
    better = [
        other for (one, other), gap in pairs.items() if one == "0" and gap.is_significant and gap.mean > 0
    ]
    return Board(
        any(gap.is_significant for gap in (*pairs.values(), *beside.values())),
        "1" in better,
        bool(better),
        "0" in beside and beside["0"].is_significant and beside["0"].mean > 0,
    )


def lines(draws: int, resamples: int, boards: int) -> Iterator[tuple[object, ...]]:
    """Yield the rows of the file. The numbers are those of simulations: for a success rate, for a group of
    stored scores, and of boards, a quarter of these for the power among thirteen methods."""
    for n, name in itertools.product((5, 10), INTERVALS):
        for rate in (0.5, 0.8, 0.9):
            pool = [1.0] * round(10 * rate) + [0.0] * round(10 - 10 * rate)
            value, _, width = coverage(name, [pool], n, draws)
            yield "coverage", name, n, 1, 1, rate, "", value, "", width, draws
        value, lowest, width = coverage(name, stored(), n, resamples)
        yield "coverage", name, n, 1, 1, "", "", value, lowest, width, resamples

    def shares(rates: Sequence[float], n: int, tasks: int, count: int) -> list[float]:
        return np.mean([board(rates, n, tasks, seed) for seed in range(count)], axis=0).tolist()

    for (n, tasks), rate in itertools.product(((5, 1), (10, 1), (20, 1), (5, 10)), (0.5, 0.8, 0.9)):
        how = "pairs" if tasks == 1 else "pairs, beside the others"
        yield "false", how, n, tasks, 13, rate, "", shares([rate] * 13, n, tasks, boards)[0], "", "", boards
    for methods, other in itertools.product((2, 3, 13), (0.5, 0.6, 0.7)):
        count = boards // 4 if methods > 3 else boards
        values = shares([other + 0.3] + [other] * (methods - 1), 5, 10, count)[1:]
        for how, value in zip(("pair", "any pair", "beside the others"), values, strict=True):
            yield "power", how, 5, 10, methods, other + 0.3, other, value, "", "", count


if __name__ == "__main__":
    with Path(__file__).with_suffix(".csv").open("w", encoding="utf-8", newline="") as file:
        rows = csv.writer(file, lineterminator="\n")
        rows.writerow(COLUMNS)
        for line in lines(draws=20_000, resamples=200, boards=1000):
            rows.writerow([f"{item:.4g}" if isinstance(item, float) else item for item in line])
