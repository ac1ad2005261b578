"""Gymnasium's CarRacing-v3 in small pictures, and in states for its expert.

A car drives around a closed track that is another one in each episode. Physics, tracks and rewards are
Gymnasium's. An action lasts four of its frames, so an episode has 250 actions at most. The pictures are
drawn by `envs.racing.picture`. Soft Q imitation learning was shown in this task, and at a start that is
turned by 90 degrees (Reddy et al. 2020).
"""

import math
from typing import Any

import gymnasium as gym

from envs import images
from envs.learners import PPO
from envs.racing.driver import AHEAD, Driver
from envs.spec import EnvSpec, Quantity, Shape, register

NO_NUMBERS = {"draw": "It draws pictures."}

OBS_NAMES = (
    Quantity("forward speed", "m/s"),
    Quantity("leftward speed", "m/s"),
    Quantity("yaw rate", "rad/s"),
    Quantity("angle of the front wheels to the left", "rad"),
    Quantity("offset to the left of the road's centre", "m"),
    *(Quantity(f"road {ahead:g} m on, {way}", "m") for ahead in AHEAD for way in ("ahead", "to the left")),
)
NUMBERS = {
    Quantity("speed", "m/s"): 40.0,
    **{
        Quantity(f"rate of the {end} {side} wheel", "rad/s"): 80.0
        for end in ("front", "rear")
        for side in ("left", "right")
    },
    Quantity("angle of the front wheels to the left", "rad"): 0.2,
    Quantity("yaw rate", "rad/s"): 1.0,
}
"""Numbers beside a picture, those of the bar in Gymnasium's, with their typical sizes. Its score is left out,
because it is the true reward."""


def view(count: int, **changed: Any) -> images.View:
    """Return copies in pictures. Raises DependencyNotInstalled without Box2D."""
    from envs.racing.picture import View

    return View(count, **changed)


def draw(env: gym.Env[Any, Any]) -> dict[str, Shape]:
    """Return a view from above, with the road's edges and the car."""
    inner: Any = env.unwrapped
    drawing: dict[str, Shape] = inner.scene()
    return drawing


def why_ended(env: gym.Env[Any, Any]) -> str:
    """Return why an episode terminated."""
    inner: Any = env.unwrapped
    return str(inner.ending)


STATES = EnvSpec(
    name="carracing_state",
    env_id="irl_bench_bare/CarRacingState-v0",
    obs_size=len(OBS_NAMES),
    act_size=3,
    obs_names=OBS_NAMES,
    act_names=(Quantity("steering to the right"), Quantity("gas"), Quantity("brake")),
    obs_scale=(40.0, 5.0, 1.0, 0.2, 3.0, *(size for ahead in AHEAD for size in (ahead, ahead / 2))),
    horizon=250,
    time_step=0.08,
    bar=lambda seeds: 850.0,
    rl_steps={"smoke": 2048, "quick": 40_960, "full": 204_800},
    solves={"smoke": 1, "quick": 1, "full": 2},
    eval_episodes={"smoke": 5, "quick": 20, "full": 50},
    demo_episodes={"smoke": 5, "quick": 20, "full": 20},
    draw=draw,
    why_ended=why_ended,
    rl=PPO(
        copies=16,
        steps=64,
        batch=256,
        std=0.5,
        learning_rate=1e-3,
        final_learning_rate=0.0,
        checkpoint_every=10_240,
        check_episodes=5,
    ),
    variants={"turned": {"turn": math.pi / 2}, "slippery": {"friction": 0.8}},
    controller=Driver(),
)
"""Task of the expert, which sees states."""
register(STATES, "envs.racing.environment:Racing")

SPEC = images.seen(
    STATES,
    "carracing",
    view,
    NUMBERS,
    summary="Gymnasium's CarRacing-v3 in 48 by 48 pixels: drive a lap of a new track within 20 s",
)
"""A tile of the track pays 1000 / N as a wheel first touches it, where the track has N, and each frame costs
0.1. An episode ends when the lap is complete, and far off the track, which costs 100.

Of 20 demonstrations `bc` returns 860 to 904 on three seeds, where the expert returns 894 to 907. With the
start turned it returns -93, 519 and -93 (`results/studies/carracing.csv`, five episodes a seed). Reddy et al.
2020 have 698 and -45, and 704 and 480 for their expert. Their SQIL has 704 and 375. Ours has -44 to 116 and
-93 after 8,000 actions, which are few, and sees features that are not learned."""
