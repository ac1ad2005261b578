"""Observations and actions of any space: vectors with names, and choices or numbers."""

from collections.abc import Callable
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium import spaces
from gymnasium.wrappers import RescaleAction, TimeLimit, TransformObservation

from envs import from_gymnasium
from envs.copies import try_out
from harness.registry.contract.tasks import checks
from tests.harness.odd_env import BOX, LIMIT, Odd, inner

PLACE = spaces.Box(-2.0, 2.0, (2,), np.float32)
OBSERVED: dict[str, tuple[spaces.Space, Any, dict[str, float]]] = {
    "choice": (spaces.Discrete(3, start=-1), 1, {"obs=-1": 0, "obs=0": 0, "obs=1": 1}),
    "flags": (spaces.MultiBinary(2), np.array([0, 1], np.int8), {"obs 0": 0, "obs 1": 1}),
    "a number": (spaces.Box(0.0, 9.0, ()), np.float32(7), {"obs": 7}),
    "rows": (spaces.Box(0, 9, (1, 2)), np.array([[3, 4]], np.float32), {"obs 0,0": 3, "obs 0,1": 4}),
    "a number without an upper bound": (
        spaces.Box(np.float32([-1, 0]), np.float32([1, np.inf])),
        np.array([1, 1e9], np.float32),
        {"obs 0": 1, "obs 1": 1e9},
    ),
    "parts in parts": (
        spaces.Dict({"a": spaces.Tuple([spaces.Discrete(2), spaces.Dict({"b": PLACE})])}),
        {"a": (1, {"b": np.array([1, 2], np.float32)})},
        {"a 0=0": 0, "a 0=1": 1, "a 1 b 0": 1, "a 1 b 1": 2},
    ),
    "choices": (
        spaces.MultiDiscrete([2, 2], start=[0, 5]),
        np.array([1, 5]),
        {"obs 0=0": 0, "obs 0=1": 1, "obs 1=5": 1, "obs 1=6": 0},
    ),
    "parts by name": (
        spaces.Dict({"place": PLACE, "car": spaces.Dict({"gear": spaces.Discrete(2)})}),
        {"place": np.array([1, -2], np.float32), "car": {"gear": 1}},
        {"car gear=0": 0, "car gear=1": 1, "place 0": 1, "place 1": -2},
    ),
    "parts": (
        spaces.Tuple([spaces.Discrete(2), PLACE]),
        (0, np.array([2, 0], np.float32)),
        {"obs 0=0": 1, "obs 0=1": 0, "obs 1 0": 2, "obs 1 1": 0},
    ),
}


def seen(space: spaces.Space, value: Any) -> Callable[..., gym.Env]:
    return lambda **given: TransformObservation(Odd(), lambda obs: value, space)


@pytest.mark.parametrize("what", OBSERVED)
def test_observations_are_vectors_whose_entries_have_names(task: Callable[..., str], what: str) -> None:
    space, value, expected = OBSERVED[what]
    spec = from_gymnasium(task(seen(space, value)), "odd")
    assert [str(one) for one in spec.observations] == [*expected]
    assert spec.make().reset(seed=0)[0].tolist() == [*expected.values()]
    assert {x for x, name in zip(spec.obs_scale, expected, strict=True) if "=" in name} <= {1.0}
    try_out(spec)


UNSEEN = {
    "images of numbers": (spaces.Box(0, 1, (8, 8, 3)), "not images"),
    "images of six channels": (spaces.Box(0, 255, (8, 8, 6), np.uint8), "not images"),
    "texts": (spaces.Dict({"said": spaces.Text(5)}), "not Text"),
    "sequences": (spaces.Sequence(PLACE), "not Sequence"),
    "nothing": (spaces.Box(0, 1, (0,)), "have no entry"),
    "a million values": (spaces.Discrete(10**6), "more than 10,000 entries"),
}


@pytest.mark.parametrize("what", UNSEEN)
def test_observations_that_are_no_vector_are_refused_with_the_way_out(
    task: Callable[..., str], what: str
) -> None:
    space, why = UNSEEN[what]
    env_id = task(seen(space, None))
    with pytest.raises(ValueError, match=rf"^{env_id}: observations .*{why}.* wrap= of from_gymnasium$"):
        from_gymnasium(env_id, "odd")
    wrap = lambda env: TransformObservation(env, lambda obs: np.ones(2, np.float32), PLACE)  # noqa: E731
    wrapped = from_gymnasium(env_id, "odd", wrap=wrap)
    assert (wrapped.obs_size, wrapped.make().observation_space) == (2, PLACE)


CHOSEN: dict[str, tuple[spaces.Space, list[str], Any]] = {
    "parts": (
        spaces.MultiDiscrete([2, 3], start=[0, 5]),
        ["act 0,5", "act 0,6", "act 0,7", "act 1,5", "act 1,6", "act 1,7"],
        [1, 7],
    ),
    "flags": (spaces.MultiBinary(2), ["act 0,0", "act 0,1", "act 1,0", "act 1,1"], [1, 1]),
    "whole numbers": (spaces.Box(-1, 1, (1,), np.int32), ["act -1", "act 0", "act 1"], [1]),
    "bytes": (spaces.Box(0, 2, (), np.uint8), ["act 0", "act 1", "act 2"], 2),
    "a table": (spaces.MultiDiscrete([[1, 2]]), ["act 0,0", "act 0,1"], [[0, 1]]),
}


@pytest.mark.parametrize("what", CHOSEN)
def test_whole_actions_are_choices_among_all_combinations(task: Callable[..., str], what: str) -> None:
    space, names, last = CHOSEN[what]
    spec = from_gymnasium(task(act=space), "odd")
    assert (spec.discrete, [str(one) for one in spec.actions]) == (True, names)
    try_out(spec)
    env = spec.make()
    env.reset(seed=0)
    env.step(spec.native(np.eye(len(names))[-1]))
    (told,) = inner(env).told
    assert (told.tolist(), told.dtype) == (last, space.dtype)


@pytest.mark.parametrize("shape", [(), (1,), (1, 1), (2, 2)])
def test_real_actions_may_have_any_shape(task: Callable[..., str], shape: tuple[int, ...]) -> None:
    spec = from_gymnasium(task(act=spaces.Box(-2.0, 6.0, shape, np.float64)), "odd")
    try_out(spec)
    env = spec.make()
    env.reset(seed=0)
    env.step(spec.native(np.full(spec.act_size, 0.5)))
    assert np.array_equal(inner(env).told, [np.full(shape, 4.0)])


def test_a_wrapper_comes_before_anything_is_looked_at(task: Callable[..., str]) -> None:
    """The task itself has no time limit, unbounded actions and images."""
    unbounded = spaces.Box(-np.inf, np.inf, (1,), np.float32)
    image = spaces.Box(0, 255, (8, 8, 3), np.uint8)

    def wrap(env: gym.Env) -> gym.Env:
        narrow = gym.wrappers.TransformAction(env, lambda act: act, spaces.Box(-1, 1, (1,)))
        return TimeLimit(TransformObservation(narrow, lambda obs: np.ones(2, np.float32), PLACE), 7)

    made = lambda **given: TransformObservation(Odd(act=unbounded), lambda obs: None, image)  # noqa: E731
    spec = from_gymnasium(task(made, limit=None), "odd", wrap=wrap)
    assert (spec.obs_size, spec.act_size, spec.horizon) == (2, 1, 7)
    try_out(spec)


def test_a_wrapper_may_change_the_bounds_of_actions(task: Callable[..., str]) -> None:
    wrap = lambda env: RescaleAction(env, np.float32(0), np.float32(3))  # noqa: E731
    spec = from_gymnasium(task(act=BOX), "odd", wrap=wrap)
    env = spec.make()
    env.reset(seed=0)
    env.step(spec.native(np.array([-1.0, 0.5])))
    np.testing.assert_allclose(inner(env).told, [[-1, 0.5]], atol=1e-6)


def test_a_time_limit_may_be_an_argument(task: Callable[..., str]) -> None:
    env_id = task(limit=None)
    with pytest.raises(
        ValueError, match="no time limit; give one: --env-kwargs max_episode_steps=200, or kw"
    ):
        from_gymnasium(env_id, "odd")
    assert from_gymnasium(env_id, "odd", kwargs={"max_episode_steps": LIMIT}).horizon == LIMIT


def test_a_reward_of_one_entry_is_taken_by_run_and_check_alike(task: Callable[..., str]) -> None:
    spec = from_gymnasium(task(pay=lambda env: np.array([0.5])), "odd")
    try_out(spec)
    assert {check.outcome() for check in checks(spec)} == {("ok", "")}
