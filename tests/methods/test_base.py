import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from methods.base import Episodes, Transitions
from methods.rewards import default_absorbing
from methods.stochastic import roughened
from methods.visits import seen_by_both


def episodes(lengths: list[int], terminated: bool = False) -> Episodes:
    rng = np.random.default_rng(0)
    return Episodes(
        tuple(rng.standard_normal((n + 1, 3)) for n in lengths),
        tuple(rng.uniform(-1, 1, (n, 2)) for n in lengths),
        tuple(terminated for _ in lengths),
    )


@given(st.lists(st.integers(1, 9), min_size=1, max_size=5))
def test_pairs_hold_every_step_once_and_never_the_last_observation(lengths: list[int]) -> None:
    demos = episodes(lengths)
    obs, act = demos.pairs()
    assert len(obs) == len(act) == sum(lengths)
    assert demos.lengths.tolist() == lengths
    for last in (o[-1] for o in demos.obs):
        assert not (obs == last).all(axis=1).any()


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


def test_episodes_cannot_be_written_to() -> None:
    demos = episodes([4])
    with pytest.raises(ValueError, match="read-only"):
        demos.obs[0][0, 0] = 1.0


@pytest.mark.parametrize(
    ("obs", "act"),
    [
        ([], []),
        ([np.zeros((1, 3))], [np.zeros((0, 2))]),
        ([np.zeros((4, 3))], [np.zeros((4, 2))]),
        ([np.full((4, 3), np.nan)], [np.zeros((3, 2))]),
        ([np.zeros((4, 3))], [np.full((3, 2), 1.5)]),
        ([np.zeros((4, 3)), np.zeros((4, 2))], [np.zeros((3, 2))] * 2),
    ],
    ids=["none", "no step", "no last observation", "NaN", "action out of range", "unequal sizes"],
)
def test_bad_episodes_are_refused(obs: list[np.ndarray], act: list[np.ndarray]) -> None:
    with pytest.raises(ValueError, match="episode"):
        Episodes(tuple(obs), tuple(act), tuple(False for _ in obs))


def test_steps_are_not_demonstrated_unless_they_say_so() -> None:
    no = np.zeros(4, bool)
    steps = np.zeros((4, 3)), np.zeros((4, 2)), np.zeros((4, 3)), no, no
    assert Transitions.own(*steps).demonstrated.tolist() == [False] * 4
    assert Transitions(*steps, ~no).demonstrated.tolist() == [True] * 4


def uniform(count: int, rng: np.random.Generator) -> np.ndarray:
    return rng.uniform(-1, 1, (count, 2))


def right(count: int, rng: np.random.Generator) -> np.ndarray:
    return np.tile([0.0, 1.0], (count, 1))


class Quadratic:
    absorbing = 0.0

    def __call__(self, obs: np.ndarray, act: np.ndarray, next_obs: np.ndarray) -> np.ndarray:
        return -(act**2).sum(1)


def test_absorption_pays_the_mean_over_uniform_actions() -> None:
    demos = episodes([20_000])
    rng = np.random.default_rng(1)
    assert default_absorbing(Quadratic(), demos, uniform, rng) == pytest.approx(-2 / 3, abs=0.02)


def test_what_is_uniform_is_for_the_environment_to_say() -> None:
    assert default_absorbing(Quadratic(), episodes([50]), right, np.random.default_rng(1)) == -1


def test_absorption_pays_what_the_demonstrations_got_where_they_terminate_themselves() -> None:
    demos = episodes([50, 7], terminated=True)
    expected = -(demos.pairs()[1] ** 2).sum(1).mean()
    assert default_absorbing(Quadratic(), demos, uniform, np.random.default_rng(1)) == pytest.approx(expected)


def test_noise_replaces_the_share_of_actions_that_was_asked_for() -> None:
    obs = np.zeros((5000, 3))
    still = lambda obs: np.zeros((len(obs), 2))  # noqa: E731
    act = roughened(still, 0.3, uniform, np.random.default_rng(0))(obs)
    assert act.any(axis=1).mean() == pytest.approx(0.3, abs=0.03)
    assert (act.any(axis=1) == act.all(axis=1)).all()
    assert not roughened(still, 0.0, uniform, np.random.default_rng(0))(obs).any()


def test_rollouts_and_demonstrations_are_seen_alike() -> None:
    demos, rollouts = episodes([3]), episodes([50, 20])
    both = seen_by_both(demos, rollouts, np.random.default_rng(0))
    np.testing.assert_array_equal(both[70:], rollouts.pairs()[0])
    assert {tuple(row) for row in both[:70]} == {tuple(row) for row in demos.pairs()[0]}
