"""The second stage of a cell: a policy and a reward, learned from demonstrations."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, cast

import numpy as np

from harness.cell.inputs import Inputs, Seconds, added
from harness.judge.controls import control_reward
from harness.judge.evaluation import totals
from harness.records import REFERENCE, PolicyName, policies_of
from harness.registry import load_method
from harness.registry.bounds import LONGEST_TEXT, MOST_CURVES, MOST_POINTS, Curve, thinned
from harness.registry.plugins import settings_for
from harness.rl.learned import check_learned
from harness.rl.seeds import rng_for
from harness.rl.world import TaskWorld
from harness.store.codec import printable
from methods.base import Episodes, Learned, Policy, Reward, Unsuitable, World
from methods.rewards import fast

SAME_FIT = {"gail_mean": "gail", "shaped_ml": "shaped", "shaped_ranked": "shaped"}
"""Methods by whose name others draw their random numbers, because both begin with the same fit."""
OWN_CURVES = 3
"""Curves that RL adds to those of a method."""


@dataclass(frozen=True)
class Candidate:
    """A policy to be scored, or the reason for its absence.

    `reward`: the learned reward that belongs to it, None where that is the true one or missing.
    `columns`: columns of its row of scores.csv besides the scores.
    `solves`: the policy of each RL solve, with its return under R* on the judging episodes.
    """

    name: PolicyName
    policy: Policy | None
    reward: Reward | None = None
    columns: Mapping[str, Any] = field(default_factory=dict)
    curves: Mapping[str, Curve] = field(default_factory=dict)
    details: Mapping[str, float] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()
    solves: Sequence[tuple[Policy, float]] = ()


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
    seconds: Seconds = field(default_factory=dict)


def fit(inputs: Inputs) -> Fitted:
    """Return what the cell's method learns, or what the cell before learned where that was handed over."""
    learned = inputs.shared.learned
    if {"pi_star", "reward"} <= learned.keys():
        fitted = Fitted(Candidate("pi_star", learned["pi_star"], learned["reward"]), learned["reward"])
    else:
        fitted = _fit_now(inputs)
    if fitted.skipped:
        return fitted
    if fitted.reward is None:
        return replace(fitted, skipped="learns no reward")
    return fitted if inputs.conditions.retrain else replace(fitted, skipped="not asked for")


def _fit_now(inputs: Inputs) -> Fitted:
    demos, columns, seconds = demonstrations(inputs)
    world = inputs.world()
    reason = ""
    with inputs.stage("fit") as stopwatch:
        try:
            learned = learned_by(inputs, inputs.cell.method, demos, world)
        except Unsuitable as error:
            reason = printable(" ".join(str(error).split()))[:LONGEST_TEXT] or type(error).__name__
    seconds = added(seconds, {"fit": stopwatch.seconds})
    if reason:
        return Fitted(Candidate("pi_star", None, columns={"reason": reason}), None, reason, seconds=seconds)
    if inputs.is_transfer:  # the cell in the task's own dynamics has the columns of the fit
        star = Candidate("pi_star", learned.policy, learned.reward)
        return Fitted(star, learned.reward, seconds=seconds)
    if learned.reward is not None and demos.whole:
        paid = totals(fast(learned.reward), list(zip(demos.obs, demos.act, strict=True)))
        columns = {**columns, "own_return_shown": float(paid.mean())}
    star = _star(inputs, learned, world, stopwatch.seconds)
    return Fitted(star, learned.reward, columns=columns, seconds=seconds)


def _star(inputs: Inputs, learned: Learned, world: TaskWorld, seconds: float) -> Candidate:
    """Return pi* with what its fit took, and with the method's own curves and numbers."""
    most = MOST_CURVES - OWN_CURVES
    warnings: tuple[str, ...] = ()
    if len(learned.curves) > most:
        warnings = (f"{inputs.cell.name}: of {len(learned.curves)} curves the first {most} are kept",)
    answers = {"answers of the expert": world.answers} if world.answers else {}
    return Candidate(
        "pi_star",
        learned.policy,
        learned.reward,
        columns={
            "fit_seconds": seconds,
            "env_steps": world.env_steps,
            "check_steps": world.check_steps,
            "rl_solves": world.rl_solves,
        },
        curves={name: _curve(values) for name, values in list(learned.curves.items())[:most]},
        details={**learned.details, **answers},
        warnings=warnings,
    )


def _curve(values: Sequence[float]) -> Curve:
    """Return the points that are stored of one value an iteration."""
    return [(float(x), float(y)) for x, y in thinned(list(enumerate(values, 1)), MOST_POINTS)]


def demonstrations(inputs: Inputs) -> tuple[Episodes, dict[str, float], Seconds]:
    """Return the demonstrations of the environment and seed, their count of pairs, and the wall time."""
    with inputs.stage("demonstrate") as stopwatch:
        demos = inputs.shared.demonstrations(inputs.cell.shown)
    return demos, {"pairs": sum(map(len, demos.act))}, {"demonstrate": stopwatch.seconds}


def learned_by(inputs: Inputs, method: str, demos: Episodes, world: World) -> Learned:
    """Return what a method learns with the settings of its environment and budget."""
    settings = settings_for(method, inputs.cell.env, inputs.conditions.budget)
    rng = rng_for(inputs.cell.seed, inputs.cell.env, SAME_FIT.get(method, method), "fit")
    own = replace(demos, obs=tuple(map(np.array, demos.obs)), act=tuple(map(np.array, demos.act)))
    learned = load_method(method)(**settings).fit(own, world, rng)
    check_learned(learned, inputs.spec, demos)
    return learned


def fit_control(inputs: Inputs) -> Fitted:
    """Return the reward of a control, None for the true one."""
    learned = inputs.shared.learned
    if (reward := learned.get("reward")) is not None:  # bc has none
        return Fitted(None, cast(Reward, reward))
    columns, seconds = dict[str, float](), list[Seconds]()

    def shown() -> Episodes:
        demos, pairs, took = demonstrations(inputs)
        columns.update(pairs)
        seconds.append(took)
        return demos

    def fitted(method: str, demos: Episodes) -> Learned:
        if inputs.cell.method == "control_clone" and "pi_star" in learned:
            return Learned(learned["pi_star"], None)
        with inputs.stage("fit") as stopwatch:
            result = learned_by(inputs, method, demos, inputs.world())
        seconds.append({"fit": stopwatch.seconds})
        return result

    control = inputs.cell.method
    reward = control_reward(control, shown, fitted, inputs.spec.random_actions, inputs.rng("control"))
    return Fitted(None, reward, columns=columns, seconds=added(*seconds))


def random_policy(inputs: Inputs) -> Policy:
    """Return the random policy of the environment and seed, whose actions are the same in every cell."""
    spec = inputs.place
    rng = rng_for(inputs.cell.seed, inputs.cell.env, REFERENCE, "random policy")
    return lambda obs: spec.random_actions(len(obs), rng)


def skipped(inputs: Inputs, fitted: Fitted) -> list[Candidate]:
    """Return the candidates of a cell in which RL does not follow the fit."""
    assert fitted.star is not None
    rest = [name for name in policies_of(inputs.cell) if name != "pi_star"]
    return [fitted.star, *(Candidate(name, None, columns={"reason": fitted.skipped}) for name in rest)]
