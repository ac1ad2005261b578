"""Episodes in lockstep are the episodes that one would get one by one."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest

from envs import EnvSpec, Shape
from harness.registry import all_specs
from harness.rl.simulator import Simulator, Trajectory, drawings
from methods.base import Array

SEEDS = [11, 3, 8, 5, 2, 21, 13, 3]


def contrary(obs: Array) -> Array:
    """Misses by 1.2 |observation|, so that fragile episodes end at different times."""
    return -0.2 * obs


def one_by_one(spec: EnvSpec, seeds: list[int]) -> list[Trajectory]:
    episodes = []
    for seed in seeds:
        env = spec.make()
        obs, _ = env.reset(seed=seed)
        seen, acts, rewards = [obs.astype(float)], [], []
        terminated = truncated = False
        while not (terminated or truncated):
            act = contrary(seen[-1])
            obs, reward, terminated, truncated, _ = env.step(act.astype(np.float32))
            seen.append(obs.astype(float))
            acts.append(act)
            rewards.append(float(reward))
        ending = "missed" if terminated else "time limit"
        episodes.append(Trajectory(np.stack(seen), np.stack(acts), np.array(rewards), terminated, ending))
    return episodes


def assert_equal(results: list[Trajectory], expected: list[Trajectory]) -> None:
    assert len(results) == len(expected)
    for one, other in zip(results, expected, strict=True):
        np.testing.assert_array_equal(one.obs, other.obs)
        np.testing.assert_array_equal(one.act, other.act)
        np.testing.assert_array_equal(one.rewards, other.rewards)
        assert (one.terminated, one.ending) == (other.terminated, other.ending)


@pytest.mark.parametrize("lanes", [1, 3, 25])
def test_lockstep_equals_one_by_one_in_the_order_of_the_seeds(fragile: EnvSpec, lanes: int) -> None:
    expected = one_by_one(fragile, SEEDS)
    assert len({len(e.act) for e in expected}) > 2
    simulator = Simulator(fragile, lanes)
    assert_equal(simulator.run(contrary, SEEDS), expected)
    # And again, with environments that have been used, and other seeds beside.
    assert_equal(simulator.run(contrary, SEEDS[::-1]), expected[::-1])


@pytest.mark.parametrize("spec", all_specs(), ids=lambda spec: spec.name)
def test_what_is_recorded_is_what_was_done(spec: EnvSpec) -> None:
    rng, asked = np.random.default_rng(0), []

    def policy(obs: Array) -> Array:
        asked.append(rng.uniform(-1, 1, (len(obs), spec.act_size)))
        return asked[-1]

    (episode,) = Simulator(spec).run(policy, [3])
    assert episode.act.shape == (len(episode.rewards), spec.act_size)
    if spec.discrete:
        assert set(episode.act.ravel()) == {0.0, 1.0}
        assert (episode.act.sum(axis=1) == 1).all()
        assert episode.act.argmax(axis=1).tolist() == [int(a.argmax()) for a in asked]
    else:
        np.testing.assert_array_equal(episode.act, np.concatenate(asked))
    env = spec.make()
    seen = [env.reset(seed=3)[0], *(env.step(spec.native(act))[0] for act in episode.act)]
    np.testing.assert_array_equal(episode.obs, np.stack(seen))


@pytest.mark.parametrize("spec", [s for s in all_specs() if s.batch], ids=lambda spec: spec.name)
def test_copies_that_step_together_are_bit_for_bit_those_that_step_alone(spec: EnvSpec) -> None:
    weights = np.random.default_rng(0).normal(size=(spec.obs_size, spec.act_size))

    def policy(obs: Array) -> Array:
        return np.tanh((obs[:, :, None] * weights).sum(axis=1)) * 0.3 ** np.arange(1, spec.act_size + 1)

    alone = dataclasses.replace(spec, batch=None)
    seeds = [*range(5000, 5006), 5003]
    episodes = Simulator(spec, lanes=5).run(policy, seeds)
    assert_equal(episodes, Simulator(alone, lanes=5).run(policy, seeds))
    assert len({len(e.act) for e in episodes}) > 1 or not any(e.terminated for e in episodes)


def test_an_episodes_drawings_are_the_scenes_it_went_through(fragile: EnvSpec) -> None:
    def draw(env: Any) -> dict[str, Shape]:
        return {"target": Shape(np.array([[env.unwrapped.where, 0.0]]), (0, 0, 0))}

    (episode,) = Simulator(fragile).run(contrary, [3])
    frames = drawings(dataclasses.replace(fragile, draw=draw), 3, episode.act)
    assert [frame["target"].points[0, 0] for frame in frames] == episode.obs[:, 0].tolist()


@pytest.mark.parametrize("lanes", [1, 7, 16, 100])
def test_policies_side_by_side_see_what_they_would_see_alone(fragile: EnvSpec, lanes: int) -> None:
    policies = [contrary, lambda obs: 0.1 * obs, lambda obs: -0.4 * obs, contrary]
    simulator = Simulator(fragile, lanes)
    expected = [simulator.run(policy, SEEDS) for policy in policies]
    results = list(simulator.run_each(policies, SEEDS))
    for one, other in zip(results, expected, strict=True):
        assert_equal(one, other)
    assert len({len(episode.act) for episodes in results for episode in episodes}) > 3


def test_the_policy_is_asked_once_a_step_for_all_lanes(steady: EnvSpec) -> None:
    batches: list[int] = []

    def policy(obs: Array) -> Array:
        batches.append(len(obs))
        return 0 * obs

    Simulator(steady, lanes=5).run(policy, range(8))
    assert batches == [5] * 10 + [3] * 10
