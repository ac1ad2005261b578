"""A network of plain arrays is the torch network that it came from, and fits descend."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from methods.network import ADAM, Network, contrast, descend, mlp
from methods.soap import Soap


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


@pytest.mark.parametrize("tanh", [False, True])
def test_its_arrays_are_all_of_it(tanh: bool) -> None:
    there = network(tanh)
    back, x = Network.from_arrays(there.arrays()), np.random.default_rng(1).normal(size=(20, 3))
    np.testing.assert_array_equal(back(x), there(x))
    assert back.tanh is tanh


def test_any_arrays_are_laid_out_in_64_bits_and_rows() -> None:
    """Products of other layouts round differently, and stored arrays are laid out so."""
    there = network(tanh=True)
    views = [np.asfortranarray(w) for w in there.weights], [list(b) for b in there.biases]
    laid_out = Network.of([1, -2, 0], there.std.astype(np.float32), *views)
    for array in (laid_out.mean, laid_out.std, *laid_out.weights, *laid_out.biases):
        assert (array.dtype, array.flags.c_contiguous) == (np.float64, True)
    named = there.arrays()
    del named["weight0"]
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


def test_slopes_are_those_of_the_network() -> None:
    slope = torch.tensor([[3.0, -4.0, 1.0]])
    a, b = torch.randn(2, 4000, 3, generator=torch.Generator().manual_seed(0))
    found = contrast(lambda x: x @ slope.T + 7, a, b, torch.Generator().manual_seed(1))  # type: ignore[arg-type]
    assert float(found.squared_slope) == pytest.approx(26, rel=0.1)
    torch.testing.assert_close(torch.cat([found.a, found.b]), torch.cat([a, b]) @ slope.T + 7)


def test_a_fit_leaves_less_than_a_third_of_what_as_many_steps_of_adam_leave() -> None:
    left = []
    for kind in (
        lambda net: torch.optim.Adam(net.parameters(), 1e-2, **ADAM),
        lambda net: Soap([net], [1e-2]),
    ):
        x = np.random.default_rng(0).normal(size=(2000, 3))
        y = np.sin(x @ [1.0, -2.0, 0.5])[:, None]
        net = mlp(3, 32, 16, 1, generator=torch.Generator().manual_seed(0))

        def loss(x: torch.Tensor, y: torch.Tensor, net: torch.nn.Module = net) -> torch.Tensor:
            return (net(x) - y).square().mean()

        left.append(descend(loss, kind(net), (x, y), 1000, 256, np.random.default_rng(1))[-1])
    assert left[1] < left[0] / 3
