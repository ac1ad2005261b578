from __future__ import annotations

import numpy as np
import pytest
from harness.show.maps import SIDE, maps

from harness.learn.exact import expected_rewards
from harness.learn.simulator import Simulator
from harness.registry import SPECS
from methods.base import Array


class Near:
    """Pays more the nearer an observation is to 0."""

    absorbing = -3.0

    def __call__(self, obs: Array, act: Array, next_obs: Array, /) -> Array:
        return -np.square(obs).sum(axis=1)


@pytest.mark.parametrize(
    "name",
    ["cartpole", "cartpole_discrete", "pendulum", "swingup", "cartpole_swingup", "acrobot", "point_maze"],
)
def test_a_map_tells_what_the_environment_pays_where_an_episode_was(name: str) -> None:
    spec = SPECS[name]

    def policy(obs: Array) -> Array:
        return np.zeros((len(obs), spec.act_size))

    (played,) = Simulator(spec, 1).run(policy, [0])
    found = maps(spec, policy, Near(), played.obs)
    assert found is not None
    assert found.true.shape == (SIDE, SIDE)
    assert found.path.shape == (len(played.obs), 2)
    assert ((found.path > 0) & (found.path < SIDE)).mean() > 0.8
    assert found.learned is not None
    assert found.learned.max() <= 3
    assert maps(spec, policy, None, played.obs) is None
    if name == "swingup":  # whose two axes are its whole state
        at = found.path[:-1].astype(int).clip(0, SIDE - 1)
        assert np.corrcoef(found.true[at[:, 1], at[:, 0]], played.rewards)[0, 1] > 0.99
    if name == "point_maze":
        best = np.unravel_index(found.true.argmax(), found.true.shape)
        cell = 0.7 / SIDE
        assert [-0.1 + cell * (i + 0.5) for i in best[::-1]] == pytest.approx([0.3, 0.5], abs=cell)


def test_the_grid_worlds_map_is_of_its_cells() -> None:
    spec = SPECS["gridworld"]
    tabular = spec.tabular
    assert tabular is not None

    def stay(obs: Array) -> Array:
        return np.tile(np.eye(5)[4], (len(obs), 1))

    (played,) = Simulator(spec, 1).run(stay, [0])
    found = maps(spec, stay, Near(), played.obs)
    assert found is not None
    assert found.learned is not None
    assert np.array_equal(found.true.ravel(), tabular.reward)
    np.testing.assert_allclose(found.learned.ravel() - 3, expected_rewards(tabular, Near())[:, 4])
    x, y = found.path[:-1].astype(int).T
    assert np.array_equal(found.true[y, x], played.rewards)
    without = maps(spec, stay, None, played.obs)
    assert without is not None
    assert without.learned is None


def test_other_tasks_have_no_map() -> None:
    spec = SPECS["reacher"]
    assert maps(spec, lambda obs: np.zeros((len(obs), 2)), Near(), np.zeros((2, 10))) is None
