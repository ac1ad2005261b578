"""What every method must satisfy."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from envs.gridworld import objectworld
from harness import registry
from harness.registry import load_method
from methods.airl import AIRL
from methods.base import Array, Episodes, Learned, Method, Reward, Unsuitable
from methods.settings import settings_for
from methods.sqil import SQIL

pytestmark = pytest.mark.usefixtures("fused_adam")
FITS = {"steps": 40, "iterations": 10}
MARGINS = {"iterations": 2, "rollouts": 3, "epsilon": -1.0}
GAME = {"iterations": 2, "rollouts": 3, "reward_steps": 20}
BRIEF: dict[str, dict[str, Any]] = {
    "shaped": FITS,
    "shaped_decay": FITS,
    "shaped_ml": FITS,
    "shaped_ranked": FITS | {"rollouts": 2, "comparisons": 20, "reward_steps": 20},
    "bc": FITS,
    "maxmargin": MARGINS,
    "maxmargin_projection": MARGINS,
    "maxent": {"iterations": 2, "rollouts": 3, "reward_steps": 20},
    "maxent_state": {"iterations": 2, "rollouts": 3, "reward_steps": 20},
    "csil": FITS,
    "gail": GAME,
    "gail_mean": GAME,
    "gail_mean_state": GAME,
    "airl": GAME | {"known_steps": 3},
    "airl_state": GAME | {"known_steps": 3},
    "f_irl": GAME | {"known_steps": 3},
    "dagger": FITS | {"rounds": 1},
    "maxent_linear": {"iterations": 2, "rollouts": 3},
}
"""Settings that save time; the others are those of `smoke`."""
METHODS: dict[str, Method] = {
    name: load_method(name)(**(settings_for(name, "cartpole", "smoke") | BRIEF.get(name, {})))
    for name in (*registry.METHODS, *registry.VARIANTS)
}
OBS = np.random.default_rng(7).normal(size=(40, 3)) * 3
ACT = np.random.default_rng(8).uniform(-1, 1, (40, 2))


@pytest.fixture(params=METHODS.values(), ids=list(METHODS))
def method(request: pytest.FixtureRequest) -> Method:
    return request.param


@pytest.fixture(params=[10, 3], ids=["demonstrations of whole episodes", "that terminate"])
def demos(request: pytest.FixtureRequest, demonstrate: Callable[..., Episodes]) -> Episodes:
    return demonstrate(lambda obs: np.clip(obs[:, :2], -0.9, 0.9), count=4, lifetime=request.param)


def check(learned: Learned, obs: Array = OBS, some: Array = ACT) -> None:
    act = learned.policy(obs)
    assert act.shape == some.shape
    assert np.abs(act).max() <= 1
    np.testing.assert_array_equal(learned.policy(obs), act)
    np.testing.assert_allclose(learned.policy(obs[3:4]), act[3:4])
    for curve in learned.curves.values():
        assert len(curve) > 0
        assert np.isfinite(curve).all()
    reward = learned.reward
    if reward is None:
        return
    assert isinstance(reward, Reward)
    assert isinstance(reward.absorbing, float)
    assert np.isfinite(reward.absorbing)
    values = reward(obs, some, obs)
    assert values.shape == (len(obs),)
    assert np.isfinite(values).all()
    np.testing.assert_array_equal(reward(obs, some, obs), values)
    np.testing.assert_allclose(reward(obs[3:4], some[3:4], obs[3:4]), values[3:4])


def test_it_returns_a_deterministic_policy_and_a_finite_reward(
    method: Method, demos: Episodes, world: Any
) -> None:
    check(method.fit(demos, world, np.random.default_rng(0)))


def test_so_it_does_of_steps_that_are_far_apart(method: Method, demos: Episodes, world: Any) -> None:
    few = demos.every(2, np.random.default_rng(0))
    if isinstance(method, AIRL | SQIL):
        with pytest.raises(Unsuitable, match="every step is shown"):
            method.fit(few, world, np.random.default_rng(0))
        return
    check(method.fit(few, world, np.random.default_rng(0)))


def test_so_it_does_where_the_model_is_known(method: Method, finite_world: Any) -> None:
    def fit(seed: int) -> Learned:
        world = finite_world(objectworld(4, 3, 2, 0.3, np.random.default_rng(0)))
        demos = world.rollout(world.optimal(), 4, np.random.default_rng(1))
        return method.fit(demos, world, np.random.default_rng(seed))

    rng = np.random.default_rng(2)
    obs, act = rng.normal(size=(40, 6)), np.eye(5)[rng.integers(5, size=40)]
    one, same = fit(0), fit(0)
    check(one, obs, act)
    np.testing.assert_array_equal(one.policy(obs), same.policy(obs))
    if one.reward is not None and same.reward is not None:
        np.testing.assert_array_equal(one.reward(obs, act, obs), same.reward(obs, act, obs))


def outcome(method: Method, demos: Episodes, world: Any, seed: int) -> list[Array]:
    learned = method.fit(demos, world, np.random.default_rng(seed))
    found = [learned.policy(OBS), *map(np.array, learned.curves.values())]
    if learned.reward is not None:
        found += [learned.reward(OBS, ACT, OBS), np.array(learned.reward.absorbing)]
    return found


def test_nothing_but_the_generator_decides(method: Method, demos: Episodes, world: Any) -> None:
    one = outcome(method, demos, world, seed=0)
    # Nor may a global generator matter.
    np.random.seed(5)  # noqa: NPY002
    for first, second in zip(one, outcome(method, demos, world, seed=0), strict=True):
        np.testing.assert_array_equal(first, second)


@pytest.mark.parametrize("method", [METHODS[name] for name in BRIEF], ids=list(BRIEF), indirect=True)
def test_these_methods_draw_from_it(method: Method, demos: Episodes, world: Any) -> None:
    """Not every method: one that is deterministic keeps the contract."""
    both = (outcome(method, demos, world, seed) for seed in (0, 1))
    assert any((first != other).any() for first, other in zip(*both, strict=True))


def test_it_leaves_the_demonstrations_as_they_are(method: Method, demos: Episodes, world: Any) -> None:
    before = [array.copy() for array in (*demos.obs, *demos.act)]
    learned = method.fit(demos, world, np.random.default_rng(0))
    learned.policy(OBS)
    for array, copy in zip((*demos.obs, *demos.act), before, strict=True):
        np.testing.assert_array_equal(array, copy)
        assert not array.flags.writeable


@pytest.mark.parametrize("terminated", [False, True])
def test_one_demonstration_of_one_step_is_enough(method: Method, world: Any, terminated: bool) -> None:
    one = Episodes((np.array([[0.1, 0.2, 0.3], [0.3, 0.2, 0.1]]),), (np.array([[0.5, -0.5]]),), (terminated,))
    check(method.fit(one, world, np.random.default_rng(0)))
