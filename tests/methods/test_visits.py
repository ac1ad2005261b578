"""What is visited, as rows for reward networks."""

import numpy as np

from methods.base import Episodes, Transitions
from methods.visits import sample, visitations, visited

MEAN, STD = np.array([1.0, -1.0, 0.5]), np.array([2.0, 0.5, 1.0])


def test_visitations_standardise_and_count_absorbing_steps_up_to_the_horizon() -> None:
    rng = np.random.default_rng(0)
    lengths, terminated = (4, 10, 3, 10), (True, False, False, True)
    episodes = Episodes(
        tuple(rng.normal(size=(n + 1, 3)) for n in lengths),
        tuple(rng.uniform(-1, 1, (n, 2)) for n in lengths),
        terminated,
    )
    visits = visitations(episodes, 10 - episodes.lengths, MEAN, STD)
    alive, absorbed = visits[: sum(lengths)], visits[sum(lengths) :]
    obs, act = episodes.pairs()
    np.testing.assert_allclose(alive[:, :3] * STD + MEAN, obs)
    np.testing.assert_array_equal(alive[:, 3:5], act)
    assert (alive[:, 5] == 0).all()
    # Only the first episode terminated before the horizon, six steps early.
    np.testing.assert_array_equal(absorbed, np.tile([0, 0, 0, 0, 0, 1.0], (6, 1)))


def test_minibatches_are_rows_of_the_visitations() -> None:
    visits = np.arange(12.0).reshape(4, 3)
    rows = sample(visits, 200, np.random.default_rng(0)).numpy()
    assert {tuple(row) for row in rows} == {tuple(row) for row in visits}


def test_of_few_steps_that_are_shown_the_absorbing_ones_are_as_rare() -> None:
    rng = np.random.default_rng(0)
    terminated = Episodes((rng.normal(size=(41, 3)),) * 5, (rng.uniform(-1, 1, (40, 2)),) * 5, (True,) * 5)
    few = terminated.every(10, rng)
    assert visitations(terminated, 10, MEAN, STD)[:, -1].tolist() == [0] * 200 + [1] * 50
    assert visitations(few, 10, MEAN, STD)[:, -1].tolist() == [0] * 20 + [1] * 5


def test_steps_of_an_agent_are_described_as_those_of_episodes_are() -> None:
    rng = np.random.default_rng(0)
    episodes = Episodes((rng.normal(size=(5, 3)),), (rng.uniform(-1, 1, (4, 2)),), (True,))
    obs, act = episodes.pairs()
    absorbing = np.array([False] * 4 + [True] * 2)
    there = np.full((2, 3), 7.0), np.full((2, 2), 0.5)
    obs, act = np.concatenate([obs, there[0]]), np.concatenate([act, there[1]])
    steps = Transitions.own(obs, act, obs, absorbing, absorbing)
    for actions in (True, False):
        rows = visitations(episodes, 2, MEAN, STD, actions)
        np.testing.assert_array_equal(visited(steps, MEAN, STD, actions), rows)
