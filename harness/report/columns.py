"""Columns of the leaderboard, each declared once: title, meaning, value, and where it is visible."""

from __future__ import annotations

import math
from collections.abc import Callable
from operator import attrgetter
from typing import Any

from harness.judge.comparisons import ALPHA, POWER
from harness.judge.leaderboard import LEAST_TRUE, Entry
from harness.judge.numbers import as_text
from harness.judge.rows import BESIDE
from harness.judge.statistics import SUCCESS
from harness.report.tables import LEVEL, Column, Kind, Value, interval, number

NO_SCORE = "no score: the return that would score 1 is missing, or no better than random"
INCOMPARABLE = "no seed in common"
"""Text in place of a difference to the best method, where the two share no seed."""
LONGEST_NOTE = 5000
"""Characters of a note in a table."""
NAMES = {"pi_star": "π*", "pi_R": "π_R"}
"""Policies that methods are compared by, as pages name them."""
MEANINGS = {
    "env": "The environment. In a variant its dynamics differ.",
    "dynamics": "Those of the task as it is (nominal), or the variant of it.",
    "method": "Who learned. control_… are rewards or policies for comparison; reference is expert and random "
    "policy.",
    "policy": "π* (pi_star): the policy that the method returned. π_R (pi_R): the policy that RL finds from "
    "scratch under the method's learned reward alone.",
    "score": "Normalized return under the true reward: 0 random, 1 the expert, or RL on the true reward in a "
    f"variant. Brackets: {LEVEL} interval of the mean over seeds, for scores from 0 to 1 (Gaffke 2005). Seeds"
    " on which RL did not solve R* are left out; 'not solved' is followed by their mean.",
    "share": f"Share of these seeds that reach {SUCCESS}, with its interval (Clopper & Pearson 1934).",
    "score_iqm": "Interquartile mean of the scores: the mean of the middle half.",
    "behind": "Gap to the highest mean of a policy of the same name, paired by seed. 'ns': not significant "
    f"at {ALPHA}, by flips of signs, adjusted for all comparisons on the board (Holm 1979). In parentheses: "
    f"the smallest gap to a method that always succeeds that so many seeds show with power {POWER}. No method"
    " with as many seeds beats the highest mean on the seeds that both have.",
    "differs": "Methods, control_clone and control_survival from which it differs significantly by the same "
    "test.",
    "above_best_lower_control": "Difference to the best control whose reward lacks information, over seeds "
    "that all have. A learned reward has to be above 0 here.",
    "seeds": "Seeds that finished without failure, and seeds that were asked for.",
    "demonstrations": "The part of the expert's demonstrations that methods see.",
    "note": "The line's origin; seeds without a score, and why.",
    "remarks": "The role, and all of the note.",
    "role": "Methods are compared with each other. A lower control's reward has no information, the upper "
    "control's is the true one.",
    "return_mean": "Undiscounted return under the true reward, mean over seeds.",
    "discounted_mean": "Return, discounted with the task's gamma.",
    "reward_distance": "Distance from the true reward by the advantages that it gives to actions: 0 the same "
    "up to scale, 1 the opposite. The floor is its distance from a shaped copy of itself: smaller "
    "differences say nothing.",
    "reward_rank": "Spearman's correlation of advantages under the learned and the true reward.",
    "policy_ranking": "Spearman's correlation of twenty policies' returns under the learned and the true "
    "reward.",
    "share_of_true": "Score as a share of the score that RL reaches on the true reward in one solve, where "
    f"that is at least {LEAST_TRUE}.",
    "solved": "Share of seeds on which π_R earns, under R*, 95 % of the gain of π* over a random policy. "
    "Elsewhere its score says nothing about the reward, only about RL.",
    "own_return": "Return under R*, less the absorbing state's pay.",
    "own_return_shown": "The demonstrations' own return.",
    "fit_seconds": "Wall time of the fit for π*, of RL for π_R.",
    "env_steps": "Environment steps of rollouts and of RL.",
    "check_steps": "Environment steps that judge checkpoints of RL.",
    "rl_solves": "Number of RL runs.",
}


def score(entry: Entry) -> Value:
    """Return the normalized score with its interval, or the state that RL solved R* on no seed."""
    if entry.is_unsolved:
        return Value(f"not solved ({as_text(entry.score_unsolved, 'z.2f')})")
    return interval(entry.score_mean, entry.score_low, entry.score_high)


def difference(gap: float, p: float, detectable: float) -> Value:
    """Return a difference, and where it is not significant the smallest one that would have been found."""
    if p <= ALPHA:
        return number(gap, "+z.2f")
    least = as_text(detectable, ".2f") if math.isfinite(detectable) else "none"
    return Value(f"{as_text(gap, '+z.2f')} ns ({least})", gap)


def _share(entry: Entry) -> Value:
    return interval(entry.share, entry.share_low, entry.share_high, ".0%")


def _behind(entry: Entry) -> Value:
    if entry.best:
        return Value("highest", 0.0)
    if not math.isfinite(entry.behind):
        return Value(
            f"as {entry.same_policy_as}" if entry.same_policy_as else INCOMPARABLE * entry.incomparable
        )
    return difference(entry.behind, entry.behind_p, entry.detectable)


def _differs(entry: Entry) -> str:
    its = {"better than": entry.better_than, "worse than": entry.worse_than}
    return "; ".join(f"{how} {', '.join(names.split())}" for how, names in its.items() if names)


def _distance(entry: Entry) -> Value:
    floor = f" ({as_text(entry.reward_floor, 'z.2f')})" if math.isfinite(entry.reward_floor) else ""
    distance = entry.reward_distance
    return Value(as_text(distance, "z.2f") + floor, distance) if entry.policy == "pi_R" else Value("")


def _seeds(entry: Entry) -> Value:
    return Value(f"{entry.seeds_ok} of {entry.seeds}", entry.seeds_ok)


def _note(entry: Entry) -> str:
    text = _joined(unsolved(entry), entry.note)
    more = " … (all of it in leaderboard.csv)"
    return text if len(text) <= LONGEST_NOTE else text[:LONGEST_NOTE] + more


def _remarks(entry: Entry) -> str:
    role = {"method": "", **{one: f"{one}: not ranked" for one in BESIDE}}.get(entry.role, entry.role)
    seeds = f"{entry.seeds_ok} of {entry.seeds} seeds" if 0 < entry.seeds_ok < entry.seeds else ""
    return _joined(role, seeds, unsolved(entry), entry.note)


def unsolved(entry: Entry) -> str:
    """Return on how many seeds RL did not solve R*, in words, and their mean score."""
    mean = as_text(entry.score_unsolved, "z.2f")
    return f"R* not solved on {entry.unsolved} of {entry.seeds_ok} seeds ({mean})" if entry.unsolved else ""


def _joined(*parts: str) -> str:
    return " ".join("; ".join(filter(None, parts)).split())


def _column(
    title: str,
    key: str,
    read: str | Callable[[Any], str | Value],
    places: str = "",
    kind: Kind = "number",
    of_reward: bool = False,
) -> Column:
    """Return a column. `read`: a function, or the format of the entry's number of that key. `of_reward`: True
    for numbers that entries of pi_R alone have."""

    def numbered(entry: Entry) -> Value:
        is_known = entry.policy == "pi_R" or not of_reward
        return number(getattr(entry, key), str(read)) if is_known else Value("")

    return Column(key, title, MEANINGS[key], numbered if isinstance(read, str) else read, kind, places)


METHOD = _column(
    "Method", "method", attrgetter("method"), "first terminal scores rewards costs", kind="choice"
)
POLICY = _column(
    "Policy",
    "policy",
    lambda item: NAMES.get(item.policy, item.policy),
    "first terminal scores costs",
    kind="choice",
)
SCORE = _column("Score", "score", score, "first terminal scores", kind="interval")
DEMONSTRATIONS = _column(
    "Demonstrations",
    "demonstrations",
    lambda entry: str(entry.shown) or "as the budget says",
    "first",
    kind="choice",
)
DISTANCE = _column("Reward: distance (floor)", "reward_distance", _distance, "rewards")
RANK = _column("Reward: rank", "reward_rank", "z.2f", "rewards", of_reward=True)
SECONDS = _column("Seconds", "fit_seconds", ".1f", "costs")
STEPS = _column("Env steps", "env_steps", ",.0f", "costs")
CHECKS = _column("Check steps", "check_steps", ",.0f", "costs")
SOLVES = _column("RL solves", "rl_solves", ".0f", "costs")
ENTRY = (
    _column("Task", "env", attrgetter("env"), "first", kind="choice"),
    _column("Dynamics", "dynamics", attrgetter("dynamics"), "first", kind="choice"),
    METHOD,
    POLICY,
    SCORE,
    _column("Reach 0.9", "share", _share, "first scores", kind="interval"),
    _column("Interquartile mean", "score_iqm", "z.2f", "scores"),
    _column("Behind the best", "behind", _behind, "first terminal scores"),
    _column("Differs", "differs", _differs, "scores", kind="text"),
    _column("Above best lower control", "above_best_lower_control", "+z.2f", "first scores", of_reward=True),
    _column("Seeds ok", "seeds", _seeds, "first scores"),
    DEMONSTRATIONS,
    _column("Note", "note", _note, "first scores", kind="note"),
    _column("Note", "remarks", _remarks, "terminal", kind="note"),
    _column("Role", "role", attrgetter("role"), kind="text"),
    _column("Return", "return_mean", ".1f", "costs"),
    _column("Discounted return", "discounted_mean", "z.2f"),
    DISTANCE,
    RANK,
    _column("Policies: rank", "policy_ranking", "z.2f", "rewards", of_reward=True),
    _column("Share of control_true", "share_of_true", "z.2f", "rewards", of_reward=True),
    _column("Solved", "solved", ".0%", "rewards", of_reward=True),
    _column("Own return", "own_return", ".1f", "rewards"),
    _column("Of demonstrations", "own_return_shown", ".1f", "rewards"),
    SECONDS,
    STEPS,
    CHECKS,
    SOLVES,
)
"""Columns in the order of the leaderboard."""


def visible(place: str) -> list[Column]:
    """Return the columns of the leaderboard that are visible at a place of `Column.places`."""
    return [column for column in ENTRY if place in column.places.split()]
