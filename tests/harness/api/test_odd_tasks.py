"""Tasks of others that are odd: what they mean is what happens, or they are refused at once by name."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium import spaces
from gymnasium.envs.registration import WrapperSpec
from gymnasium.wrappers import TimeLimit

from envs import Shape, from_gymnasium
from envs.copies import try_out
from harness.api.exported import Exported, ExportedPolicy, LearnedReward
from harness.demonstrations.reading import read
from harness.registry import BadInput
from harness.registry.contract.tasks import checks
from harness.rl.simulator import Simulator, drawings
from harness.rl.training_env import TrainingEnv
from methods.base import Array
from tests.harness.odd_env import LIMIT, Odd, after, inner, lengths


@pytest.mark.parametrize("start", [-5, -1, 0, 1, 7])
def test_choices_begin_where_the_task_says(task: Callable[..., str], start: int) -> None:
    derived = from_gymnasium(task(act=spaces.Discrete(3, start=start)), "odd")
    written = dataclasses.replace(derived, summary="written", wrap=lambda env: env)
    for spec in (derived, written):
        env = spec.make()
        assert env.action_space == spaces.Discrete(3)
        env.reset(seed=0)
        for choice in np.eye(3):
            env.step(spec.native(choice))
        assert inner(env).told == [start, start + 1, start + 2]


def test_a_files_numbers_of_choices_are_the_tasks_own(task: Callable[..., str], tmp_path: Path) -> None:
    obs, ends = np.zeros((3, 2)), {"lengths": np.array([2]), "terminated": np.array([True])}
    for start, act, chosen in (
        (0, [1, 2], [1, 2]),
        (1, [1, 2], [0, 1]),
        (-1, [-1, 1], [0, 2]),
        (1, np.eye(3)[[1, 2]], [1, 2]),
        (1, [0, 1], None),
    ):
        spec = from_gymnasium(task(act=spaces.Discrete(3, start=start)), "odd")
        np.savez(tmp_path / "shown.npz", obs=obs, act=np.array(act), **ends)
        if chosen is None:
            with pytest.raises(BadInput, match="choices must be whole numbers from 1 to 3"):
                read(tmp_path / "shown.npz", spec)
        else:
            assert read(tmp_path / "shown.npz", spec).episodes.act[0].argmax(axis=1).tolist() == chosen


def limited(steps: int) -> gym.Env:
    return TimeLimit(Odd(), steps)


INSIDE = {
    "in its code": {"cut": after(8)},
    "in its code, as an array": {"cut": lambda env: np.array([env.steps >= 8])},
    "in its own wrappers": {"entry": lambda **given: limited(8)},
    "in its own wrappers alone": {"entry": lambda **given: limited(8), "limit": None},
    "in a registered wrapper": {
        "wrapped": (WrapperSpec("TimeLimit", "gymnasium.wrappers:TimeLimit", {"max_episode_steps": 8}),)
    },
}


@pytest.mark.parametrize("where", INSIDE)
def test_an_episode_ends_where_the_task_truncates_it(task: Callable[..., str], where: str) -> None:
    spec = from_gymnasium(task(**INSIDE[where]), "odd")
    try_out(spec)
    assert lengths(spec) == {(8, False, "time limit")}
    env: Any = TrainingEnv(spec, "native", np.random.default_rng(0), 2)
    env.reset()
    steps = [env.step(np.zeros((2, 2), np.float32)) for _ in range(16)]
    assert [bool(done.all()) for _, _, done, _ in steps] == [i in (7, 15) for i in range(16)]
    for info in steps[7][3]:
        assert info["TimeLimit.truncated"]
        assert info["terminal_observation"][0] * spec.obs_scale[0] == pytest.approx(8)
    if "array" not in where:  # which Gymnasium's own checks do not take
        assert [check.outcome() for check in checks(spec) if check.outcome()[0] == "FAILED"] == []


def test_each_instance_may_truncate_where_it_likes(task: Callable[..., str]) -> None:
    later = itertools.count(5)

    def made(**given: Any) -> gym.Env:
        return Odd(cut=after(next(later)))

    assert len(lengths(from_gymnasium(task(made), "odd"), 6)) == 3  # of as many lanes
    limits = itertools.cycle([8, 12])
    with pytest.raises(ValueError, match="its time limit is 8 in one instance and 12 in another"):
        from_gymnasium(task(lambda **given: limited(next(limits))), "odd")


BOUNDS = {
    "a dead one": ([-2.0, 3.0], [2.0, 3.0], np.float32),
    "all dead": ([1.5, 0.0], [1.5, 0.0], np.float32),
    "a large dead one": ([-2.0, 1e9], [2.0, 1e9], np.float32),
    "different ones": ([-2.0, 0.0], [1.0, 5.0], np.float32),
    "far from zero": ([1000.1, -0.3], [1000.7, 0.7], np.float32),
    "64 bits": ([-2.0, 0.1], [1.0, 0.7], np.float64),
    "16 bits": ([-2.0, 0.1], [1.0, 0.7], np.float16),
}


@pytest.mark.parametrize("which", BOUNDS)
def test_actions_lie_within_their_own_bounds(task: Callable[..., str], which: str) -> None:
    low, high, kind = BOUNDS[which]
    box = spaces.Box(np.array(low, kind), np.array(high, kind), dtype=kind)
    spec = from_gymnasium(task(act=box), "odd")
    try_out(spec)
    env = spec.make()
    env.reset(seed=0)
    for act in ([-1.0, 1.0], [0.0, 0.0], [1.0, -1.0], [0.37, -0.61]):
        env.step(spec.native(np.array(act)))
        wanted = box.low.astype(float) + (np.array(act) + 1) / 2 * (box.high.astype(float) - box.low)
        # Actions have 32 bits at most.
        tolerance = 4 * max(np.finfo(kind).eps, 1e-7) * max(1, np.abs([low, high]).max())
        np.testing.assert_allclose(inner(env).told[-1], wanted, atol=tolerance)
    assert inner(env).told[0].tolist() == [box.low[0], box.high[1]]


def test_what_is_observed_is_copied(task: Callable[..., str]) -> None:
    own, reused = (from_gymnasium(task(reuse=reuse), "odd") for reuse in (False, True))
    assert reused.obs_scale == own.obs_scale
    for spec in (own, reused):
        (episode,) = Simulator(spec).run(lambda obs: np.zeros((len(obs), 2)), [0])
        assert episode.obs[:, 0].tolist() == [*range(LIMIT + 1)]
        assert [check.outcome() for check in checks(spec) if check.outcome()[0] == "FAILED"] == []

    def draw(env: gym.Env) -> dict[str, Shape]:
        return {"its": Shape(inner(env).buffer[None], (0, 0, 0))}

    frames = drawings(dataclasses.replace(own, draw=draw), 0, np.zeros((3, 2)))
    assert [frame["its"].points[0, 0] for frame in frames] == [0, 1, 2, 3]


def test_a_learned_reward_sees_where_a_step_began(task: Callable[..., str]) -> None:
    class Steps:
        absorbing = 0.0

        def __call__(self, obs: Array, act: Array, next_obs: Array, /) -> Array:
            return next_obs[:, 0] - obs[:, 0]

    spec = from_gymnasium(task(reuse=True, pay=of_one), "odd")
    learned = Exported(ExportedPolicy(lambda obs: np.zeros((len(obs), 2)), spec), Steps(), spec, {})
    env = LearnedReward(spec.make(), learned)
    env.reset(seed=0)
    for _ in range(3):
        _, paid, _, _, info = env.step(np.zeros(2, np.float32))
        assert (paid, info["true_reward"]) == (1.0, 1.0)


def now_and_then(env: Odd) -> Any:
    return np.array([1.0]) if env.steps % 3 else 1


def of_one(env: Odd) -> np.ndarray:
    return np.array([[1.0]], np.float32)


@pytest.mark.parametrize("pay", [of_one, now_and_then, lambda env: np.int64(1), lambda env: True])
def test_a_reward_of_one_entry_is_a_number(task: Callable[..., str], pay: Callable[[Odd], Any]) -> None:
    spec = from_gymnasium(task(pay=pay), "odd")
    for episode in Simulator(spec).run(lambda obs: np.zeros((len(obs), 2)), range(3)):
        assert episode.rewards.tolist() == [1.0] * LIMIT
    assert [check.outcome() for check in checks(spec) if check.outcome()[0] == "FAILED"] == []
