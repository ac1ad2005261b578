"""Networks of plain arrays are torch's, fits descend, and policies draw as often as their densities say."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch
from scipy.stats import norm
from torch.distributions import Independent, Normal, TanhTransform, TransformedDistribution

from methods.network import ADAM, Network, contrast, descend, mlp, preference_loss
from methods.stochastic import LOG_STD, EpsilonGreedy, Gaussian, Softmax, SquashedGaussian


def layers(seed: int = 0) -> torch.nn.Sequential:
    return mlp(3, 8, 5, 2, generator=torch.Generator().manual_seed(seed))


def network(tanh: bool = False) -> Network:
    return Network.from_torch(layers(), np.array([1.0, -2.0, 0.0]), np.array([2.0, 0.1, 1.0]), tanh)


@pytest.mark.parametrize("tanh", [False, True])
def test_it_equals_the_torch_layers_it_came_from(tanh: bool) -> None:
    x = np.random.default_rng(0).normal(size=(50, 3))
    standardised = (x - [1.0, -2.0, 0.0]) / [2.0, 0.1, 1.0]
    with torch.no_grad():
        expected = layers().double()(torch.as_tensor(standardised))
        expected = torch.tanh(expected) if tanh else expected
    np.testing.assert_allclose(network(tanh)(x), expected.numpy(), rtol=1e-12, atol=1e-14)


def fit(seed: int) -> tuple[Network, list[float]]:
    rng = np.random.default_rng(5)
    x = rng.uniform(-1, 1, (200, 3))
    y = x @ rng.uniform(-1, 1, (3, 2)) + 0.3
    net = layers()

    def loss(x: torch.Tensor, y: torch.Tensor) -> torch.Tensor:
        return (net(x) - y).square().mean()

    adam = torch.optim.Adam(net.parameters(), 1e-2, **ADAM)
    curve = descend(loss, adam, (x, y), 600, 64, np.random.default_rng(seed), points=20)
    fitted = Network.from_torch(net, np.zeros(3), np.ones(3))
    assert np.abs(fitted(x) - y).max() < 0.1
    return fitted, curve


def test_a_fit_finds_a_linear_function_and_depends_on_its_generator_alone() -> None:
    torch.manual_seed(1)
    one, curve = fit(0)
    torch.manual_seed(2)
    same, same_curve = fit(0)
    other, _ = fit(1)
    assert curve == same_curve
    assert len(curve) == 20
    assert curve[-1] < 1e-3 < 0.1 < curve[0]
    x = np.eye(3)
    np.testing.assert_array_equal(one(x), same(x))
    assert (one(x) != other(x)).any()


def test_every_step_is_taken() -> None:
    weight = torch.nn.Parameter(torch.ones(1))
    data, rng = [np.ones((3, 1))], np.random.default_rng(0)
    curve = descend(lambda x: (weight * x).mean(), torch.optim.SGD([weight], 0.5), data, 1, 2, rng)
    assert (curve, weight.item()) == ([1.0], 0.5)


def test_a_stretch_is_preferred_by_the_sum_of_its_rewards() -> None:
    better, worse = torch.full((2, 3, 1), 0.5), torch.full((2, 3, 1), -0.1)
    logit = 3 * (np.tanh(0.5) + np.tanh(0.1))
    loss = preference_loss(torch.nn.Identity(), better, worse).item()
    assert loss == pytest.approx(np.log1p(np.exp(-logit)))


def test_slopes_are_those_of_the_network() -> None:
    slope = torch.tensor([[3.0, -4.0, 1.0]])
    a, b = torch.randn(2, 4000, 3, generator=torch.Generator().manual_seed(0))
    found = contrast(lambda x: x @ slope.T + 7, a, b, torch.Generator().manual_seed(1))  # type: ignore[arg-type]
    assert float(found.squared_slope) == pytest.approx(26, rel=0.1)
    torch.testing.assert_close(torch.cat([found.a, found.b]), torch.cat([a, b]) @ slope.T + 7)


def gaussian(*entries: float) -> SquashedGaussian:
    """The one whose network says these numbers at the observation 1, and 0 at 0."""
    weights = (np.array([entries]),)
    return SquashedGaussian(Network(np.zeros(1), np.ones(1), weights, (np.zeros(len(entries)),)))


def test_its_density_is_torchs() -> None:
    rng = np.random.default_rng(0)
    weights, biases = (rng.normal(size=(3, 8)), rng.normal(size=(8, 4))), (rng.normal(size=8), np.zeros(4))
    policy = SquashedGaussian(Network(rng.normal(size=3), rng.uniform(0.5, 2, 3), weights, biases))
    obs, act = rng.normal(size=(1000, 3)), rng.uniform(-0.999, 0.999, (1000, 2))
    mean, log_std = np.split(policy.network(obs), 2, axis=1)
    assert (log_std > LOG_STD[1]).any()
    normal = Normal(torch.as_tensor(mean), torch.as_tensor(log_std.clip(*LOG_STD)).exp())
    density = Independent(TransformedDistribution(normal, TanhTransform()), 1)
    expected = density.log_prob(torch.as_tensor(act)).numpy()
    np.testing.assert_allclose(policy.log_prob(obs, act), expected, rtol=1e-9)
    np.testing.assert_allclose(policy.mean(obs), np.tanh(mean), rtol=1e-12)


@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_its_density_is_exact_next_to_the_bounds_and_finite_at_them(sign: float) -> None:
    # a = tanh(u) has 1 - a = 2 / (exp(2 u) + 1), so u = log(2 / distance - 1) / 2.
    distance, mean, log_std = 1e-7, 0.3, 0.5
    z = (sign * 0.5 * np.log(2 / distance - 1) - mean) / np.exp(log_std)
    slope = np.log(distance) + np.log(2 - distance)
    expected = -0.5 * z**2 - 0.5 * np.log(2 * np.pi) - log_std - slope
    act = np.array([[sign * (1 - distance)], [sign], [sign * np.nextafter(np.float32(1), np.float32(0))]])
    logs = gaussian(mean, log_std).log_prob(np.ones((3, 1)), act)
    assert logs[0] == pytest.approx(expected, rel=1e-8)
    assert logs[1] == logs[2]


def test_samples_are_as_frequent_as_its_density_says() -> None:
    policy, obs = gaussian(0.5, -0.3), np.ones((200_000, 1))
    act = policy.sample(obs, np.random.default_rng(0))[:, 0]
    shares, edges = np.histogram(act, bins=20, range=(-1, 1))
    fine = np.linspace(-1, 1, 20 * 100 + 1)
    middle = ((fine[1:] + fine[:-1]) / 2)[:, None]
    density = np.exp(policy.log_prob(np.ones_like(middle), middle)).reshape(20, 100).mean(axis=1)
    np.testing.assert_allclose(shares / len(act), density * np.diff(edges), atol=0.003)
    same = policy.sample(obs, np.random.default_rng(0))[:, 0]
    np.testing.assert_array_equal(act, same)


def test_normal_actions_have_their_density_and_count_as_the_bound_beyond() -> None:
    policy = Gaussian(lambda obs: obs, np.log([0.5, 0.1]))
    obs = np.tile([[0.9, -0.2]], (20_000, 1))
    act = policy.sample(obs, np.random.default_rng(0))
    assert np.abs(act).max() == 1
    np.testing.assert_allclose((act == 1).mean(axis=0), [norm.sf(0.1 / 0.5), 0], atol=0.02)
    np.testing.assert_allclose(act[:, 1].std(), 0.1, rtol=0.02)
    density = norm.logpdf(act, obs, [0.5, 0.1]).sum(axis=1)
    np.testing.assert_allclose(policy.log_prob(obs, act), density)


@pytest.mark.parametrize("kind", [Softmax, lambda mean: EpsilonGreedy(mean, 0.3)])
def test_choices_come_as_often_as_their_probability_says(kind: Any) -> None:
    policy = kind(lambda obs: np.tile([0.0, 1.0, -1.0], (len(obs), 1)))
    act = policy.sample(np.zeros((20_000, 1)), np.random.default_rng(0))
    assert (act.sum(axis=1) == 1).all()
    chances = np.exp(policy.log_prob(np.zeros((3, 1)), np.eye(3)))
    assert chances.sum() == pytest.approx(1)
    np.testing.assert_allclose(act.mean(axis=0), chances, atol=0.01)
