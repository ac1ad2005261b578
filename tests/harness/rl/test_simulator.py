"""Episodes for one purpose are never those of another, and in lockstep they are what they are one by one."""

from __future__ import annotations

import dataclasses
from itertools import combinations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from envs import EnvSpec
from harness.registry import all_specs
from harness.rl import seeds as scopes
from harness.rl.simulator import Simulator, Trajectory
from methods.base import Array

SEEDS = [11, 3, 8, 5, 2, 21, 13, 3]
RUNS = st.integers(0, 999)
EPISODES = st.integers(1, 1000)


@given(RUNS, EPISODES, RUNS, EPISODES, st.integers(0, 2**31))
def test_evaluation_demonstration_judging_and_training_never_meet(
    run: int, episodes: int, other_run: int, other_episodes: int, seed: int
) -> None:
    training = scopes.training_seeds(np.random.default_rng(seed), 100)
    of_runs = (scopes.evaluation_seeds, scopes.demonstration_seeds, scopes.judging_seeds)
    for purpose in of_runs:
        assert len(purpose(run, episodes)) == episodes
        both = {*purpose(run, episodes)} & {*purpose(other_run, other_episodes)}
        assert bool(both) is (run == other_run)
    apart = [scopes.evaluation_seeds(run, episodes), training]
    apart += [purpose(other_run, other_episodes) for purpose in of_runs[1:]]
    apart += [scopes.tuning_seeds(episodes), scopes.held_out_seeds(episodes)]
    for one, other in combinations(map(set, apart), 2):
        assert not one & other
    assert 0 <= min(apart[0]) <= max(training) < 2**31


def test_a_generator_is_the_same_for_ever_and_of_its_seed_and_names_in_order() -> None:
    def draw(*scope: object) -> tuple[int, ...]:
        return tuple(scopes.rng_for(*scope).bit_generator.random_raw(3).tolist())  # type: ignore[arg-type]

    drawn = (1402831085389609345, 17900941403114240991, 6272127928090603391)
    assert draw(3, "cartpole", "demos") == drawn
    names = [(0,), (1,), (0, "a"), (0, "b"), (0, "a", "b"), (0, "b", "a"), (0, "ab"), (1, "a", "b")]
    assert len({draw(*scope) for scope in names}) == len(names)


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
    for one, other in zip(results, expected, strict=True):
        for name in ("obs", "act", "rewards"):
            np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
        assert (one.terminated, one.ending) == (other.terminated, other.ending)


@pytest.mark.parametrize("lanes", [1, 3, 25])
def test_lockstep_equals_one_by_one_for_one_policy_and_for_several_side_by_side(
    fragile: EnvSpec, lanes: int
) -> None:
    expected = one_by_one(fragile, SEEDS)
    assert len({len(e.act) for e in expected}) > 2
    simulator = Simulator(fragile, lanes)
    assert_equal(simulator.run(contrary, SEEDS), expected)
    # And again, with environments that have been used, and other seeds beside.
    assert_equal(simulator.run(contrary, SEEDS[::-1]), expected[::-1])
    policies = [contrary, lambda obs: 0.1 * obs, lambda obs: -0.4 * obs, contrary]
    for policy, results in zip(policies, simulator.run_each(policies, SEEDS), strict=True):
        assert_equal(results, simulator.run(policy, SEEDS))


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
