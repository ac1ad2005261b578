"""Tables for people: their columns, what those mean, and how numbers are told."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from harness.judge.across_tasks import Overall
from harness.judge.leaderboard import Entry
from harness.judge.numbers import as_text
from harness.judge.results import NOMINAL

NOTHING = "no score: what would score 1 is missing, or no better than random"
INCOMPARABLE = "no seed in common"
"""In the place of a difference to the best method, where there is nothing to compare."""
LONGEST_NOTE = 5000
"""Characters of what a line notes."""


@dataclass(frozen=True)
class Number:
    """A number as it is told, with itself and its interval, NaN where there is none."""

    text: str
    value: float
    low: float = math.nan
    high: float = math.nan

    def __str__(self) -> str:
        return self.text


Item = str | Number


@dataclass(frozen=True)
class Table:
    """name: of its file."""

    name: str
    headings: tuple[str, ...]
    lines: list[list[Item]]

    @property
    def numeric(self) -> frozenset[str]:
        """Headings of columns that hold numbers."""
        return frozenset(
            heading
            for heading, column in zip(self.headings, zip(*self.lines, strict=True), strict=False)
            if any(isinstance(item, Number) for item in column)
        )


def number(value: float, spec: str) -> Number:
    return Number(as_text(value, spec), value)


def interval(mean: float, low: float, high: float, spec: str) -> Number:
    """A mean and its interval, if it has one."""
    known = math.isfinite(low)
    ends = f" [{as_text(low, spec)}, {as_text(high, spec)}]" if known else ""
    return Number(as_text(mean, spec) + ends, mean, low if known else math.nan, high)


def score(entry: Entry) -> Number:
    return interval(entry.score_mean, entry.score_low, entry.score_high, "z.2f")


def behind(entry: Entry) -> Number:
    found = interval(entry.behind_mean, entry.behind_low, entry.behind_high, "+z.2f")
    if math.isfinite(entry.behind_mean):
        return Number(found.text + (" tied" if entry.tied else ""), found.value, found.low, found.high)
    return Number("the best", 0.0) if entry.best else Number(INCOMPARABLE * entry.incomparable, math.nan)


def _learned(value: Callable[[Entry], Number]) -> Callable[[Entry], Number]:
    """Of pi_R alone."""
    return lambda entry: value(entry) if entry.policy == "pi_R" else Number("", math.nan)


def _distance(entry: Entry) -> Number:
    floor = f" ({as_text(entry.reward_floor, 'z.2f')})" if math.isfinite(entry.reward_floor) else ""
    found = number(entry.reward_distance, "z.2f")
    return Number(found.text + floor, found.value)


def note(entry: Entry) -> str:
    """What there is to say of it, in a line."""
    parts = [f"R* solved on {as_text(entry.solved, '.0%')} of seeds"] if entry.unsolved else []
    parts += [entry.note] if entry.note else []
    if entry.varies == "episodes" and math.isfinite(entry.return_low):
        parts.append("one seed: intervals are over episodes")
    noted = " ".join("; ".join(parts).split())
    if len(noted) > LONGEST_NOTE:
        noted = f"{noted[:LONGEST_NOTE]} … (all of it in leaderboard.csv)"
    return noted


FIRST: dict[str, Callable[[Entry], Item]] = {
    "Task": lambda e: e.env,
    "Dynamics": lambda e: e.dynamics,
    "Method": lambda e: e.method,
    "Policy": lambda e: e.policy,
    "Score [95 %]": score,
    "Behind the best [95 %]": behind,
    "Above best lower control": _learned(lambda e: number(e.above_best_lower_control, "+z.2f")),
    "Seeds ok": lambda e: Number(f"{e.seeds_ok} of {e.seeds}", e.seeds_ok),
    "Demonstrations": lambda e: str(e.shown) or "as the budget says",
    "Note": note,
}
"""Columns of the leaderboard that matter first."""
REWARD: dict[str, Callable[[Entry], Item]] = {
    "Reward: distance (floor)": _learned(_distance),
    "Reward: rank": _learned(lambda e: number(e.reward_rank, "z.2f")),
    "Policies: rank": _learned(lambda e: number(e.policy_ranking, "z.2f")),
    "Share of control_true": _learned(lambda e: number(e.share_of_true, "z.2f")),
    "Solved": _learned(lambda e: number(e.solved, ".0%")),
    "Own return": lambda e: number(e.own_return, ".1f"),
    "Of demonstrations": lambda e: number(e.own_return_shown, ".1f"),
}
COSTS: dict[str, Callable[[Entry], Item]] = {
    "Seconds": lambda e: number(e.fit_seconds, ".1f"),
    "Env steps": lambda e: number(e.env_steps, ",.0f"),
    "Check steps": lambda e: number(e.check_steps, ",.0f"),
    "RL solves": lambda e: number(e.rl_solves, ".0f"),
}
RETURNS: dict[str, Callable[[Entry], Item]] = {
    "Return [95 %]": lambda e: interval(e.return_mean, e.return_low, e.return_high, ".1f"),
    "Discounted return": lambda e: number(e.discounted_mean, "z.2f"),
}
EVERY: dict[str, Callable[[Entry], Item]] = {
    **FIRST,
    "Role": lambda e: e.role,
    **RETURNS,
    **REWARD,
    **COSTS,
}


def of_entries(name: str, columns: dict[str, Callable[[Entry], Item]], entries: Sequence[Entry]) -> Table:
    """A line for each entry."""
    return Table(name, tuple(columns), [[tell(entry) for tell in columns.values()] for entry in entries])


def of_overall(across: Sequence[Overall]) -> Table:
    lines: list[list[Item]] = [
        [
            *(x.method, x.policy, number(x.envs, ".0f"), number(x.runs, ".0f")),
            *(interval(x.score, x.low, x.high, "z.2f"), Number(f"{x.below:.0%}", x.below)),
        ]
        for x in across
    ]
    headings = ("Environments", "Runs", "Interquartile mean [95 %]", "Runs below 0.95")
    return Table("across", ("Method", "Policy", *headings), lines)


def at_nominal(entries: Sequence[Entry]) -> list[Entry]:
    """Those in their task's own dynamics."""
    return [entry for entry in entries if entry.dynamics == NOMINAL]


def markdown(headings: Sequence[str], table: Sequence[Sequence[Item]]) -> str:
    lines = [headings, ["---"] * len(headings), *table]
    return "".join("| " + " | ".join(escaped(str(item)) for item in line) + " |\n" for line in lines)


def escaped(text: str) -> str:
    """For Markdown, in which it is neither table nor HTML nor link."""
    return re.sub(r"([\\|<>&`]|(?<=\])\()", r"\\\1", text)
