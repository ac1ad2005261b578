"""A network of plain arrays is the torch network that it came from."""

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from methods.network import ADAM, Network, contrast, descend, mlp, standardiser


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


def test_many_rows_are_answered_a_part_at_a_time(monkeypatch: pytest.MonkeyPatch) -> None:
    x = np.random.default_rng(0).normal(size=(50, 3))
    whole = network()(x)
    asked: list[int] = []
    relu = np.maximum
    monkeypatch.setattr(np, "maximum", lambda a, b: asked.append(len(a)) or relu(a, b))
    monkeypatch.setattr("methods.network.ROWS", 20)
    np.testing.assert_allclose(network()(x), whole, rtol=1e-12, atol=1e-14)
    assert asked == [20, 20, 20, 20, 10, 10]


def test_it_keeps_its_numbers_when_the_torch_layers_learn_on() -> None:
    torch_layers = layers()
    kept = Network.from_torch(torch_layers, np.zeros(3), np.ones(3))
    before = kept(np.ones((1, 3)))
    with torch.no_grad():
        for parameter in torch_layers.parameters():
            parameter.add_(1.0)
    np.testing.assert_array_equal(kept(np.ones((1, 3))), before)


@pytest.mark.parametrize("tanh", [False, True])
def test_its_arrays_are_all_of_it(tanh: bool) -> None:
    there = network(tanh)
    back = Network.from_arrays(there.arrays())
    x = np.random.default_rng(1).normal(size=(20, 3))
    np.testing.assert_array_equal(back(x), there(x))
    assert back.tanh is tanh


@pytest.mark.parametrize("missing", ["mean", "std", "tanh", "weight0"])
def test_a_missing_array_is_noticed(missing: str) -> None:
    named = network().arrays()
    del named[missing]
    with pytest.raises(KeyError):
        Network.from_arrays(named)


def test_a_layers_outputs_and_gradients_are_torchs() -> None:
    generator = torch.Generator().manual_seed(0)
    ours = mlp(3, 8, 5, 2, generator=generator).double()
    theirs = torch.nn.Sequential(
        *(
            torch.nn.Linear(m.in_features, m.out_features).double() if hasattr(m, "weight") else m
            for m in ours
        )
    )
    theirs.load_state_dict(ours.state_dict())
    found = []
    for network in (ours, theirs):
        x = torch.linspace(-1, 1, 30).double().reshape(10, 3).requires_grad_()
        network(x).square().mean().backward()
        found.append([network(x), x.grad, *(p.grad for p in network.parameters())])
    for one, other in zip(*found, strict=True):
        torch.testing.assert_close(one, other, rtol=1e-12, atol=1e-14)


def test_a_layer_that_would_be_differentiated_twice_says_so() -> None:
    x = torch.ones(4, 3, requires_grad=True)
    (slope,) = torch.autograd.grad(layers()(x).sum(), x, create_graph=True)
    with pytest.raises(RuntimeError, match="differentiate twice"):
        slope.square().sum().backward()


def test_mlp_comes_from_its_generator_alone() -> None:
    torch.manual_seed(1)
    one = layers()
    torch.manual_seed(2)
    same, other = layers(), layers(seed=1)
    for a, b, c in zip(one.parameters(), same.parameters(), other.parameters(), strict=True):
        assert torch.equal(a, b)
        assert not torch.equal(a, c)


def test_mlp_starts_within_torchs_bounds_and_fills_them() -> None:
    wide = mlp(100, 50, 1, generator=torch.Generator().manual_seed(0))
    assert [type(m).__name__ for m in wide] == ["Linear", "ReLU", "Linear"]
    weight = next(wide.parameters())
    assert 0.099 < weight.abs().max() <= 0.1
    assert abs(weight.mean()) < 0.01


@given(arrays(float, (7, 3), elements=st.floats(-1e3, 1e3, width=32)))
def test_standardised_columns_have_mean_0_and_deviation_1_or_0(x: np.ndarray) -> None:
    x[:, 2] = 0.1
    mean, std = standardiser(x)
    z = (x - mean) / std
    varies = x.std(axis=0) > 1e-8
    assert std[2] == 1
    np.testing.assert_allclose(z.mean(axis=0), 0, atol=1e-4)
    np.testing.assert_allclose(z.std(axis=0), varies, atol=1e-6)


def adam(net: torch.nn.Module, rate: float) -> torch.optim.Optimizer:
    return torch.optim.Adam(net.parameters(), rate, **ADAM)


def fit(seed: int) -> tuple[Network, list[float]]:
    rng = np.random.default_rng(5)
    x = rng.uniform(-1, 1, (200, 3))
    y = x @ rng.uniform(-1, 1, (3, 2)) + 0.3
    net = layers()

    def loss(x: torch.Tensor, y: torch.Tensor) -> torch.Tensor:
        return (net(x) - y).square().mean()

    curve = descend(loss, adam(net, 1e-2), (x, y), 600, 64, np.random.default_rng(seed), points=20)
    fitted = Network.from_torch(net, np.zeros(3), np.ones(3))
    assert np.abs(fitted(x) - y).max() < 0.1
    return fitted, curve


def test_descend_fits_a_linear_function_and_tells_its_loss() -> None:
    _, curve = fit(0)
    assert len(curve) == 20
    assert curve[-1] < 1e-3 < 0.1 < curve[0]


def test_descend_depends_on_its_generator_alone() -> None:
    torch.manual_seed(1)
    one, curve = fit(0)
    torch.manual_seed(2)
    same, same_curve = fit(0)
    other, _ = fit(1)
    assert curve == same_curve
    x = np.eye(3)
    np.testing.assert_array_equal(one(x), same(x))
    assert (one(x) != other(x)).any()


def test_fewer_steps_than_points_give_one_value_a_step() -> None:
    net = layers()
    data = (np.ones((4, 3)),)
    curve = descend(lambda x: net(x).square().mean(), adam(net, 0.0), data, 3, 2, np.random.default_rng(0))
    expected = net(torch.ones(1, 3)).square().mean().item()
    assert curve == pytest.approx([expected] * 3)
    assert expected > 0


def test_slopes_are_those_of_the_network() -> None:
    slope = torch.tensor([[3.0, -4.0, 1.0]])
    a, b = torch.randn(2, 4000, 3, generator=torch.Generator().manual_seed(0))
    found = contrast(lambda x: x @ slope.T + 7, a, b, torch.Generator().manual_seed(1))  # type: ignore[arg-type]
    assert float(found.squared_slope) == pytest.approx(26, rel=0.1)
    torch.testing.assert_close(torch.cat([found.a, found.b]), torch.cat([a, b]) @ slope.T + 7)
