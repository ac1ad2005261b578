import gymnasium as gym
import numpy as np

from envs.pendulum import SPEC


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
