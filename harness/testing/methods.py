"""What every method must satisfy, cheap checks first."""

from __future__ import annotations

import dataclasses
import numbers
from functools import partial

import numpy as np

from envs.gridworld import SPEC, objectworld
from envs.learners import DDPG
from envs.spec import EnvSpec
from harness.registry import ASKING, load_method
from harness.testing.contract import Check, expect
from harness.testing.worlds import FakeWorld
from methods.base import Array, Episodes, Learned, Method, Reward

OBS = np.random.default_rng(7).normal(size=(40, 3)) * 3
ACT = np.random.default_rng(8).uniform(-1, 1, (40, 2))
HYPER = "a method's fields are its hyper-parameters"


def checks(method: Method, asks: bool | None = None) -> list[Check]:
    """Return what it must satisfy; each is to be called. They use a world that answers at once, with
    observations (3,) and actions (2,), and a real one of 4 by 4 states with 5 choices.

    asks: whether it may ask the expert. By default it may where it is a built-in method that may.
    """
    if asks is None:
        asks = type(method) in map(load_method, ASKING)
    lasting, terminating = _demonstrations(10), _demonstrations(3)
    return [
        Check("it is a frozen dataclass", partial(_is_frozen, method)),
        Check("fit returns a policy and a reward", partial(_answers, method, asks, lasting)),
        Check("so it does where demonstrations terminate", partial(_answers, method, asks, terminating)),
        Check("so it does of every other step", partial(_answers, method, asks, lasting.every(2, _rng(0)))),
        Check("so it does of one step", partial(_answers, method, asks, _one_step(False))),
        Check("so it does of one step that terminates", partial(_answers, method, asks, _one_step(True))),
        Check("nothing but its generator decides", partial(_is_reproducible, method, asks, lasting)),
        Check("it leaves demonstrations as they are", partial(_leaves, method, asks, lasting)),
        Check("it fits where the model is known", partial(_knows, method, asks)),
    ]


def check_learned(learned: object, obs: Array = OBS, act: Array = ACT) -> None:
    """Raises ContractError unless it is a `Learned` for observations (B, O) and actions (B, A)."""
    expect(isinstance(learned, Learned), f"fit must return a Learned, not {type(learned).__name__}")
    assert isinstance(learned, Learned)
    chosen = learned.policy(obs.copy())
    expect(
        isinstance(chosen, np.ndarray) and chosen.shape == act.shape,
        f"the policy must give actions {act.shape} for observations {obs.shape}, not {np.shape(chosen)}",
    )
    chosen = chosen.copy()  # for it may be the policy's own buffer
    expect(chosen.dtype.kind == "f", f"actions must be real numbers, floating-point, not {chosen.dtype}")
    expect(np.isfinite(chosen).all(), "actions must be finite")
    expect(np.abs(chosen).max() <= 1, f"actions must lie in [-1, 1], one is {np.abs(chosen).max():.3g}")
    expect(np.array_equal(learned.policy(obs), chosen), "the policy must be deterministic")
    expect(
        np.allclose(learned.policy(obs[3:4]), chosen[3:4]),
        "an action must not depend on what else is asked in the same batch",
    )
    for name, curve in learned.curves.items():
        finite = len(curve) > 0 and np.isfinite(curve).all()
        expect(finite, f"the curve {name!r} must hold finite numbers, at least one")
    if learned.reward is not None:
        _check_reward(learned.reward, obs, act)


def _check_reward(reward: Reward, obs: Array, act: Array) -> None:
    expect(
        hasattr(reward, "absorbing"),
        "a reward needs `absorbing`, what a step after termination pays (docs/termination.md)",
    )
    expect(
        isinstance(reward.absorbing, numbers.Real) and bool(np.isfinite(reward.absorbing)),
        f"`absorbing` must be a finite number, not {reward.absorbing!r}",
    )
    paid = reward(obs.copy(), act.copy(), obs.copy())
    expect(
        np.shape(paid) == (len(obs),),
        f"the reward must give one number a step, ({len(obs)},), not {np.shape(paid)}",
    )
    paid = np.array(paid)
    kind = paid.dtype
    expect(kind.kind == "f", f"rewards must be real numbers, floating-point, not {kind}")
    expect(np.isfinite(paid).all(), "rewards must be finite")
    expect(np.array_equal(reward(obs, act, obs), paid), "the reward must be deterministic")
    expect(
        np.allclose(reward(obs[3:4], act[3:4], obs[3:4]), paid[3:4]),
        "a reward must not depend on what else is asked in the same batch",
    )


def _rng(seed: int) -> np.random.Generator:
    return np.random.default_rng(seed)


def _demonstrations(lifetime: int) -> Episodes:
    return FakeWorld(lifetime).rollout(lambda obs: np.clip(obs[:, :2], -0.9, 0.9), 4, _rng(0))


def _one_step(terminated: bool) -> Episodes:
    obs, act = np.array([[0.1, 0.2, 0.3], [0.3, 0.2, 0.1]]), np.array([[0.5, -0.5]])
    return Episodes((obs,), (act,), (terminated,))


def _is_frozen(method: Method) -> None:
    kind = type(method)
    expect(dataclasses.is_dataclass(kind), f"{kind.__name__} must be a dataclass: {HYPER}")
    frozen = kind.__dataclass_params__.frozen  # type: ignore[attr-defined]
    expect(frozen, f"{kind.__name__} must be frozen, @dataclass(frozen=True): {HYPER}, and do not change")


def _fitted(method: Method, asks: bool, demos: Episodes) -> Learned:
    return method.fit(demos, FakeWorld(asked=asks, unit=DDPG().unit), _rng(0))


def _answers(method: Method, asks: bool, demos: Episodes) -> None:
    check_learned(_fitted(method, asks, demos))


def _outcome(method: Method, asks: bool, demos: Episodes) -> list[Array]:
    learned = _fitted(method, asks, demos)
    found = [learned.policy(OBS), *map(np.array, learned.curves.values())]
    if learned.reward is not None:
        found += [learned.reward(OBS, ACT, OBS), np.array(learned.reward.absorbing)]
    return found


def _is_reproducible(method: Method, asks: bool, demos: Episodes) -> None:
    before = np.random.get_state()  # noqa: NPY002
    try:
        one = _outcome(method, asks, demos)
        np.random.seed(5)  # noqa: NPY002
        other = _outcome(method, asks, demos)
    finally:
        np.random.set_state(before)  # noqa: NPY002
    expect(
        len(one) == len(other) and all(map(np.array_equal, one, other)),
        "two fits with equal generators differ: draw from `rng` alone, and seed torch's by it",
    )


def _leaves(method: Method, asks: bool, demos: Episodes) -> None:
    before = [array.copy() for array in (*demos.obs, *demos.act)]
    _fitted(method, asks, demos).policy(OBS)
    after = (*demos.obs, *demos.act)
    expect(all(map(np.array_equal, before, after)), "fit changed the demonstrations, which others get too")
    expect(not any(array.flags.writeable for array in after), "fit made the demonstrations writeable")


def known_task() -> EnvSpec:
    """Return a small task whose model is known."""
    tabular, horizon = objectworld(4, 3, 2, 0.3, _rng(0)), 10
    return dataclasses.replace(
        SPEC,
        name="objectworld_4",
        kwargs={"tabular": tabular, "max_episode_steps": horizon},
        tabular=tabular,
        horizon=horizon,
        gamma=0.9,
        phi=lambda obs, act: tabular.features[tabular.states(obs)],
    )


def _knows(method: Method, asks: bool) -> None:
    from harness.learn.exact import ExactSolver  # slow to import, as all that can learn by reinforcement
    from harness.learn.world import TaskWorld

    spec = known_task()
    assert spec.tabular is not None
    expert = ExactSolver(spec.tabular, spec.gamma, _rng(3)).best(None).policy

    def fit() -> Learned:
        world = TaskWorld(spec, "absorbing", "sbx", expert if asks else None)
        return method.fit(world.rollout(expert, 4, _rng(1)), world, _rng(0))

    rng = _rng(2)
    obs, act = rng.normal(size=(40, 6)), np.eye(5)[rng.integers(5, size=40)]
    one, same = fit(), fit()
    check_learned(one, obs, act)
    expect(np.array_equal(one.policy(obs), same.policy(obs)), "two fits with equal generators differ")
    if one.reward is not None and same.reward is not None:
        paid = one.reward(obs, act, obs)
        expect(np.array_equal(paid, same.reward(obs, act, obs)), "two fits with equal generators differ")
