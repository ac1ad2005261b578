"""What an agent sees: copies side by side, absorption or an end, and rewards that can be told anew."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from envs import EnvSpec
from envs.learners import DDPG
from harness.registry import PROTOCOLS
from harness.rl.solving import Agent
from harness.rl.training_env import REWARD_SIZE, TrainingEnv
from methods.base import ABSORBING_STEPS, Array, Transitions
from tests.harness.rewards import Seek

COPIES = 4
FEW_GRADIENTS = DDPG(net=(16,), gradient_steps=1)
STATE, OFFSET = ("absorbing", "state"), ("absorbing", "offset")
"""Protocols with an absorbing state, and those with the offset."""


def training_env(spec: EnvSpec, protocol: str) -> Any:
    return TrainingEnv(spec, protocol, np.random.default_rng(0), COPIES)


def test_staggered_copies_are_at_all_times_of_an_episode(steady: EnvSpec) -> None:
    ended = []
    for staggered in (False, True):
        env: Any = TrainingEnv(steady, "absorbing", np.random.default_rng(0), COPIES, staggered)
        env.reward = Seek()
        env.reset()
        dones = np.stack([env.step(np.zeros((COPIES, 1)))[2] for _ in range(2 * steady.horizon)])
        ended.append([(1 + np.flatnonzero(done)).tolist() for done in dones.T])
    assert ended == [[[10, 20]] * COPIES, [[10, 20], [8, 18], [5, 15], [3, 13]]]


def some_miss(seen: np.ndarray) -> np.ndarray:
    """Right for even copies; for odd ones a miss of at least 1, which ends a fragile episode."""
    action = seen[:, :1] * 0.5  # obs_scale
    action[1::2] = np.where(seen[1::2, :1] > 0, -1.0, 1.0)
    return action


def test_what_would_terminate_is_absorbed_and_then_truncated(fragile: EnvSpec) -> None:
    env = training_env(fragile, "absorbing")
    env.reward = Seek(absorbing=0.25)
    seen = env.reset()
    assert seen.shape == (COPIES, 2)
    assert len(np.unique(seen[:, 0])) == COPIES
    assert (seen[:, 1] == 0).all()
    first = some_miss(seen)
    where = seen[:, 0] * 0.5
    seen, paid, done, _ = env.step(first)
    np.testing.assert_allclose(paid, 1 - np.abs(where - first[:, 0]) - 0.25, rtol=1e-5)
    for _ in range(ABSORBING_STEPS):
        assert (seen[1::2] == [0.0, 1.0]).all()
        assert (seen[::2, 1] == 0).all()
        assert not done.any()
        action = seen[:, :1] * 0.5
        seen, paid, done, infos = env.step(action)
        assert (paid[1::2] == 0.0).all()
        assert paid[::2] == pytest.approx(0.75)
    assert done.tolist() == [False, True] * (COPIES // 2)
    for info in infos[1::2]:
        assert info["TimeLimit.truncated"]
        assert info["terminal_observation"].tolist() == [0.0, 1.0]
    assert (seen[:, 1] == 0).all()


@pytest.mark.parametrize("protocol", ["absorbing", "native"])
def test_an_episode_at_the_horizon_is_truncated(steady: EnvSpec, protocol: str) -> None:
    env = training_env(steady, protocol)
    env.reset()
    for _ in range(2):
        steps = [env.step(np.zeros((COPIES, 1), np.float32)) for _ in range(10)]
        assert [done.tolist() for _, _, done, _ in steps] == [[False] * COPIES] * 9 + [[True] * COPIES]
        assert all(info["TimeLimit.truncated"] for info in steps[-1][3])


def experience(learner: Agent) -> dict[str, Array]:
    """What the agent learned from, in order: arrays (steps, ...), of all copies after each other."""
    buffer: Any = learner._model.replay_buffer  # type: ignore[union-attr]
    names = ("observations", "actions", "next_observations", "rewards", "dones", "timeouts")
    arrays = {name: getattr(buffer, name)[: buffer.pos].astype(float) for name in names}
    return {name: array.reshape(-1, *array.shape[2:]) for name, array in arrays.items()}


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_which_transitions_are_terminal(fragile: EnvSpec, protocol: str) -> None:
    spec = replace(fragile, rl=FEW_GRADIENTS)
    learner = Agent(spec, protocol, np.random.default_rng(0), "sb3")
    learner.solve(Seek(), 300)
    seen = experience(learner)
    assert len(seen["dones"]) == 300
    terminal = (seen["dones"] > 0) & (seen["timeouts"] == 0)
    absorbed = seen["observations"][:, 1] == 1
    missed = np.abs(seen["observations"][:, 0] * 0.5 - seen["actions"][:, 0]) > 0.5
    if protocol in STATE:
        assert not terminal.any()
        np.testing.assert_array_equal(seen["next_observations"][~absorbed, 1] == 1, missed[~absorbed])
    else:
        assert not absorbed.any()
        assert terminal.any()
        np.testing.assert_array_equal(terminal, missed)


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_a_second_solve_goes_on_with_experience_relabelled(fragile: EnvSpec, protocol: str) -> None:
    spec = replace(fragile, rl=FEW_GRADIENTS)
    learner = Agent(spec, protocol, np.random.default_rng(0), "sb3")
    second = Seek(side=-1.0, scale=3.0, absorbing=0.5)
    for reward, seen_before, steps in ((Seek(absorbing=-1.0), 150, 300), (second, 300, 200)):
        learner.solve(reward, steps)
        seen = experience(learner)
        alive = seen["observations"][:, 1] == 0
        obs = seen["observations"][:, :1] * 0.5
        raw = reward(obs, seen["actions"], obs)
        raw = np.where(alive, raw - (reward.absorbing if protocol in OFFSET else 0.0), 0.0)
        # Normalised by what had been seen when the solve began to learn.
        known = raw[:seen_before][alive[:seen_before]]
        centre = known.mean() if protocol in STATE else 0.0
        expected = (raw - centre) / np.abs(known).mean() * REWARD_SIZE
        np.testing.assert_allclose(seen["rewards"], expected, atol=1e-5)
    assert len(seen["rewards"]) == 500


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_a_payment_sees_the_steps_into_absorption_and_in_it(fragile: EnvSpec, protocol: str) -> None:
    def payment(steps: Transitions) -> Array:
        return np.where(steps.absorbing, -1.0, np.where(steps.next_absorbing, 5.0, 1.0))

    spec = replace(fragile, rl=FEW_GRADIENTS)
    agent = Agent(spec, protocol, np.random.default_rng(0), "sb3")
    agent.learn(300, payment)
    seen = agent.replay()
    missed = ~seen.absorbing & (np.abs(seen.obs[:, 0] - seen.act[:, 0]) > 0.5)
    np.testing.assert_array_equal(seen.next_absorbing, missed | seen.absorbing)
    assert seen.absorbing.any() == (protocol in STATE)
    raw = payment(seen)
    paid = agent._replay.rewards[: agent._replay.size()].ravel().astype(float)
    assert len(np.unique(paid.round(5))) == len(np.unique(raw))
    assert np.corrcoef(raw, paid)[0, 1] > 0.999


def test_a_payment_that_reuses_its_buffer_and_writes_into_steps_changes_nothing(steady: EnvSpec) -> None:
    env = training_env(steady, "absorbing")
    env.reset()
    buffer = np.empty(COPIES)

    def pay(steps: Transitions) -> Array:
        buffer[:] = steps.act[:, 0]
        steps.act[:], steps.obs[:], steps.next_obs[:] = 0, 0, 0
        return buffer

    env.reward = pay
    env.step(np.full((COPIES, 1), 0.5))
    first, true = env.latest
    assert (first.act == 0.5).all()
    assert first.next_obs.any()
    second = replace(first, act=-first.act)
    one, other = env.normalise((first, true), (second, true))
    assert np.array_equal(one, -other)
    assert (one > 0).all()
