import copy

import gymnasium as gym
import numpy as np
import pytest

from envs.balancing.pendulum import NOMINAL, RAIL, SPEC, Pendulum, PendulumBatch, Physics

PHYSICS = [NOMINAL, *(made_with["physics"] for made_with in SPEC.variants.values())]


def test_it_is_gymnasiums_with_scaled_actions() -> None:
    ours, theirs = SPEC.make(), gym.make("InvertedPendulum-v5")
    rng = np.random.default_rng(0)
    for seed in range(5):
        assert np.array_equal(ours.reset(seed=seed)[0], theirs.reset(seed=seed)[0])
        for _ in range(200):  # against the rail's ends too
            action = rng.uniform(-1, 1, 1).astype(np.float32)
            obs, reward, terminated, truncated, _ = ours.step(action)
            expected = theirs.step(3 * action)
            assert np.array_equal(obs, expected[0])
            assert (reward, terminated, truncated) == expected[1:4]


@pytest.mark.parametrize("physics", [*PHYSICS, Physics(gear=1000.0), Physics(pole_length=0.05)])
def test_pendulums_in_lockstep_are_those_alone_against_the_rails_ends_too(physics: Physics) -> None:
    """Where the solver iterates, what it begins at decides the last bits."""
    ours, theirs = PendulumBatch(3, physics), [Pendulum(physics) for _ in range(3)]
    for place, env in enumerate(theirs):
        assert np.array_equal(ours.reset(place, place), env.reset(seed=place)[0])
    rng, farthest = np.random.default_rng(0), 0.0
    for step in range(300):
        places = [0, 1, 2] if step % 7 else [2, 0]
        act = rng.uniform(-0.2, 1, (len(places), 1)) * (1 if step % 100 < 50 else -1)
        obs, _, fell = ours.step(places, act)
        for row, place in enumerate(places):
            expected = theirs[place].step(act[row].astype(np.float32))
            assert np.array_equal(obs[row], expected[0])
            assert fell[row] == expected[2]
        farthest = max(farthest, np.abs(obs[:, 0]).max())
    assert farthest > RAIL


@pytest.mark.parametrize("physics", PHYSICS)
def test_the_pole_is_a_capsule_of_its_length_and_density(physics: Physics) -> None:
    env = Pendulum(physics)
    radius, length = 0.049, np.hypot(0.001, physics.pole_length)
    volume = np.pi * radius**2 * (length + 4 / 3 * radius)
    assert env.model.body("pole").mass == pytest.approx(physics.pole_density * volume)
    assert env.model.body("pole").ipos[2] == pytest.approx(physics.pole_length / 2)
    env.reset(seed=0)
    foot, tip = SPEC.draw(env)["pole"].points
    assert np.linalg.norm(tip - foot) == pytest.approx(physics.pole_length)


def test_a_copy_keeps_its_physics() -> None:
    assert copy.deepcopy(Pendulum(Physics(gear=50.0))).physics == Physics(gear=50.0)
