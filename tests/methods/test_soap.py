from __future__ import annotations

import numpy as np
import pytest
import torch

from methods.network import ADAM, Network, Regression, descend, mlp
from methods.soap import Moments, Soap

RNG = np.random.default_rng(0)


def turned(size: int) -> np.ndarray:
    return np.linalg.qr(RNG.normal(size=(size, size)))[0]


def test_steps_turn_with_inputs_and_outputs() -> None:
    """Adam's do not: its axes are the weights."""
    left, right = turned(5), turned(5)
    gradients = RNG.normal(size=(30, 5, 5))
    one, other = Moments.of(gradients[0]), Moments.of(left @ gradients[0] @ right)
    for gradient in gradients[1:]:
        step = one.step(gradient)
        np.testing.assert_allclose(other.step(left @ gradient @ right), left @ step @ right, atol=1e-7)


def test_the_first_step_along_the_gradient_of_the_axes_is_the_nearest_orthogonal_matrix() -> None:
    gradient = RNG.normal(size=(4, 6))
    u, _, vh = np.linalg.svd(gradient, full_matrices=False)
    np.testing.assert_allclose(Moments.of(gradient).step(gradient), u @ vh, atol=1e-6)


def sine(seed: int) -> tuple[np.ndarray, np.ndarray, torch.nn.Module]:
    x = np.random.default_rng(0).normal(size=(2000, 3))
    y = np.sin(x @ [1.0, -2.0, 0.5])[:, None]
    return x, y, mlp(3, 32, 16, 1, generator=torch.Generator().manual_seed(seed))


def test_a_fit_leaves_less_than_a_third_of_what_as_many_steps_of_adam_leave() -> None:
    left = []
    for kind in (
        lambda net: torch.optim.Adam(net.parameters(), 1e-2, **ADAM),
        lambda net: Soap([net], [1e-2]),
    ):
        x, y, net = sine(0)

        def loss(x: torch.Tensor, y: torch.Tensor, net: torch.nn.Module = net) -> torch.Tensor:
            return (net(x) - y).square().mean()

        left.append(descend(loss, kind(net), (x, y), 1000, 256, np.random.default_rng(1))[-1])
    assert left[1] < left[0] / 3


def test_all_layers_of_all_networks_move_but_for_the_first_step() -> None:
    x, y, one = sine(0)
    other = sine(1)[2]
    before = [p.detach().clone() for net in (one, other) for p in net.parameters()]

    def moved(steps: int) -> list[bool]:
        def loss(x: torch.Tensor, y: torch.Tensor) -> torch.Tensor:
            return (one(x) + other(x) - y).square().mean()

        Regression(steps=steps).minimise(loss, [one, other], (x, y), np.random.default_rng(0))
        after = [p for net in (one, other) for p in net.parameters()]
        return [not torch.equal(a, b) for a, b in zip(before, after, strict=True)]

    assert not any(moved(1))
    assert all(moved(2))


def test_a_fit_of_one_row_repeated_meets_it() -> None:
    x, y = np.ones((5, 2)), np.full((5, 1), 0.3)
    net = mlp(2, 8, 1, generator=torch.Generator().manual_seed(0))

    def loss(x: torch.Tensor, y: torch.Tensor) -> torch.Tensor:
        return (net(x) - y).square().mean()

    curve = Regression(steps=500).minimise(loss, [net], (x, y), np.random.default_rng(0))
    fitted = Network.from_torch(net, np.zeros(2), np.ones(2))
    assert fitted(x) == pytest.approx(y, abs=1e-3)
    assert curve[-1] < 1e-5 < curve[0]
