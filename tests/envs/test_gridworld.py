"""Grid worlds are what their model says, and their model is the papers'."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from envs.gridworld import WORLD, GridWorld, ObjectWorld, grid, objectworld, transitions
from envs.models import Model, Tabular


def test_moves_and_walls_without_slip() -> None:
    """States 2 and 3 lie above 0 and 1."""
    after = transitions(2, 0.0).argmax(axis=2)
    assert after.T.tolist() == [[1, 1, 3, 3], [2, 3, 2, 3], [0, 0, 2, 2], [0, 1, 0, 1], [0, 1, 2, 3]]
    assert transitions(2, 0.0).max(axis=2).min() == 1


def test_slip_by_hand() -> None:
    """From the bottom left corner, `right`: 0.7 + 0.3/5 to go right, 0.3/5 to go up, the rest stays. A slip
    of 0.375 is the paper's chance of 0.3 of another action."""
    np.testing.assert_allclose(transitions(2, 0.3)[0, 0], [0.18, 0.76, 0.06, 0.0], atol=1e-15)
    sure = transitions(3, 0.0)
    other = 0.7 * sure + 0.3 * (sure.sum(axis=1, keepdims=True) - sure) / 4
    np.testing.assert_allclose(transitions(3, 0.375)[4], other[4])


def naive_distance(world: ObjectWorld, size: int, state: int, colours: np.ndarray, colour: int) -> float:
    found = [
        math.dist(divmod(state, size), divmod(int(cell), size))
        for cell, its in zip(world.cells, colours, strict=True)
        if its == colour
    ]
    return min(found, default=math.sqrt(2) * size)


@settings(deadline=None, max_examples=15)
@given(st.integers(2, 8), st.integers(1, 8), st.integers(2, 4), st.integers(0, 2**32))
def test_objectworld_recomputed_object_by_object(size: int, objects: int, colours: int, seed: int) -> None:
    objects = min(objects, size**2)
    world = objectworld(size, objects, colours, 0.3, np.random.default_rng(seed))
    assert len(set(world.cells.tolist())) == objects
    for state in range(size**2):
        distances = [
            naive_distance(world, size, state, kind, colour)
            for kind in (world.inner, world.outer)
            for colour in range(colours)
        ]
        if distances[colours] >= 3:
            assert world.reward[state] == 0
        else:
            assert world.reward[state] == (1 if distances[colours + 1] < 2 else -1)
        y, x = divmod(state, size)
        place = [2 * x / (size - 1) - 1, 2 * y / (size - 1) - 1]
        scaled = [2 * d / (math.sqrt(2) * size) - 1 for d in distances]
        np.testing.assert_allclose(world.obs[state], [*place, *scaled], atol=1e-7)
        expected = [float(d < limit) for d in distances for limit in range(1, size + 1)]
        assert world.features[state].tolist() == expected


@pytest.mark.parametrize(
    ("changes", "names"),
    [
        ({"P": np.tile([2.0, -1.0, 0.0, 0.0], (4, 5, 1))}, "P must hold"),
        ({"obs": np.zeros((4, 2))}, "different in each state"),
        ({"obs": np.array([[0.1], [0.2], [0.3], [0.4]])}, "32-bit"),
        ({"reward": np.array([0, 0, 0, math.inf])}, "finite"),
        ({"features": np.full((4, 2), 1.01)}, "features must lie"),
    ],
)
def test_tabular_refuses(changes: dict[str, np.ndarray], names: str) -> None:
    with pytest.raises(ValueError, match=names):
        replace(grid(2, 0.3), **changes)


def test_tabular_is_read_only_and_its_model_shows_no_reward() -> None:
    for array in vars(grid(2, 0.3)).values():
        with pytest.raises(ValueError, match="read-only"):
            array.flat[0] = 1
    assert type(WORLD.model) is Model
    assert {name: id(array) for name, array in vars(WORLD.model).items()} == {
        name: id(vars(WORLD)[name]) for name in ("P", "start", "obs")
    }


def test_states_are_those_whose_observation_is_nearest() -> None:
    rng = np.random.default_rng(0)
    order = rng.permutation(len(WORLD.obs))
    assert WORLD.states(WORLD.obs[order]).tolist() == order.tolist()
    seen = rng.uniform(-1.5, 1.5, (300, WORLD.obs.shape[1]))
    distances = np.linalg.norm(seen[:, None] - WORLD.obs, axis=2)
    assert WORLD.states(seen).tolist() == distances.argmin(axis=1).tolist()


def test_without_slip_the_env_goes_where_it_is_told() -> None:
    corner = np.eye(9)[0]
    env = GridWorld(Tabular(**{**vars(grid(3, 0.0)), "start": corner}))
    assert env.reset(seed=0)[1] == {"state": 0}
    path = [env.step(np.int64(a)) for a in (0, 0, 0, 1, 1, 4, 2)]
    assert [info["state"] for *_, info in path] == [1, 2, 2, 5, 8, 8, 7]
    assert [reward for _, reward, *_ in path] == [0, 0, 0, 0, 0, 1, 1]


def test_the_env_slips_as_its_model_says() -> None:
    env = GridWorld(grid(3, 0.5))
    env.reset(seed=0)
    counts = np.zeros(9)
    for _ in range(4000):
        env.state = 4
        env.step(np.int64(0))
        counts[env.state] += 1
    np.testing.assert_allclose(counts / 4000, env.tabular.P[4, 0], atol=0.03)
