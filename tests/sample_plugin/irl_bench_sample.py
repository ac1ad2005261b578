"""A plug-in as a package: a method that does nothing, and a task of Gymnasium with other gravity."""

from dataclasses import dataclass

import numpy as np

from envs import from_gymnasium
from irl_bench import Episodes, Learned, Network, World


@dataclass(frozen=True)
class Still:
    push: float = 0.0
    """What it does, whatever it observes, in [-1, 1]."""

    def fit(self, demos: Episodes, world: World, rng: np.random.Generator) -> Learned:
        nothing = np.zeros((world.obs_size, world.act_size))
        bias = np.full(world.act_size, self.push)
        policy = Network(np.zeros(world.obs_size), np.ones(world.obs_size), (nothing,), (bias,))
        return Learned(policy, None)


SPEC = from_gymnasium("Pendulum-v1", "slow_swingup", kwargs={"g": 5.0})
