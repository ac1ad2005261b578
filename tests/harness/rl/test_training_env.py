"""What an agent sees: absorption or an end, rewards that can be told anew, and demonstrations."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from envs import EnvSpec
from envs.learners import DDPG, DQN
from harness.registry import LIBRARIES, PROTOCOLS, SPECS, Library
from harness.rl.solving import Agent
from harness.rl.training_env import REWARD_SIZE, Replay, TrainingEnv
from methods.base import ABSORBING_STEPS, Array, Episodes, Transitions
from tests.harness.rewards import Seek

pytestmark = pytest.mark.usefixtures("fused_adam")
COPIES = 4
FEW_GRADIENTS = DDPG(net=(16,), gradient_steps=1)
STATE, OFFSET = ("absorbing", "state"), ("absorbing", "offset")
"""Protocols with an absorbing state, and those with the offset."""
every_protocol = pytest.mark.parametrize("protocol", PROTOCOLS)


def rng(seed: int = 0) -> np.random.Generator:
    return np.random.default_rng(seed)


def agent_of(spec: EnvSpec, protocol: str, **given: Any) -> Agent:
    return Agent(replace(spec, rl=FEW_GRADIENTS), protocol, rng(), "sb3", **given)


def some_miss(seen: np.ndarray) -> np.ndarray:
    """Right for even copies; for odd ones a miss of at least 1, which ends a fragile episode."""
    action = seen[:, :1] * 0.5  # obs_scale
    action[1::2] = np.where(seen[1::2, :1] > 0, -1.0, 1.0)
    return action


def test_what_would_terminate_is_absorbed_and_then_truncated(fragile: EnvSpec) -> None:
    env: Any = TrainingEnv(fragile, "absorbing", rng(), COPIES)
    env.reward = Seek(absorbing=0.25)
    seen = env.reset()
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
        seen, paid, done, infos = env.step(seen[:, :1] * 0.5)
        assert (paid[1::2] == 0.0).all()
        assert paid[::2] == pytest.approx(0.75)
    assert done.tolist() == [False, True] * (COPIES // 2)
    for info in infos[1::2]:
        assert info["TimeLimit.truncated"]
        assert info["terminal_observation"].tolist() == [0.0, 1.0]
    assert (seen[:, 1] == 0).all()


def experience(learner: Agent) -> dict[str, Array]:
    """What the agent learned from, in order: arrays (steps, ...), of all copies after each other."""
    buffer: Any = learner._model.replay_buffer  # type: ignore[union-attr]
    names = ("observations", "actions", "next_observations", "rewards", "dones", "timeouts")
    arrays = {name: getattr(buffer, name)[: buffer.pos].astype(float) for name in names}
    return {name: array.reshape(-1, *array.shape[2:]) for name, array in arrays.items()}


@every_protocol
def test_which_transitions_are_terminal(fragile: EnvSpec, protocol: str) -> None:
    learner = agent_of(fragile, protocol)
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


@every_protocol
def test_a_second_solve_goes_on_with_experience_relabelled(fragile: EnvSpec, protocol: str) -> None:
    learner = agent_of(fragile, protocol)
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


@every_protocol
def test_a_payment_sees_the_steps_into_absorption_and_in_it(fragile: EnvSpec, protocol: str) -> None:
    def payment(steps: Transitions) -> Array:
        return np.where(steps.absorbing, -1.0, np.where(steps.next_absorbing, 5.0, 1.0))

    agent = agent_of(fragile, protocol)
    agent.learn(300, payment)
    seen = agent.replay()
    missed = ~seen.absorbing & (np.abs(seen.obs[:, 0] - seen.act[:, 0]) > 0.5)
    np.testing.assert_array_equal(seen.next_absorbing, missed | seen.absorbing)
    assert seen.absorbing.any() == (protocol in STATE)
    raw = payment(seen)
    paid = agent._replay.rewards[: agent._replay.size()].ravel().astype(float)
    assert len(np.unique(paid.round(5))) == len(np.unique(raw))
    assert np.corrcoef(raw, paid)[0, 1] > 0.999


def on_target(count: int = 20, far: float = 0.0) -> Episodes:
    """Of ten steps that go where the observation says; far: added to observations alone."""
    obs = [rng(i).uniform(-0.8, 0.8, (11, 1)) for i in range(count)]
    return Episodes(tuple(o + far for o in obs), tuple(o[:-1] for o in obs), (False,) * count)


def imitate(steps: Transitions) -> Array:
    """Pays 1 for demonstrated steps and 0 for others (Reddy et al. 2020, soft Q imitation learning)."""
    return steps.demonstrated.astype(float)


@pytest.mark.parametrize("library", LIBRARIES)
@pytest.mark.parametrize(("batch", "shown"), [(8, {4}), (7, {3, 4})])
def test_half_of_each_batch_is_demonstrated(
    steady: EnvSpec, monkeypatch: pytest.MonkeyPatch, library: Library, batch: int, shown: set[int]
) -> None:
    sampled: list[Any] = []
    sample = Replay.sample

    def spy(self: Replay, batch_size: int, env: Any = None) -> Any:
        sampled.append(sample(self, batch_size, env))
        return sampled[-1]

    monkeypatch.setattr(Replay, "sample", spy)
    spec = replace(steady, rl=DDPG(net=(8,), batch=batch))
    agent = Agent(spec, "absorbing", rng(), library, demonstrations=on_target(far=5.0))
    agent.learn(100, Seek())
    assert agent.env_steps == 100
    far, led = (
        np.concatenate([getattr(given, name)[:, 0] for given in sampled]) > 4 / 0.5
        for name in ("observations", "next_observations")
    )
    assert len(far) == 50 * batch  # a gradient step for each step after the warm-up
    assert set(far.reshape(-1, batch).sum(axis=1).tolist()) <= shown
    np.testing.assert_array_equal(led, far)
    # What was taken is what it says it has seen.
    assert np.abs(agent.replay().obs).max() <= 0.8
    assert not agent.replay().demonstrated.any()


@every_protocol
def test_a_payment_tells_demonstrated_steps_from_own(fragile: EnvSpec, protocol: str) -> None:
    agent = Agent(fragile, protocol, rng(), "sb3", demonstrations=on_target(200))
    for payment, sign in ((imitate, 1), (lambda steps: -3 * imitate(steps), -1)):
        agent.learn(100, payment)
        shown: Any = agent._replay._demonstrated
        own = agent._replay.rewards[: agent._replay.size()]
        # Both count the same, however many they are: half of the mean size is twice that of one.
        centre = sign * REWARD_SIZE if protocol in STATE else 0.0
        np.testing.assert_allclose(shown.rewards, sign * 2 * REWARD_SIZE - centre, rtol=1e-6)
        np.testing.assert_allclose(own, -centre, rtol=1e-6)


def test_paid_for_demonstrated_steps_alone_it_learns_to_do_them(steady: EnvSpec) -> None:
    obs = np.linspace(-0.8, 0.8, 33)[:, None]
    agent = Agent(steady, "absorbing", rng(), "sbx", DDPG(), demonstrations=on_target(100))
    agent.learn(2000, imitate)
    assert np.abs(agent.policy(obs) - obs).mean() < 0.1


def test_choices_are_demonstrated_as_the_library_takes_them() -> None:
    spec = replace(SPECS["cartpole_discrete"], rl=DQN())
    obs = rng().normal(0, 0.01, (31, spec.obs_size))
    demos = Episodes((obs,), (np.tile(np.eye(2)[1], (30, 1)),), (True,))
    agent = Agent(spec, "absorbing", rng(), "sb3", demonstrations=demos)
    agent.learn(600, imitate)
    shown: Any = agent._replay._demonstrated
    assert shown.actions[:30].ravel().tolist() == [1] * 30
    assert set(shown.actions[30:].ravel().tolist()) <= {0, 1}
    assert (agent.policy(obs).argmax(axis=1) == 1).all()
