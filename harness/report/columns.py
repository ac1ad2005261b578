"""Columns of the leaderboard, each declared once: title, meaning, value, and where it is visible."""

from __future__ import annotations

import math
from operator import attrgetter

from harness.judge.leaderboard import Entry
from harness.judge.numbers import as_text
from harness.judge.roles import ASKS
from harness.report.tables import Column, Value, interval, number

NO_SCORE = "no score: the return that would score 1 is missing, or no better than random"
INCOMPARABLE = "no seed in common"
"""Text in place of a difference to the best method, where the two share no seed."""
LONGEST_NOTE = 5000
"""Characters of a note in a table."""
NAMES = {"pi_star": "π*", "pi_R": "π_R"}
"""Policies that methods are compared by, as pages name them."""


def score(entry: Entry) -> Value:
    """Return the normalized score with its interval."""
    return interval(entry.score_mean, entry.score_low, entry.score_high)


def _behind(entry: Entry) -> Value:
    if entry.best:
        return Value("the best", 0.0)
    if not math.isfinite(entry.behind_mean):
        return Value(INCOMPARABLE * entry.incomparable)
    value = interval(entry.behind_mean, entry.behind_low, entry.behind_high, "+z.2f")
    return Value(value.text + " tied" * entry.tied, value.number, value.low, value.high)


def _distance(entry: Entry) -> Value:
    floor = f" ({as_text(entry.reward_floor, 'z.2f')})" if math.isfinite(entry.reward_floor) else ""
    distance = entry.reward_distance
    return Value(as_text(distance, "z.2f") + floor, distance) if entry.policy == "pi_R" else Value("")


def _unsolved(entry: Entry) -> str:
    return f"R* solved on {as_text(entry.solved, '.0%')} of seeds" if entry.unsolved else ""


def _note(entry: Entry) -> str:
    one_seed = entry.varies == "episodes" and math.isfinite(entry.return_low)
    text = _joined(_unsolved(entry), entry.note, "one seed: intervals are over episodes" * one_seed)
    more = " … (all of it in leaderboard.csv)"
    return text if len(text) <= LONGEST_NOTE else text[:LONGEST_NOTE] + more


def _remarks(entry: Entry) -> str:
    role = {"method": "", ASKS: f"{ASKS}: not ranked"}.get(entry.role, entry.role)
    seeds = f"{entry.seeds_ok} of {entry.seeds} seeds" if 0 < entry.seeds_ok < entry.seeds else ""
    return _joined(role, seeds, _unsolved(entry), entry.note)


def _joined(*parts: str) -> str:
    return " ".join("; ".join(filter(None, parts)).split())


def _text(title: str, field: str, meaning: str, places: str) -> Column:
    return Column(field, title, meaning, attrgetter(field), "choice", places)


def _number(title: str, field: str, spec: str, meaning: str, places: str = "") -> Column:
    return Column(field, title, meaning, lambda entry: number(getattr(entry, field), spec), places=places)


def _of_reward(title: str, field: str, meaning: str, places: str = "rewards", spec: str = "z.2f") -> Column:
    """Return a column of numbers that entries of pi_R alone have."""

    def read(entry: Entry) -> Value:
        return number(getattr(entry, field), spec) if entry.policy == "pi_R" else Value("")

    return Column(field, title, meaning, read, places=places)


METHOD = _text(
    "Method",
    "method",
    "Who learned. control_… are rewards or policies for comparison; reference is expert and random policy.",
    "first terminal scores rewards costs",
)
POLICY = Column(
    "policy",
    "Policy",
    "π* (pi_star): the policy that the method returned. π_R (pi_R): the policy that RL finds from scratch "
    "under the method's learned reward alone.",
    lambda item: NAMES.get(item.policy, item.policy),
    "choice",
    "first terminal scores costs",
)
SCORE = Column(
    "score",
    "Score",
    "Normalized return under the true reward: 0 random, 1 the expert, or RL on the true reward in a variant. "
    "Brackets: 95 % interval of the mean over seeds (Student's t); with one seed over its episodes.",
    score,
    "interval",
    "first terminal scores",
)
DEMONSTRATIONS = Column(
    "demonstrations",
    "Demonstrations",
    "The part of the expert's demonstrations that methods see.",
    lambda item: str(item.shown) or "as the budget says",
    "choice",
    "first",
)
DISTANCE = Column(
    "reward_distance",
    "Reward: distance (floor)",
    "Distance from the true reward by the advantages that it gives to actions: 0 the same up to scale, 1 the "
    "opposite. The floor is its distance from a shaped copy of itself: smaller differences say nothing.",
    _distance,
    places="rewards",
)
RANK = _of_reward(
    "Reward: rank",
    "reward_rank",
    "Spearman's correlation of advantages under the learned and the true reward.",
)
SECONDS = _number("Seconds", "fit_seconds", ".1f", "Wall time of the fit for π*, of RL for π_R.", "costs")
STEPS = _number("Env steps", "env_steps", ",.0f", "Environment steps of rollouts and of RL.", "costs")
SOLVES = _number("RL solves", "rl_solves", ".0f", "Number of RL runs.", "costs")
ENTRY = (
    _text("Task", "env", "The environment. In a variant its dynamics differ.", "first"),
    _text("Dynamics", "dynamics", "Those of the task as it is (nominal), or the variant of it.", "first"),
    METHOD,
    POLICY,
    SCORE,
    Column(
        "behind",
        "Behind the best",
        "Difference to the score of the best method's policy of the same name, paired by seed. 'tied': the "
        "interval holds 0, or the difference is under 0.005. 'no seed in common': not compared. The best has "
        "the highest mean that no method with as many seeds beats on the seeds that both have.",
        _behind,
        "interval",
        "first terminal scores",
    ),
    _of_reward(
        "Above best lower control",
        "above_best_lower_control",
        "Difference to the best control whose reward lacks information, over seeds that all have. A learned "
        "reward has to be above 0 here.",
        "first scores",
        "+z.2f",
    ),
    Column(
        "seeds",
        "Seeds ok",
        "Seeds that finished without failure, and seeds that were asked for.",
        lambda item: Value(f"{item.seeds_ok} of {item.seeds}", item.seeds_ok),
        places="first scores",
    ),
    DEMONSTRATIONS,
    Column(
        "note", "Note", "The line's origin; seeds without a score, and why.", _note, "note", "first scores"
    ),
    Column("remarks", "Note", "The role, and all of the note.", _remarks, "note", "terminal"),
    Column(
        "role",
        "Role",
        "Methods are compared with each other. A lower control's reward has no information, the upper "
        "control's is the true one.",
        attrgetter("role"),
        "text",
    ),
    Column(
        "return",
        "Return",
        "Undiscounted return under the true reward, mean over seeds.",
        lambda item: interval(item.return_mean, item.return_low, item.return_high, ".1f"),
        "interval",
        "costs",
    ),
    _number("Discounted return", "discounted_mean", "z.2f", "Return, discounted with the task's gamma."),
    DISTANCE,
    RANK,
    _of_reward(
        "Policies: rank",
        "policy_ranking",
        "Spearman's correlation of twenty policies' returns under the learned and the true reward.",
    ),
    _of_reward(
        "Share of control_true",
        "share_of_true",
        "Score as a share of the score that RL reaches on the true reward in one solve.",
    ),
    _of_reward(
        "Solved",
        "solved",
        "Share of seeds on which π_R earns, under R*, 95 % of the gain of π* over a random policy. Elsewhere "
        "its score says nothing about the reward, only about RL.",
        spec=".0%",
    ),
    _number("Own return", "own_return", ".1f", "Return under R*, less the absorbing state's pay.", "rewards"),
    _number("Of demonstrations", "own_return_shown", ".1f", "The demonstrations' own return.", "rewards"),
    SECONDS,
    STEPS,
    _number("Check steps", "check_steps", ",.0f", "Environment steps that judge checkpoints of RL.", "costs"),
    SOLVES,
)
"""Columns in the order of the leaderboard."""


def visible(place: str) -> list[Column]:
    """Return the columns of the leaderboard that are visible at a place of `Column.places`."""
    return [column for column in ENTRY if place in column.places.split()]


def of_page() -> list[Column]:
    """Return all columns of the page's leaderboard."""
    return [column for column in ENTRY if column.places != "terminal"]
