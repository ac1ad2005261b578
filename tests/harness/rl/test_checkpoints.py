"""Which checkpoint of a solve counts; a reward that tells nothing apart leaves the untrained one."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
import pytest

from envs import EnvSpec
from envs.learners import DDPG
from harness.rl import solving
from harness.rl.solving import Agent
from methods.base import Policy
from methods.network import Network
from methods.rewards import Constant
from tests.harness.rewards import Seek
from tests.harness.rl.solving import same, solve

pytestmark = pytest.mark.usefixtures("fused_adam")


@pytest.fixture
def actors(monkeypatch: pytest.MonkeyPatch) -> list[Network]:
    """The actor at every checkpoint, the untrained one first."""
    seen: list[Network] = []
    policy = Agent.policy.fget
    assert policy is not None

    def spy(self: Agent) -> Network:
        seen.append(policy(self))
        return seen[-1]

    monkeypatch.setattr(Agent, "policy", property(spy))
    return seen


def test_a_reward_that_pays_nothing_teaches_nothing(fragile: EnvSpec, actors: list[Network]) -> None:
    solution = solve(fragile, Seek(scale=0.0), steps=400)
    assert [y for _, y in solution.curve] == [0.0, 0.0]
    assert solution.env_steps == 400
    assert len(actors) == 2
    assert same(solution.policy, actors[0])


@pytest.mark.parametrize("value", [1.0, -1.0, 0.3])
@pytest.mark.parametrize("protocol", ["absorbing", "offset"])
def test_a_constant_that_is_nothing_by_the_offset_is_not_trained_on(
    fragile: EnvSpec, value: float, protocol: str
) -> None:
    trained = solve(fragile, Seek(scale=0.0), protocol, steps=400)
    solution = solve(fragile, Constant(value, absorbing=value), protocol, steps=400)
    assert same(solution.policy, trained.policy)
    assert (solution.curve, solution.env_steps) == (trained.curve[:1], 200)


@pytest.mark.parametrize(
    ("reward", "protocol"), [(Constant(1.0, 1.0), "state"), (Constant(0.0, -1.0), "absorbing")]
)
def test_other_constants_are_trained_on(fragile: EnvSpec, reward: Constant, protocol: str) -> None:
    assert solve(fragile, reward, protocol, steps=400).env_steps == 400


@pytest.mark.parametrize(
    ("returns", "disturbed", "chosen"),
    [
        ([1, 5, 3, 5, 5], [2, 3, 1], 3),
        ([1, 5, 3, 5, 4], [2, 2], 3),
        ([1, 5, 5, 6, 2], [], 3),
        ([5, 5, 4, 5, 5], [], 0),
    ],
)
def test_ties_go_to_the_checkpoint_that_scores_best_with_noise_and_then_to_the_latest(
    steady: EnvSpec,
    actors: list[Network],
    monkeypatch: pytest.MonkeyPatch,
    returns: list[float],
    disturbed: list[float],
    chosen: int,
) -> None:
    spec = dataclasses.replace(steady, rl=DDPG(checkpoint_every=100, gradient_steps=1))
    scores = iter(returns + disturbed)

    def check(self: Agent, policies: Sequence[Policy]) -> list[tuple[float, float]]:
        self.check_steps += len(policies)
        return [((score := next(scores)), -score) for _ in policies]

    monkeypatch.setattr(Agent, "check", check)
    solution = solve(spec, Seek(), steps=800)
    assert [value for _, value in solution.curve] == returns
    assert [value for _, value in solution.true_curve] == [-value for value in returns]
    assert (solution.env_steps, solution.check_steps) == (800, len(returns + disturbed))
    assert all(map(same, solution.checkpoints, actors))
    assert same(solution.policy, actors[chosen])
    assert next(scores, None) is None


def test_a_disturbed_policy_errs_as_much_as_exploration_does(steady: EnvSpec) -> None:
    obs = np.zeros((10_000, 1))
    noise = solving.disturbed(lambda obs: obs, steady, DDPG().noise)(obs)
    assert noise.mean() == pytest.approx(0, abs=0.01)
    assert noise.std() == pytest.approx(DDPG().noise, rel=0.05)
    assert np.abs(noise).max() <= 1
    assert np.array_equal(noise, solving.disturbed(lambda obs: obs, steady, DDPG().noise)(obs))
