"""What the games of adversarial methods share."""

from typing import Any

import numpy as np
import pytest
import torch

from methods.adversarial import Game, contrast_among_living
from methods.network import contrast, mlp

pytestmark = pytest.mark.usefixtures("fused_adam")


def rows(obs: np.ndarray, absorbing: int) -> np.ndarray:
    """Of these standardised observations (N, O), and steps in the absorbing state."""
    there = np.zeros((absorbing, obs.shape[1] + 1))
    there[:, -1] = 1
    return np.concatenate([np.pad(obs, ((0, 0), (0, 1))), there])


@pytest.mark.parametrize("seed", range(3))
def test_an_end_pays_less_than_a_fall(seed: int) -> None:
    """Demonstrations stay about the mean of observations, where the absorbing state's zeros are as well;
    what falls leaves it, and ends."""
    rng = np.random.default_rng(seed)
    shown = rows(rng.normal(0, 0.1, (1000, 3)), 0)
    falling = rng.normal(0, 0.1, (500, 3)) + rng.uniform(0, 3, (500, 1))
    generator = torch.Generator().manual_seed(seed)
    game = Game(reward_steps=400)
    discriminator = game.discriminator(mlp(4, *game.layers, 1, generator=generator), generator)
    discriminator.learn(shown, rows(falling, 500), rng)
    with torch.no_grad():
        logits = discriminator.logit(torch.as_tensor(rows(falling, 1), dtype=torch.float32))[:, 0]
    assert logits[-1] < logits[:-1].mean()


def test_the_slope_is_among_the_living() -> None:
    def network(x: torch.Tensor) -> torch.Tensor:
        return x.square().sum(dim=1, keepdim=True)

    def generator() -> torch.Generator:
        return torch.Generator().manual_seed(0)

    a, b = torch.rand(6, 4), torch.rand(6, 4)
    a[:, -1] = b[:, -1] = 0
    found: Any = contrast_among_living(network, a, b, generator())  # type: ignore[arg-type]
    every: Any = contrast(network, a, b, generator())  # type: ignore[arg-type]
    assert found.squared_slope == pytest.approx(every.squared_slope)
    # Between these two, one of the absorbing state, the slope would be large, and does not count.
    there, far = torch.tensor([0.0, 0, 0, 1]).expand(6, 4), torch.tensor([9.0, 9, 9, 0]).expand(6, 4)
    mixed: Any = contrast_among_living(
        network,  # type: ignore[arg-type]
        torch.cat([a, there]),
        torch.cat([b, far]),
        generator(),
    )
    assert mixed.squared_slope < 3 * found.squared_slope
    assert contrast_among_living(network, there, far, generator()).squared_slope == 0  # type: ignore[arg-type]
