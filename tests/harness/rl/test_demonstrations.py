"""Half of what an agent learns from is demonstrated, where it is given demonstrations."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest

from envs import EnvSpec
from envs.learners import DDPG, DQN
from harness.registry import LIBRARIES, PROTOCOLS, SPECS, Library
from harness.rl.solving import Agent
from harness.rl.training_env import REWARD_SIZE, Demonstrated, Replay
from methods.base import Array, Episodes, Transitions
from methods.network import Network
from tests.harness.rewards import Seek

pytestmark = pytest.mark.usefixtures("fused_adam")
OBS = np.linspace(-0.8, 0.8, 33)[:, None]


def rng(seed: int = 0) -> np.random.Generator:
    return np.random.default_rng(seed)


def on_target(count: int = 20, far: float = 0.0) -> Episodes:
    """Of ten steps that go where the observation says; far: added to observations alone."""
    obs = [rng(i).uniform(-0.8, 0.8, (11, 1)) for i in range(count)]
    return Episodes(tuple(o + far for o in obs), tuple(o[:-1] for o in obs), (False,) * count)


def imitate(steps: Transitions) -> Array:
    """Pays 1 for demonstrated steps and 0 for others (Reddy et al. 2020, soft Q imitation learning)."""
    return steps.demonstrated.astype(float)


@pytest.fixture
def sampled(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """What the library was given to learn from."""
    given: list[Any] = []
    sample = Replay.sample

    def spy(self: Replay, batch_size: int, env: Any = None) -> Any:
        given.append(sample(self, batch_size, env))
        return given[-1]

    monkeypatch.setattr(Replay, "sample", spy)
    return given


@pytest.mark.parametrize("library", LIBRARIES)
@pytest.mark.parametrize(("batch", "shown"), [(8, {4}), (7, {3, 4})])
def test_half_of_each_batch_is_demonstrated(
    steady: EnvSpec, sampled: list[Any], library: Library, batch: int, shown: set[int]
) -> None:
    spec = dataclasses.replace(steady, rl=DDPG(net=(8,), batch=batch))
    agent = Agent(spec, "absorbing", rng(), library, demonstrations=on_target(far=5.0))
    agent.learn(100, Seek())
    assert agent.env_steps == 100
    far = np.concatenate([given.observations[:, 0] > 4 / 0.5 for given in sampled])
    assert len(far) == 50 * batch  # a gradient step for each step after the warm-up
    assert set(far.reshape(-1, batch).sum(axis=1).tolist()) <= shown
    for given in sampled:
        is_far = given.observations[:, 0] > 4 / 0.5
        np.testing.assert_array_equal(given.next_observations[:, 0] > 4 / 0.5, is_far)
    # What was taken is what it says it has seen.
    assert np.abs(agent.replay().obs).max() <= 0.8
    assert not agent.replay().demonstrated.any()


def own_episodes(agent: Agent) -> tuple[Episodes, int]:
    """All that an agent of one copy did and finished, as demonstrations; how many steps it saw by then."""
    seen, buffer = agent.replay(), agent._replay
    ends = np.flatnonzero(buffer.dones[: len(seen), 0]) + 1
    obs, act, terminated = [], [], []
    for start, end in zip([0, *ends[:-1]], ends, strict=True):
        alive = np.arange(start, end)[~seen.absorbing[start:end]]
        obs.append(np.concatenate([seen.obs[alive], seen.next_obs[alive[-1:]]]))
        act.append(seen.act[alive])
        terminated.append(bool(seen.next_absorbing[alive[-1]]))
    return Episodes(tuple(obs), tuple(act), tuple(terminated)), int(ends[-1])


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_demonstrated_steps_are_what_they_were_to_who_took_them(fragile: EnvSpec, protocol: str) -> None:
    reward = Seek(absorbing=-0.5)
    spec = dataclasses.replace(fragile, rl=DDPG(net=(), copies=1, gradient_steps=1))
    # Random steps miss, and tanh(obs) hits.
    hits = Network(np.zeros(1), np.ones(1), (np.ones((1, 1)),), (np.zeros(1),), tanh=True)
    agent = Agent(spec, protocol, rng(), "sb3", init=hits)
    agent.learn(300, reward)
    own = agent._replay
    episodes, count = own_episodes(agent)
    assert {*episodes.terminated} == {True, False}
    shown = Demonstrated(episodes, agent._env, 3, 0.9)
    assert len(shown.steps) == count
    taken = agent.replay()
    for name, column in vars(taken).items():
        expected = np.full(count, True) if name == "demonstrated" else column[:count]
        if name == "act":  # in the absorbing state, any
            absorbed = taken.absorbing[:count]
            assert np.abs(shown.steps.act[absorbed]).max(initial=0) <= 1
            shown.steps.act[absorbed] = expected[absorbed]
        np.testing.assert_array_equal(getattr(shown.steps, name), expected, err_msg=name)
    for name in ("observations", "next_observations", "dones", "timeouts"):
        np.testing.assert_array_equal(getattr(shown, name), getattr(own, name)[:count], err_msg=name)
    first = Transitions(*(column[:count] for column in vars(taken).values()))
    (paid,), (expected,) = (agent._env.normalise((steps, np.zeros(count))) for steps in (shown.steps, first))
    np.testing.assert_array_equal(paid, expected)


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_a_payment_tells_demonstrated_steps_from_own(fragile: EnvSpec, protocol: str) -> None:
    agent = Agent(fragile, protocol, rng(), "sb3", demonstrations=on_target(200))
    for payment, sign in ((imitate, 1), (lambda steps: -3 * imitate(steps), -1)):
        agent.learn(100, payment)
        shown: Any = agent._replay._demonstrated
        own = agent._replay.rewards[: agent._replay.size()]
        # Both count the same, however many they are: half of the mean size is twice that of one.
        centre = sign * REWARD_SIZE if protocol in ("absorbing", "state") else 0.0
        np.testing.assert_allclose(shown.rewards, sign * 2 * REWARD_SIZE - centre, rtol=1e-6)
        np.testing.assert_allclose(own, -centre, rtol=1e-6)


def test_paid_for_demonstrated_steps_alone_it_learns_to_do_them(steady: EnvSpec) -> None:
    agent = Agent(steady, "absorbing", rng(), "sbx", DDPG(), demonstrations=on_target(100))
    agent.learn(2000, imitate)
    assert np.abs(agent.policy(OBS) - OBS).mean() < 0.1


def test_choices_are_demonstrated_as_the_library_takes_them() -> None:
    spec = dataclasses.replace(SPECS["cartpole_discrete"], rl=DQN())
    obs = rng().normal(0, 0.01, (31, spec.obs_size))
    right = np.tile(np.eye(2)[1], (30, 1))
    demos = Episodes((obs,), (right,), (True,))
    agent = Agent(spec, "absorbing", rng(), "sb3", demonstrations=demos)
    agent.learn(600, imitate)
    shown: Any = agent._replay._demonstrated
    assert shown.actions[:30].ravel().tolist() == [1] * 30
    assert set(shown.actions[30:].ravel().tolist()) <= {0, 1}
    assert (agent.policy(obs).argmax(axis=1) == 1).all()


def test_what_demonstrations_were_truly_paid_is_not_known(steady: EnvSpec) -> None:
    agent = Agent(steady, "absorbing", rng(), "sb3", demonstrations=on_target())
    with pytest.raises(ValueError, match="is not known"):
        agent.learn(40, None)
    assert agent.env_steps == 0


def test_once_it_is_full_the_replay_is_still_in_order(steady: EnvSpec) -> None:
    spec = dataclasses.replace(steady, rl=DDPG(net=(), copies=2, buffer=60))
    agent, seen = Agent(spec, "absorbing", rng(), "sb3"), []
    for _ in range(5):
        agent.learn(20, Seek())
        seen.append(agent.replay().last(20).act)
    np.testing.assert_array_equal(agent.replay().act, np.concatenate(seen[2:]))
    assert len(agent.replay().last(1000)) == 60
    # Rewards are those of their own steps.
    rewards = agent._env.normalise((agent.replay(), np.zeros(60)))[0]
    agent._replay.relabel()
    order = np.roll(np.arange(30), -agent._replay.pos)
    np.testing.assert_allclose(agent._replay.rewards[order].ravel(), rewards, rtol=1e-5)
