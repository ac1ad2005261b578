"""The second stage of a cell: a policy and a reward, learned from demonstrations."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from harness.cell.inputs import Inputs
from harness.judge.controls import control_reward
from harness.judge.evaluation import totals
from harness.records import CellResult, PolicyName
from harness.registry import RANKED, THESIS, base
from harness.registry.bounds import LONGEST_TEXT, MOST_CURVES, MOST_DETAILS, MOST_POINTS, Curve, thinned
from harness.registry.plugins import method_for
from harness.rl.learned import check_learned, check_suitable
from harness.rl.seeds import rng_for
from harness.rl.world import TaskWorld
from harness.store.codec import printable
from methods.base import Episodes, Learned, Policy, Reward, Unsuitable, World
from methods.parts import BEGINS_WITH, TwoParts
from methods.rewards import fast

SAME_NUMBERS = BEGINS_WITH | dict.fromkeys(THESIS, "shaped")
"""Methods by whose name others draw their random numbers, because their fits are compared."""
OF_RL = ("pi_R", "pi_R_true", "pi_R_chosen")
"""Curves that RL adds to those of a method."""


@dataclass(frozen=True)
class Candidate:
    """A policy to be scored, or the reason for its absence.

    `reward`: the learned reward that belongs to it, None where that is the true one or missing.
    `columns`: columns of its row of scores.csv besides the scores.
    `solves`: the policy of each RL solve, with its return under R* on the judging episodes.
    `others`: rewards of other methods that begin with the same fit, by name.
    """

    name: PolicyName
    policy: Policy | None
    reward: Reward | None = None
    columns: Mapping[str, Any] = field(default_factory=dict)
    curves: Mapping[str, Curve] = field(default_factory=dict)
    details: Mapping[str, float] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()
    solves: Sequence[tuple[Policy, float]] = ()
    others: Mapping[str, Reward] = field(default_factory=dict)


@dataclass(frozen=True)
class Fitted:
    """A learned policy and reward.

    `star`: pi*, None for a control, which is a reward alone.
    `skipped`: the reason why RL does not follow, '' where it does.
    `columns`: columns of all rows of the cell.
    """

    star: Candidate | None
    reward: Reward | None
    skipped: str = ""
    columns: Mapping[str, float] = field(default_factory=dict)


def fit(inputs: Inputs) -> Fitted:
    """Return what the cell's method learns, or what the cell before learned where that was handed over."""
    learned = inputs.shared.learned
    if inputs.is_transfer and {"pi_star", "reward"} <= learned.keys():
        fitted = Fitted(Candidate("pi_star", learned["pi_star"], learned["reward"]), learned["reward"])
    else:
        fitted = _fit_now(inputs)
    why = (
        "learns no reward" if fitted.reward is None else "" if inputs.conditions.retrain else "not asked for"
    )
    return replace(fitted, skipped=fitted.skipped or why)


def _fit_now(inputs: Inputs) -> Fitted:
    demos, world, first = demonstrations(inputs), inputs.world(), _first(inputs)
    try:
        learned = learned_by(inputs, inputs.cell.method, demos, world, first)
    except Unsuitable as error:
        reason = _reason(error)
        return Fitted(Candidate("pi_star", None, columns={"reason": reason}), None, reason)
    if inputs.is_transfer:  # the cell in the task's own dynamics has the columns of the fit
        return Fitted(Candidate("pi_star", learned.policy, learned.reward), learned.reward)
    columns = {"pairs": _pairs(demos)}
    if learned.reward is not None and demos.whole and demos.has_actions:
        paid = totals(fast(learned.reward), list(zip(demos.obs, demos.act, strict=True)))
        columns["own_return_shown"] = float(paid.mean())
    star = _star(inputs, learned, world)
    if first:
        star = _after(inputs.shared.before, star)
    return Fitted(star, learned.reward, columns=columns)


def _first(inputs: Inputs) -> Learned | None:
    """Return the first part of the fit, where the cell before has learned it."""
    learned, name = inputs.shared.learned, inputs.cell.method
    if inputs.is_transfer or name not in BEGINS_WITH or "pi_star" not in learned:
        return None
    others = {name: learned[name]} if name in learned else {}
    return Learned(learned["pi_star"], learned.get("reward"), others=others)


def _after(before: CellResult, star: Candidate) -> Candidate:
    """Return pi* with what the first part of its fit took, and with its curves."""
    row = next(row for row in before.rows if row.policy == "pi_star")
    took = {name: value + getattr(row, name) for name, value in star.columns.items()}
    of_first = {name: curve for name, curve in before.curves.items() if name not in OF_RL}
    return replace(star, columns=took, curves={**of_first, **star.curves})


def _star(inputs: Inputs, learned: Learned, world: TaskWorld) -> Candidate:
    """Return pi* with what its fit took, and with the method's own curves and numbers."""
    curves = {**world.curves, **learned.curves}
    most, count = MOST_CURVES - len(OF_RL), len(curves)
    warning = f"{inputs.cell.name}: of {count} curves the first {most} are kept"
    answers = [("answers of the expert", world.answers)] if world.answers else []
    details = [*[*learned.details.items()][: MOST_DETAILS - 1], *answers]
    took = {name: getattr(world, name) for name in ("env_steps", "check_steps", "rl_solves")}
    return Candidate(
        *("pi_star", learned.policy, learned.reward),
        columns={"fit_seconds": inputs.seconds["fit"], **took},
        curves={name: _curve(values) for name, values in [*curves.items()][:most]},
        details={name: float(value) for name, value in details},
        warnings=(warning,) if count > most else (),
        others=learned.others,
    )


def _curve(values: Sequence[float]) -> Curve:
    """Return the points that are stored of one value an iteration."""
    return [(float(x), float(y)) for x, y in thinned(list(enumerate(values, 1)), MOST_POINTS)]


def _reason(error: Unsuitable) -> str:
    return printable(" ".join(str(error).split()))[:LONGEST_TEXT] or type(error).__name__


def _pairs(demos: Episodes) -> float:
    return sum(map(len, demos.act)) if demos.has_actions else 0


def demonstrations(inputs: Inputs) -> Episodes:
    """Return the demonstrations of the environment and seed."""
    with inputs.stage("demonstrate"):
        return inputs.shared.demonstrations(inputs.cell.shown)


def learned_by(
    inputs: Inputs, method: str, demos: Episodes, world: World, first: Learned | None = None
) -> Learned:
    """Return what a method learns with the settings of its environment and budget. `first`: the first part of
    its fit, None where that is still to be done."""
    with inputs.stage("fit"):
        name = SAME_NUMBERS.get(base(method), base(method))
        rng = rng_for(inputs.cell.seed, inputs.cell.env, name, "fit")
        ranks = demos.preferences if base(method) in RANKED else None
        obs, act = (tuple(map(np.array, column)) for column in (demos.obs, demos.act))
        own = replace(demos, obs=obs, act=act, preferences=ranks)
        made = method_for(method, inputs.cell.env, inputs.conditions.budget)
        check_suitable(made, demos)
        if first and isinstance(made, TwoParts):
            learned = made.go_on(first, own, world, *rng.spawn(1))
        else:
            learned = made.fit(own, world, rng)
        check_learned(learned, inputs.spec, demos)
    return learned


def fit_control(inputs: Inputs) -> Fitted:
    """Return the reward of a control, None for the true one. It is skipped where its method is."""
    learned, control = inputs.shared.learned, inputs.cell.method
    if (reward := learned.get("reward")) is not None:  # bc has none
        return Fitted(None, reward)
    columns = dict[str, float]()

    def shown() -> Episodes:
        demos = demonstrations(inputs)
        columns["pairs"] = _pairs(demos)
        return demos

    def fitted(method: str, demos: Episodes) -> Learned:
        if control == "control_clone" and "pi_star" in learned:
            return Learned(learned["pi_star"], None)
        return learned_by(inputs, method, demos, inputs.world())

    try:
        reward = control_reward(control, shown, fitted, inputs.spec.random_actions, inputs.rng("control"))
    except Unsuitable as error:
        return Fitted(None, None, _reason(error))
    return Fitted(None, reward, columns=columns)
