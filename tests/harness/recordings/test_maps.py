"""Maps show rewards where the environment pays them."""

from __future__ import annotations

import numpy as np
import pytest

from harness.recordings.maps import SIDE, maps
from harness.registry import SPECS
from harness.rl.exact import expected_rewards
from harness.rl.simulator import Simulator
from methods.base import Array

MAPPED = ("cartpole", "swingup", "cartpole_swingup", "acrobot", "point_maze")


class Near:
    """Pays more the nearer an observation is to 0."""

    absorbing = -3.0

    def __call__(self, obs: Array, act: Array, next_obs: Array, /) -> Array:
        return -np.square(obs).sum(axis=1)


@pytest.mark.parametrize("name", MAPPED)
def test_a_map_shows_what_the_environment_pays_along_an_episode(name: str) -> None:
    spec = SPECS[name]

    def policy(obs: Array) -> Array:
        return np.zeros((len(obs), spec.act_size))

    (played,) = Simulator(spec, 1).run(policy, [0])
    result = maps(spec, policy, Near(), played.obs)
    assert result is not None
    true, path = result.rewards["true"], result.path
    assert true.shape == (SIDE, SIDE)
    assert path.shape == (len(played.obs), 2)
    assert ((path > 0) & (path < SIDE)).mean() > 0.8
    assert result.rewards["learned"].max() <= 3
    assert maps(spec, policy, None, played.obs) is None
    assert maps(SPECS["reacher"], policy, Near(), played.obs) is None
    if name == "swingup":  # both axes are its whole state
        x, y = path[:-1].astype(int).clip(0, SIDE - 1).T
        assert np.corrcoef(true[y, x], played.rewards)[0, 1] > 0.99
    if name == "point_maze":
        best, cell = np.unravel_index(true.argmax(), true.shape), 0.7 / SIDE
        assert [-0.1 + cell * (i + 0.5) for i in best[::-1]] == pytest.approx([0.3, 0.5], abs=cell)


def test_the_grid_worlds_map_is_of_its_cells() -> None:
    spec = SPECS["gridworld"]
    tabular = spec.tabular
    assert tabular is not None

    def stay(obs: Array) -> Array:
        return np.tile(np.eye(5)[4], (len(obs), 1))

    (played,) = Simulator(spec, 1).run(stay, [0])
    result, without = (maps(spec, stay, reward, played.obs) for reward in (Near(), None))
    assert result is not None
    assert without is not None
    assert without.rewards.keys() == {"true"}
    true, learned = result.rewards["true"], result.rewards["learned"]
    assert np.array_equal(true.ravel(), tabular.reward)
    np.testing.assert_allclose(learned.ravel() - 3, expected_rewards(tabular, Near())[:, 4])
    x, y = result.path[:-1].astype(int).T
    assert np.array_equal(true[y, x], played.rewards)
