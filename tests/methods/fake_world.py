"""A world without dynamics that answers at once: for what methods compute themselves."""

import numpy as np

from methods.base import Episodes, Policy, Reward


class FakeWorld:
    """Observations are uniform noise (3,), actions (2,); `solve` picks the best of some constant policies."""

    obs_size, act_size, horizon, gamma = 3, 2, 10, 0.9

    def __init__(self) -> None:
        self.solves: list[Reward] = []

    def phi(self, obs: np.ndarray, act: np.ndarray) -> np.ndarray:
        return np.concatenate([act, np.ones((len(act), 1))], axis=1)

    def rollout(self, policy: Policy, episodes: int, rng: np.random.Generator) -> Episodes:
        obs = tuple(rng.uniform(-1, 1, (self.horizon + 1, 3)) for _ in range(episodes))
        return Episodes(obs, tuple(policy(o[:-1]) for o in obs), (False,) * episodes)

    def solve(self, reward: Reward, rng: np.random.Generator, steps: int, warm: bool = False) -> Policy:
        self.solves.append(reward)
        obs = rng.uniform(-1, 1, (64, 3))
        choices = rng.uniform(-1, 1, (500, 2))
        values = [reward(obs, np.tile(c, (64, 1)), obs).mean() for c in choices]
        best = choices[int(np.argmax(values))]
        return lambda o: np.tile(best, (len(o), 1))
