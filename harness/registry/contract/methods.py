"""The contract of methods, cheap checks first. All run in real worlds, with all that these refuse."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from functools import partial

import numpy as np

from harness.registry.built_in import ASKING
from harness.registry.contract import small
from harness.registry.contract.check import Check, expect
from harness.registry.known import load_method
from harness.rl.exact import ExactSolver
from harness.rl.learned import check_learned, needs_actions
from harness.rl.world import TaskWorld
from methods.base import Array, Episodes, Learned, Method, Reward

ROWS = 40
OBS = np.random.default_rng(7).normal(size=(ROWS, 3)) * 3
ACT = np.random.default_rng(8).uniform(-1, 1, (ROWS, 2))
HYPER = "a method's fields are its hyper-parameters"
STEPS = 320
"""Environment steps of a solve."""


def checks(method: Method, asks: bool | None = None) -> list[Check]:
    """Return the checks of a method, to be called.

    One world has observations (3,) and actions (2,). The other has 4 by 4 states, 5 choices and a known
    model. `asks`: whether the method may ask the expert; by default the built-in methods that are marked so.
    """
    if asks is None:
        asks = type(method) in map(load_method, ASKING)
    lasting, ending = small.shown(small.HORIZON), small.shown(3)
    thinned = lasting.every(2, np.random.default_rng(0))
    unacted = dataclasses.replace(lasting, act=tuple(act[:, :0] for act in lasting.act))
    fit = partial(_fit, method, asks)
    return [
        Check("it is a frozen dataclass", partial(_is_frozen, method)),
        Check("fit returns a policy and a reward", lambda: _answers(fit, lasting)),
        Check("so it does where demonstrations terminate", lambda: _answers(fit, ending)),
        Check("so it does of every other step", lambda: _answers(fit, thinned)),
        *(
            []
            if needs_actions(method)
            else [Check("so it does without actions", lambda: _answers(fit, unacted))]
        ),
        Check("so it does of one step", lambda: _answers(fit, _one_step(False))),
        Check("so it does of one step that terminates", lambda: _answers(fit, _one_step(True))),
        Check("nothing but its generator decides", lambda: _is_reproducible(fit, lasting)),
        Check("it leaves demonstrations as they are", lambda: _leaves(fit, lasting)),
        Check("it fits where the model is known", partial(_knows, method, asks)),
    ]


def check_answers(learned: Learned, obs: Array, act: Array) -> None:
    """Raise ContractError unless answers are the same whenever and with whatever else they are asked.

    `obs`, `act`: (B, O) and (B, A).
    """
    policy, answers = learned.policy, learned.policy(obs.copy()).copy()  # It may be the policy's own buffer.
    expect(np.array_equal(policy(obs), answers), "the policy must be deterministic")
    expect(
        np.allclose(policy(obs[3:4]), answers[3:4]),
        "an action must not depend on what else is asked in the same batch",
    )
    if (reward := learned.reward) is None:
        return
    paid = np.array(reward(obs.copy(), act.copy(), obs.copy()))
    expect(np.array_equal(reward(obs, act, obs), paid), "the reward must be deterministic")
    expect(
        np.allclose(reward(obs[3:4], act[3:4], obs[3:4]), paid[3:4]),
        "a reward must not depend on what else is asked in the same batch",
    )


def _one_step(terminated: bool) -> Episodes:
    obs, act = np.array([[0.1, 0.2, 0.3], [0.3, 0.2, 0.1]]), np.array([[0.5, -0.5]])
    return Episodes((obs,), (act,), (terminated,))


def _is_frozen(method: Method) -> None:
    kind = type(method)
    expect(dataclasses.is_dataclass(kind), f"{kind.__name__} must be a dataclass: {HYPER}")
    frozen = kind.__dataclass_params__.frozen  # type: ignore[attr-defined]
    expect(frozen, f"{kind.__name__} must be frozen, @dataclass(frozen=True): {HYPER}, and do not change")


def _fit(method: Method, asks: bool, demos: Episodes) -> Learned:
    expert = small.chosen if asks else None
    world = TaskWorld(small.noise(), "absorbing", "sb3", expert, solve_steps=STEPS, budget="smoke")
    return method.fit(demos, world, np.random.default_rng(0))


def _answers(fit: Callable[[Episodes], Learned], demos: Episodes) -> None:
    learned = fit(demos)
    tried = Episodes((np.concatenate([OBS, OBS[:1]]),), (ACT.copy(),), (False,))
    check_learned(learned, small.noise(), tried, ROWS)
    for name, curve in learned.curves.items():
        expect(len(curve) > 0, f"the curve {name!r} has no values")
    check_answers(learned, OBS, ACT)


def _outcome(learned: Learned) -> list[Array]:
    reward: Reward | None = learned.reward
    values = [learned.policy(OBS), *map(np.array, learned.curves.values())]
    return [*values, reward(OBS, ACT, OBS), np.array(reward.absorbing)] if reward is not None else values


def _is_reproducible(fit: Callable[[Episodes], Learned], demos: Episodes) -> None:
    before = np.random.get_state()  # noqa: NPY002
    try:
        one = _outcome(fit(demos))
        np.random.seed(5)  # noqa: NPY002
        other = _outcome(fit(demos))
    finally:
        np.random.set_state(before)  # noqa: NPY002
    same = len(one) == len(other) and all(map(partial(np.array_equal, equal_nan=True), one, other))
    expect(same, "two fits with equal generators differ: draw from `rng` alone, and seed torch's by it")


def _leaves(fit: Callable[[Episodes], Learned], demos: Episodes) -> None:
    before = [array.copy() for array in (*demos.obs, *demos.act)]
    fit(demos).policy(OBS)
    after = (*demos.obs, *demos.act)
    expect(all(map(np.array_equal, before, after)), "fit changed the demonstrations, which others get too")
    expect(not any(array.flags.writeable for array in after), "fit made the demonstrations writeable")


def _knows(method: Method, asks: bool) -> None:
    spec = small.known()
    assert spec.tabular is not None
    expert = ExactSolver(spec.tabular, spec.gamma, np.random.default_rng(3)).best(None).policy

    def fit() -> tuple[Learned, Episodes]:
        world = TaskWorld(spec, "absorbing", "sb3", expert if asks else None, budget="smoke")
        demos = world.rollout(expert, 4, np.random.default_rng(1))
        demos = dataclasses.replace(demos, preferences=np.array([[0, 1], [1, 2]]))
        return method.fit(demos, world, np.random.default_rng(0)), demos

    (one, demos), (other, _) = fit(), fit()
    check_learned(one, spec, demos)
    obs, act = demos.pairs()
    check_answers(one, obs, act)
    same = np.array_equal(one.policy(obs), other.policy(obs))
    if one.reward is not None and other.reward is not None:
        same &= np.array_equal(one.reward(obs, act, obs), other.reward(obs, act, obs))
    expect(same, "two fits with equal generators differ")
