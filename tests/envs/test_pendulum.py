import gymnasium as gym
import numpy as np

from envs.pendulum import RAIL, SPEC, PendulumBatch


def test_it_is_gymnasiums_with_scaled_actions() -> None:
    ours, theirs = SPEC.make(), gym.make("InvertedPendulum-v5")
    rng = np.random.default_rng(0)
    for seed in range(5):
        assert np.array_equal(ours.reset(seed=seed)[0], theirs.reset(seed=seed)[0])
        terminated = False
        while not terminated:
            action = rng.uniform(-1, 1, 1).astype(np.float32)
            obs, reward, terminated, truncated, _ = ours.step(action)
            expected = theirs.step(3 * action)
            assert np.array_equal(obs, expected[0])
            assert (reward, terminated, truncated) == expected[1:4]


def test_pendulums_in_lockstep_are_gymnasiums_against_the_rails_ends_too() -> None:
    """Where the solver iterates, what it begins at decides the last bits."""
    ours, theirs = PendulumBatch(3), [gym.make("InvertedPendulum-v5").unwrapped for _ in range(3)]
    for place, env in enumerate(theirs):
        assert np.array_equal(ours.reset(place, place), env.reset(seed=place)[0])
    rng, farthest = np.random.default_rng(0), 0.0
    for step in range(300):
        places = [0, 1, 2] if step % 7 else [2, 0]
        act = rng.uniform(-0.2, 1, (len(places), 1)) * (1 if step % 100 < 50 else -1)
        obs, _, fell = ours.step(places, act)
        for row, place in enumerate(places):
            expected = theirs[place].step(3 * act[row].astype(np.float32))
            assert np.array_equal(obs[row], expected[0])
            assert fell[row] == expected[2]
        farthest = max(farthest, np.abs(obs[:, 0]).max())
    assert farthest > RAIL
