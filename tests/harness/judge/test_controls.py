"""What each control rewards."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from harness.judge.controls import control_reward
from harness.records import CONTROLS
from methods.base import Array, Episodes, Learned
from methods.rewards import default_absorbing
from tests.harness.rewards import Nothing

ZERO = Nothing()


def uniform(count: int, generator: np.random.Generator) -> Array:
    return generator.uniform(-1, 1, (count, 2))


def rng(seed: int = 0) -> np.random.Generator:
    return np.random.default_rng(seed)


def demonstrations(terminated: bool = False) -> Episodes:
    generator = rng(5)
    return Episodes(
        tuple(generator.normal(3, 2, (11, 3)) for _ in range(200)),
        tuple(generator.uniform(-0.2, 0.2, (10, 2)) for _ in range(200)),
        (terminated,) * 200,
    )


def never(*_: object) -> Any:
    raise AssertionError("this control asks for nothing")


def paid(name: str, demos: Any = never, fit: Any = never, seed: int = 0) -> Any:
    """Return a control's reward."""
    return control_reward(name, demos, fit, uniform, rng(seed))


def clone(method: str, demos: Episodes) -> Learned:
    return Learned(lambda obs: np.full((len(obs), 2), 0.1), ZERO)


def test_constant_controls_need_no_demonstrations_and_the_true_reward_has_none() -> None:
    constants = {"control_plus1": (1.0, 1.0), "control_minus1": (-1.0, -1.0), "control_survival": (0.0, -1.0)}
    for name, (alive, absorbing) in constants.items():
        reward = paid(name)
        np.testing.assert_array_equal(reward(np.zeros((4, 3)), np.zeros((4, 2)), np.zeros((4, 3))), alive)
        assert reward.absorbing == absorbing
    nothing = [name for name in CONTROLS if paid(name, demonstrations, clone) is None]
    assert nothing == ["control_true"]


@pytest.mark.parametrize("terminated", [False, True])
def test_the_untrained_control_is_drawn_by_seed_and_pays_nothing_on_average_above_absorption(
    terminated: bool,
) -> None:
    demos = demonstrations(terminated)
    one, same, other = (paid("control_untrained", lambda: demos, seed=seed) for seed in (0, 0, 1))
    obs, act = demos.pairs()
    np.testing.assert_array_equal(one(obs, act, obs), same(obs, act, obs))
    assert (one(obs, act, obs) != other(obs, act, obs)).any()
    if terminated:  # absorption pays what the demonstrated pairs do
        assert one.absorbing == pytest.approx(one(obs, act, obs).mean())
        return
    obs = np.tile(obs, (10, 1))
    above = one(obs, rng(9).uniform(-1, 1, (len(obs), 2)), obs) - one.absorbing
    assert above.std() > 1e-3
    # The absorbing value was estimated from 2000 pairs.
    assert abs(above.mean()) < 4 * above.std() / np.sqrt(2000)


def test_the_clone_control_pays_for_being_near_what_cloning_does() -> None:
    demos, asked = demonstrations(), list[tuple[str, Episodes]]()

    def fit(method: str, shown: Episodes) -> Learned:
        asked.append((method, shown))
        return clone(method, shown)

    reward = paid("control_clone", lambda: demos, fit)
    assert asked == [("bc", demos)]
    obs, act = demos.pairs()
    np.testing.assert_allclose(reward(obs, act, obs), -np.square(act - 0.1).sum(axis=1))
    assert reward.absorbing == default_absorbing(reward, demos, uniform, rng())


def test_the_shuffled_control_imitates_actions_taken_elsewhere() -> None:
    generator = rng(5)
    demos = Episodes(
        tuple(generator.normal(size=(length + 1, 3)) for length in (100, 3, 40)),
        tuple(generator.uniform(-1, 1, (length, 2)) for length in (100, 3, 40)),
        (False, True, False),
    )
    seen: list[Episodes] = []

    def fit(method: str, shuffled: Episodes) -> Learned:
        assert method == "shaped"
        seen.append(shuffled)
        return Learned(lambda obs: obs, ZERO)

    for seed in (0, 0, 1):
        assert paid("control_shuffled", lambda: demos, fit, seed) is ZERO
    one, same, other = (episodes.pairs()[1] for episodes in seen)
    assert (seen[0].obs, seen[0].terminated) == (demos.obs, demos.terminated)
    act = demos.pairs()[1]
    assert (one == act).all(axis=1).mean() < 0.1
    assert set(map(tuple, one)) == set(map(tuple, act))
    np.testing.assert_array_equal(one, same)
    assert (one != other).any()
