"""Tables for people: their columns, what those mean, and how numbers are told."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from harness.judge.leaderboard import Entry, Overall
from harness.judge.results import NOMINAL

NOTHING = "no score: what would score 1 is missing, or no better than random"
LONGEST_NOTE = 5000
"""Characters of what a line notes."""
MEANINGS = {
    "Task": "The environment. In a variant its dynamics differ, and what was learned is carried over.",
    "Dynamics": "Those of the task as it is (nominal), or the variant of it.",
    "Demonstrations": "What of the expert is shown to methods.",
    "Method": "Who learned. control_… are rewards or policies for comparison; reference is the expert and the random policy.",
    "Role": "A method is compared with the others. A lower control has a reward without information, the upper control the true reward.",
    "Policy": "π* (pi_star): what the method found itself. π_R (pi_R): what RL finds from scratch under the method's learned reward alone.",
    "Score [95 %]": "Normalized return under the true reward: 0 random, 1 the expert; in a variant 1 is RL on the true reward there. Brackets: 95 % interval of the mean over seeds (Student's t); with one seed over its evaluation episodes.",
    "Behind the best [95 %]": "How much less it scores than the best method's policy of the same name, paired by seed. 'tied': the interval holds 0, or less than 0.005.",
    "Above best lower control": "Score less that of the best control whose reward has no information. A learned reward has to be above 0 here.",
    "Seeds ok": "Seeds that are finished without failure, of those that were asked for.",
    "Share of control_true": "Score in units of what RL reaches on the true reward with as many steps.",
    "Reward: distance (floor)": "From the true reward, by the advantages that it gives to actions: 0 the same up to scale, 1 the opposite. The floor is the distance of the reward from a shaped copy of itself: below it nothing can be told.",
    "Reward: rank": "Spearman's correlation of the advantages under the learned and the true reward.",
    "Policies: rank": "Spearman's correlation of the returns of twenty policies from bad to good, under the learned and the true reward.",
    "Return [95 %]": "Undiscounted return under the true reward, mean over seeds.",
    "Discounted return": "The same, discounted with the task's gamma.",
    "Own return": "Mean return under the learned reward, counted from what absorption pays.",
    "Of demonstrations": "The demonstrations' return under the learned reward, counted alike.",
    "Seconds": "Wall time of what made this policy, mean over seeds: the fit for π*, RL on R* for π_R.",
    "Env steps": "Environment steps that it took: rollouts, and those that RL learned from. Checks are not in it.",
    "Check steps": "Environment steps of the episodes by which RL's checkpoints were judged, besides.",
    "RL solves": "How often RL was run.",
    "Note": "Where a line comes from; which seeds were skipped, failed or not scored, and why.",
    "Environments": "How many environments it is over.",
    "Runs": "Scores that are counted: environments times seeds.",
    "Interquartile mean [95 %]": "The mean of the middle half of all runs; the interval is of the stratified bootstrap (Agarwal et al. 2021).",
    "Runs below 0.95": "Share of the runs that score less than 0.95.",
    "Stage of a cell": "What a cell does in turn; 'start' is what its process takes besides.",
    "Seconds, all cells": "Wall time, summed over all cells.",
    "Share": "Of the time of all stages.",
    "Detail of its fit": "A number that the method tells of its own fit.",
    "Mean over seeds": "Of the seeds that tell it.",
    "Episodes by ending": "How many evaluation episodes of all seeds ended how.",
    "Cost": "What the policy took in all; for π_R the fit and RL on R* together.",
    "Unit": "Of the cost.",
    "On the front": "No other method scores as much for less.",
    "Score": "Normalized score, as in the leaderboard.",
    "Share of runs above": "The share of the runs that score more, with its 95 % interval (stratified bootstrap).",
    "Better than it": "The method with the best mean score.",
    "Probability [95 %]": "That a run of the best method scores more than one of this method, in a task drawn at random; equal scores count half (stratified bootstrap).",
    "Distance": "From the true reward, as in the leaderboard: 0 the same, 1 the opposite.",
    "Floor": "The distance of the reward from a shaped copy of itself.",
    "Episodes": "Demonstrations that were shown.",
    "Ended": "How the evaluation episodes of the policy ended, over all seeds.",
    "Play": "In this page's folder.",
}  # fmt: skip
"""Of every heading."""


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
    return Number(format(value, spec) if math.isfinite(value) else "n/a", value)


def interval(mean: float, low: float, high: float, spec: str) -> Number:
    """A mean and its interval, if it has one."""
    known = math.isfinite(low)
    told = f" [{low:{spec}}, {high:{spec}}]" if known else ""
    return Number(number(mean, spec).text + told, mean, low if known else math.nan, high)


def score(entry: Entry) -> Number:
    return interval(entry.score_mean, entry.score_low, entry.score_high, "z.2f")


def behind(entry: Entry) -> Number:
    found = interval(entry.behind_mean, entry.behind_low, entry.behind_high, "+z.2f")
    if math.isfinite(entry.behind_mean):
        return Number(found.text + (" tied" if entry.tied else ""), found.value, found.low, found.high)
    return Number("the best", 0.0) if is_best(entry) else Number("", math.nan)


def is_best(entry: Entry) -> bool:
    """Whether it is the method that scores best."""
    alone = entry.role == "method" and not math.isfinite(entry.behind_mean)
    return alone and math.isfinite(entry.score_mean)


def _learned(value: Callable[[Entry], Number]) -> Callable[[Entry], Number]:
    """Of pi_R alone."""
    return lambda entry: value(entry) if entry.policy == "pi_R" else Number("", math.nan)


def _distance(entry: Entry) -> Number:
    floor = f" ({entry.reward_floor:z.2f})" if math.isfinite(entry.reward_floor) else ""
    found = number(entry.reward_distance, "z.2f")
    return Number(found.text + floor, found.value)


def note(entry: Entry) -> str:
    """What there is to say of it, in a line."""
    parts = [entry.note] if entry.note else []
    if entry.varies == "episodes" and math.isfinite(entry.return_low):
        parts.append("one seed: intervals are over episodes")
    noted = " ".join("; ".join(parts).split())
    if len(noted) > LONGEST_NOTE:
        noted = f"{noted[:LONGEST_NOTE]} … (all of it in leaderboard.csv)"
    return noted


FIRST: dict[str, Callable[[Entry], Item]] = {
    "Task": lambda e: e.env,
    "Dynamics": lambda e: e.dynamics,
    "Demonstrations": lambda e: str(e.shown) or "as the budget says",
    "Method": lambda e: e.method,
    "Policy": lambda e: e.policy,
    "Score [95 %]": score,
    "Behind the best [95 %]": behind,
    "Above best lower control": _learned(lambda e: number(e.above_best_lower_control, "+z.2f")),
    "Seeds ok": lambda e: Number(f"{e.seeds_ok} of {e.seeds}", e.seeds_ok),
    "Note": note,
}
"""Columns of the leaderboard that matter first."""
REWARD: dict[str, Callable[[Entry], Item]] = {
    "Reward: distance (floor)": _learned(_distance),
    "Reward: rank": _learned(lambda e: number(e.reward_rank, "z.2f")),
    "Policies: rank": _learned(lambda e: number(e.policy_ranking, "z.2f")),
    "Share of control_true": _learned(lambda e: number(e.share_of_true, "z.2f")),
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
