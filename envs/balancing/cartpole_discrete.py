"""Gymnasium's own `CartPole-v1` (Barto, Sutton & Anderson 1983): push the cart left or right."""

from dataclasses import asdict, dataclass
from functools import partial
from typing import Any

import numpy as np
from gymnasium import spaces
from gymnasium.envs.classic_control.cartpole import CartPoleEnv

from envs.balancing import cartpole
from envs.balancing.cartpole import Physics
from envs.dynamics import DynamicsBatch, namespace, why_ended
from envs.learners import DQN, SMALL_PPO
from envs.spec import EnvSpec, Quantity, Shipped, register


@dataclass(frozen=True)
class Choices(Physics):
    """Physics of a cart and pole with two choices: a push to the left, or to the right. Each step pays 1."""

    act_size = 2

    def advance(self, state: Any, act: Any) -> Any:
        return super().advance(state, (act[1] - act[0])[None])

    def pay(self, state: Any, act: Any, after: Any) -> Any:
        return namespace(after).ones_like(after[0])


NOMINAL = Choices()


class DiscreteCartPole(CartPoleEnv):
    """Gymnasium's environment with any physics."""

    def __init__(self, physics: Physics = NOMINAL) -> None:
        super().__init__()
        self.physics = physics
        self.gravity, self.tau, self.force_mag = physics.gravity, physics.time_step, physics.max_force
        self.masscart, self.masspole, self.length = physics.cart_mass, physics.pole_mass, physics.half_length
        self.total_mass, self.polemass_length = self.masspole + self.masscart, self.masspole * self.length
        self.x_threshold, self.theta_threshold_radians = physics.max_x, physics.max_angle
        bounds = np.array(physics.bounds, np.float32)
        self.observation_space = spaces.Box(-bounds, bounds, dtype=np.float32)


SPEC = EnvSpec(
    name="cartpole_discrete",
    summary="Gymnasium's CartPole-v1, two actions: keep the pole upright for 500 steps",
    env_id="irl_bench_bare/CartPoleDiscrete-v0",
    obs_size=4,
    act_size=2,
    obs_names=cartpole.SPEC.obs_names,
    act_names=(Quantity("push left"), Quantity("push right")),
    obs_scale=(1.0, 0.5, 0.05, 0.5),
    horizon=cartpole.HORIZON,
    time_step=NOMINAL.time_step,
    bar=lambda seeds: 495.0,
    rl_steps={"smoke": 4096, "quick": 65_536, "full": 98_304},
    eval_episodes={"smoke": 5, "quick": 100, "full": 100},
    phi=cartpole.phi,
    draw=cartpole.draw,
    why_ended=why_ended,
    shipped=Shipped(steps=60_000, bar=500.0, rl=DQN()),
    discrete=True,
    rl=SMALL_PPO,
    kwargs={"physics": NOMINAL},
    batch=partial(DynamicsBatch, physics=NOMINAL),
    variants={
        name: {"physics": Choices(**asdict(changed["physics"]))}
        for name, changed in cartpole.SPEC.variants.items()
    },
)
"""The cart and pole of `cartpole`, pushed by 10 N to the left or to the right. A step pays 1. An episode ends
where the cart leaves the track or the pole leans by more than 12 degrees."""

register(SPEC, "envs.balancing.cartpole_discrete:DiscreteCartPole")
