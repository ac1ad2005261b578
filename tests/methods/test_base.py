"""Demonstrations, and what methods make of them: rows, features, and what ends pay."""

import numpy as np
import pytest

from methods.base import Array, Episodes, Transitions
from methods.fourier import FourierFeatures
from methods.rewards import default_absorbing
from methods.visits import visitations, visited


def episodes(lengths: list[int], terminated: bool = False) -> Episodes:
    rng = np.random.default_rng(0)
    return Episodes(
        tuple(rng.standard_normal((n + 1, 3)) for n in lengths),
        tuple(rng.uniform(-1, 1, (n, 2)) for n in lengths),
        tuple(terminated for _ in lengths),
    )


def test_transitions_are_of_steps_that_follow_each_other() -> None:
    obs = tuple(np.arange(n + 1.0)[:, None] + 100 * n for n in (4, 7))
    act = tuple(np.linspace(-1, 1, n)[:, None] for n in (4, 7))
    episodes = Episodes(obs, act, (False, False))
    before, done, after = episodes.transitions()
    np.testing.assert_array_equal(done, np.concatenate(act))
    np.testing.assert_array_equal(after, before + 1)
    assert len(before) == 11
    times = (np.array([0, 1, 3]), np.array([2, 5, 6]))
    some = [tuple(rows[at] for rows, at in zip(column, times, strict=True)) for column in (obs, act)]
    before, done, after = Episodes(*some, (False, False), times, (4, 7)).transitions()
    assert before[:, 0].tolist() == [400, 705]
    assert after[:, 0].tolist() == [401, 706]
    np.testing.assert_array_equal(done, [act[0][0], act[1][5]])


@pytest.mark.parametrize(
    ("obs", "act"),
    [
        ([], []),
        ([np.zeros((4, 3))], [np.zeros((4, 2))]),
        ([np.full((4, 3), np.nan)], [np.zeros((3, 2))]),
        ([np.zeros((4, 3))], [np.full((3, 2), 1.5)]),
    ],
    ids=["none", "no last observation", "NaN", "action out of range"],
)
def test_bad_episodes_are_refused(obs: list[np.ndarray], act: list[np.ndarray]) -> None:
    with pytest.raises(ValueError, match="episode"):
        Episodes(tuple(obs), tuple(act), tuple(False for _ in obs))


def uniform(count: int, rng: np.random.Generator) -> np.ndarray:
    return rng.uniform(-1, 1, (count, 2))


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


def test_an_end_pays_the_mean_of_uniform_actions_unless_all_demonstrations_end() -> None:
    class Quadratic:
        absorbing = 0.0

        def __call__(self, obs: Array, act: Array, next_obs: Array) -> Array:
            return np.asarray(-np.square(act).sum(1))

    lives, dies, rng = episodes([20_000]), episodes([50, 7], terminated=True), np.random.default_rng(1)
    assert default_absorbing(Quadratic(), lives, uniform, rng) == pytest.approx(-2 / 3, abs=0.02)
    shown = -np.square(dies.pairs()[1]).sum(1).mean()
    assert default_absorbing(Quadratic(), dies, uniform, rng) == pytest.approx(shown)


def test_products_of_random_waves_are_a_kernels_and_follow_the_tasks_own_features() -> None:
    rng, width = np.random.default_rng(0), 1.7
    obs, act = MEAN + STD * rng.normal(size=(200, 3)), rng.uniform(-1, 1, (200, 2))
    own = lambda obs, act: np.column_stack([obs[:, 0], act[:, 1]])  # noqa: E731
    features = FourierFeatures.drawn(own, obs, 2, 20_000, width, rng)(obs, act)
    np.testing.assert_array_equal(features[:, :2], own(obs, act))
    x = np.column_stack([(obs - obs.mean(axis=0)) / obs.std(axis=0), act])
    squares = np.square(x[:, None] - x).sum(axis=2)
    kernel = np.exp(-squares / (2 * width**2))
    np.testing.assert_allclose(features[:, 2:] @ features[:, 2:].T, kernel, atol=0.05)
