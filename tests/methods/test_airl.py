"""AIRL pays f, from which its reward and potential are learned."""

from __future__ import annotations

from typing import Any, cast

import numpy as np
import pytest
import torch

from methods.airl import AIRL, Logit, Shaped, as_transitions, described, log_density
from methods.base import ABSORBING_STEPS, Array, Episodes, StochasticPolicy
from methods.network import mlp
from methods.rewards import NetworkReward
from tests.methods.worlds import demonstrate

pytestmark = pytest.mark.usefixtures("fused_adam")
STATES, ACTIONS, GAMMA, HORIZON = 16, 4, 0.9, 50


def networks(actions: bool) -> tuple[torch.nn.Module, torch.nn.Module]:
    """g and h of three observed numbers and two of an action."""
    generator = torch.Generator().manual_seed(0)
    return mlp(6 if actions else 4, 8, 1, generator=generator), mlp(4, 8, 1, generator=generator)


@pytest.mark.parametrize("actions", [True, False])
def test_the_agent_is_paid_what_tells_demonstrations_apart_but_for_its_density(actions: bool) -> None:
    g, h = networks(actions)
    mean, std = np.array([0.2, -0.1, 0.0]), np.array([0.5, 1.0, 2.0])
    steps = as_transitions(demonstrate(lambda obs: obs[:, :2], count=2, lifetime=3))
    logs = np.linspace(-2, 2, len(steps))
    with torch.no_grad():
        rows = torch.as_tensor(described(steps, logs, mean, std, actions), dtype=torch.float32)
        logit = Logit(g, h, GAMMA)(rows)[:, 0].numpy()
    paid = Shaped(
        NetworkReward.of(g, mean, std, actions=actions), NetworkReward.of(h, mean, std, actions=False), GAMMA
    )
    np.testing.assert_allclose(paid(steps), logit + logs, atol=1e-5)
    # Once there, nothing is gained.
    assert paid(steps)[steps.absorbing] == pytest.approx(paid.g.absorbing)


def test_steps_of_demonstrations_lead_into_the_absorbing_state_where_they_end() -> None:
    dies = as_transitions(demonstrate(lambda obs: obs[:, :2], count=2, lifetime=3))
    assert dies.next_absorbing.tolist() == [*[False] * 2, *[True] * (1 + ABSORBING_STEPS)] * 2
    assert dies.absorbing.tolist() == [*[False] * 3, *[True] * ABSORBING_STEPS] * 2
    lives = demonstrate(lambda obs: obs[:, :2], count=2)
    assert not as_transitions(lives).next_absorbing.any()
    with pytest.raises(ValueError, match="every step is shown"):
        as_transitions(lives.every(2, np.random.default_rng(0)))


def test_densities_count_within_bounds() -> None:
    class Sure:
        """Has a density of e^40 of positive actions, and of e^-40 of others."""

        def log_prob(self, obs: Array, act: Array) -> Array:
            return 40.0 * np.sign(act[:, 0])

    steps = as_transitions(demonstrate(lambda obs: obs[:, :2], count=2, lifetime=3))
    logs = log_density(cast(StochasticPolicy, Sure()), steps, uniform=-0.7, most=3.0)
    living = ~steps.absorbing
    np.testing.assert_allclose(logs[living], -0.7 + 3.0 * np.sign(steps.act[living, 0]))
    np.testing.assert_array_equal(logs[~living], -0.7)


def test_what_the_agent_is_sure_of_tells_less(world: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """f makes up for its density: of steps that are alike but for how sure the agent is of them, f is higher
    where it is surer."""

    def log_prob(self: object, obs: Array, act: Array) -> Array:
        return np.where(obs[:, 0] > 0, 1.5, -1.5)

    monkeypatch.setattr("methods.stochastic.SquashedGaussian.log_prob", log_prob)
    rng = np.random.default_rng(0)
    obs = tuple(rng.uniform(-1, 1, (21, 3)) for _ in range(20))
    demos = Episodes(obs, tuple(rng.uniform(-1, 1, (20, 2)) for _ in obs), (False,) * 20)
    method = AIRL(iterations=3, actions=False, slope_penalty=0.01, reward_steps=500)
    learned = method.fit(demos, world, np.random.default_rng(0))
    sure, act = np.tile([[0.5, 0.0, 0.0]], (1, 1)), np.zeros((1, 2))
    assert learned.reward(sure, act, sure)[0] > learned.reward(-sure, act, -sure)[0] + 1
