"""Comparisons of methods, paired by task and seed, of a board or of many."""

from __future__ import annotations

import itertools
import math
from collections import Counter
from collections.abc import Collection, Hashable, Mapping, Sequence
from statistics import NormalDist
from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.special import betaincinv

ALPHA = 0.05
"""The probability of any false difference within a family of comparisons."""
POWER = 0.8
"""The power at which a detectable difference is found."""
CONTROLS = ("control_clone", "control_survival")
"""Controls that methods are compared with."""
ROUNDED = 0.01
"""The multiple that differences are rounded to in tests, as tables show them."""
MOST_EXACT = 200
"""Differences other than 0 of an exact test; more are taken as normal."""
Scores = Mapping[tuple[str, int], float]
"""Scores by task and seed."""
Pair = tuple[str, str]
Array = NDArray[np.float64]
T = TypeVar("T", bound=Hashable)


class Difference(NamedTuple):
    """The mean over tasks of mean paired differences, its p-value after Holm, the number of pairs, and the
    smallest difference that would have been found with probability `POWER`."""

    mean: float
    p: float
    pairs: int
    detectable: float

    @property
    def is_significant(self) -> bool:
        """True where it is significant in its family."""
        return self.p <= ALPHA


def p_value(values: Array, options: Sequence[Array]) -> float:
    """Return the two-sided p-value of the sum of N values, (N,), when each could as well be any other of its
    own options, which sum to 0 (Fisher 1935). It is 1 without values.

    All are rounded to `ROUNDED`, or a thousandth of the largest. Of differences -1, 0 and 1, with both signs
    as options, this is the exact test of McNemar (1947).
    """
    options = [option for option in options if option.any()]
    if not options:
        return 1.0
    every = np.concatenate(options)
    unit = max(ROUNDED, float(np.abs(every).max()) / 1000)
    every, total = np.rint(every / unit).astype(np.int64), abs(int(np.rint(values / unit).sum()))
    steps = np.split(every, np.cumsum([len(option) for option in options[:-1]]))
    if len(steps) > MOST_EXACT:
        variance = sum(float(np.square(option).mean()) for option in steps)
        return math.erfc(total / math.sqrt(2 * variance)) if variance else 1.0
    common = int(np.gcd.reduce(every)) or 1
    lowest, chances = 0, np.ones(1)
    for option in map(np.ndarray.tolist, steps):
        least, most = min(option), max(option)
        wider = np.zeros(len(chances) + (most - least) // common)
        for value, count in Counter(option).items():
            shift = (value - least) // common
            wider[shift : shift + len(chances)] += chances * (count / len(option))
        lowest, chances = lowest + least, wider
    sums = lowest + common * np.arange(len(chances))
    return min(1.0, float(chances[np.abs(sums) >= total].sum()))


def sign_flips(differences: Sequence[float] | Array) -> float:
    """Return the two-sided p-value of paired differences when either sign is as likely."""
    values = np.asarray(differences, np.float64)
    return p_value(values, [*np.stack([values, -values], 1)])


def holm(p_values: Mapping[T, float]) -> dict[T, float]:
    """Return adjusted p-values (Holm 1979): at most `ALPHA` where the family allows it."""
    adjusted, least = {}, 0.0
    for place, key in enumerate(sorted(p_values, key=lambda key: p_values[key])):
        least = max(least, min(1.0, (len(p_values) - place) * p_values[key]))
        adjusted[key] = least
    return adjusted


def compare(scores: Mapping[str, Scores], controls: Collection[str] = ()) -> dict[Pair, Difference]:
    """Return the differences between all pairs of methods, and to these controls, as one family.

    They are the first's scores minus the second's over the tasks and seeds that both have, in both
    directions. Tasks weigh the same. Pairs without a shared seed are left out.
    """
    gaps: dict[Pair, Array] = {}
    for one, other in itertools.combinations(scores, 2):
        shared = sorted(scores[one].keys() & scores[other].keys())
        if shared and not {one, other} <= {*controls}:
            mine = np.array([scores[one][key] - scores[other][key] for key in shared])
            gaps[one, other] = _weights(shared) * mine
    differences = {}
    for (one, other), p in holm({pair: sign_flips(mine) for pair, mine in gaps.items()}).items():
        mean, count = float(gaps[one, other].mean()), len(gaps[one, other])
        least = detectable(count, len(gaps))
        differences[one, other] = Difference(mean, p, count, least)
        differences[other, one] = Difference(-mean, p, count, least)
    return differences


def stand_out(scores: Mapping[str, Scores]) -> dict[str, Difference]:
    """Return each method's difference to the mean of the others, as one family; two methods are one test.

    It is over the tasks and seeds that another one has, too, and tasks weigh the same. Without a difference,
    its score is as likely as any other method's there to be its own. The detectable difference is that of a
    normal sum, and NaN where the largest possible one would not be found.
    """
    all_values, all_options = {}, {}
    for method, mine in scores.items():
        shared = [key for key in sorted(mine) if sum(key in its for its in scores.values()) > 1]
        options, values = [], []
        for key, weight in zip(shared, _weights(shared), strict=True):
            known = np.array([its[key] for its in scores.values() if key in its])
            scale = weight * len(known) / (len(known) - 1)
            options.append(scale * (known - known.mean()))
            values.append(scale * (mine[key] - known.mean()))
        if shared:
            all_values[method], all_options[method] = np.array(values), options
    p_values = {method: p_value(its, all_options[method]) for method, its in all_values.items()}
    adjusted, tests = (holm(p_values), len(p_values)) if len(p_values) > 2 else (p_values, 1)
    errors = NormalDist().inv_cdf(1 - ALPHA / 2 / tests) + NormalDist().inv_cdf(POWER)
    differences = {}
    for method, p in adjusted.items():
        count = len(all_values[method])
        spread = math.sqrt(sum(float(np.square(option).mean()) for option in all_options[method]))
        largest = np.array([option.max() for option in all_options[method]])
        can_show = tests * p_value(largest, all_options[method]) <= ALPHA
        least = errors * spread / count if can_show else math.nan
        differences[method] = Difference(float(all_values[method].mean()), p, count, least)
    return differences


def pooled(scores: Mapping[str, Scores]) -> tuple[dict[str, Difference], dict[Pair, Difference]]:
    """Return the differences of methods to the mean of the others, and of all pairs.

    A pair of methods that do not differ from the others' mean has a p-value of 1. So both families together
    name a difference among equal methods with probability `ALPHA` at most.
    """
    beside = stand_out(scores)
    apart = {method for method, one in beside.items() if one.is_significant}
    pairs = compare(scores).items()
    return beside, {pair: one if apart & {*pair} else one._replace(p=1.0) for pair, one in pairs}


def _weights(keys: Sequence[tuple[str, int]]) -> Array:
    """Return weights of tasks and seeds with which tasks weigh the same, of mean 1."""
    seeds = Counter(task for task, _ in keys)
    return np.array([len(keys) / len(seeds) / seeds[task] for task, _ in keys])


def detectable(pairs: int, comparisons: int) -> float:
    """Return the smallest difference that a family's first test finds with probability `POWER`, in (0, 1].

    It is that of success rates, between a method that always succeeds and one that sometimes fails. NaN where
    so few pairs cannot show any difference.
    """
    failures = math.ceil(1 - math.log2(ALPHA / max(1, comparisons)))
    return float(betaincinv(failures, pairs - failures + 1, POWER)) if failures <= pairs else math.nan
