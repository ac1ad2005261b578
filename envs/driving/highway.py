"""Highway driving: three lanes, an ego that steers and accelerates, and highway-env's traffic.

The physics and the traffic, IDM drivers who change lanes, are highway-env's, compiled by JAX for many scenes
at once (`envs.driving.traffic`). The configuration, `CONFIG`, is chosen here. Actions come every 0.4 s,
observations tell of the ego and of the gaps in its lane and the next ones, and the reward is of speed only.
Crashing and leaving the road are worth less than anything else.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from gymnasium.utils import seeding
from numpy.typing import NDArray

from envs.driving.scene import (
    CRASH,
    CRUISE,
    DELTAS,
    DRIFT,
    DT,
    EGO_SPACING,
    EGO_SPEED,
    EGO_SPEEDS,
    FAST,
    FRAMES,
    LANE_WIDTH,
    LANES,
    LENGTH,
    LONG,
    PEDAL,
    SPEEDS,
    SPREADS,
    WHEEL,
    WIDE,
    WIDTH,
    Scene,
    first_scene,
    in_line,
)
from envs.dynamics import Draws, namespace
from envs.learners import DDPG, SMALL_PPO
from envs.spec import Array, EnvSpec, Quantity, Shape, Shipped

NO_NUMBERS = {"draw": "It draws pictures.", "CONFIG": "Tests compare with it."}

Ints = NDArray[np.int64]

HORIZON = 75  # 30 s
TIME_STEP = DT * FRAMES  # s
VEHICLES = 12  # besides the ego
BLOCK = 64
"""Scenes in a compiled step: always the same, so that a scene's bits depend on no other and on no number."""
TARGET_SPEED, IDM_DELTA = 30.0, 4.0  # m/s, and the exponent, of the reference driver
OBS_SIZE = 18
MARGIN = 20.0  # m, of drawn road before the last and after the first vehicle
OBS_NAMES = (
    Quantity("offset from the middle of the road", f"{WIDE:g} m"),
    Quantity("offset from the middle of the lane", "m"),
    Quantity("lateral speed", f"{DRIFT:g} m/s"),
    Quantity(f"forward speed less {CRUISE:g} m/s", f"{FAST:g} m/s"),
    *(Quantity(f"free to the {side}", f"{WIDE:g} m") for side in ("left", "right")),
    *(
        quantity
        for lane in ("left", "own", "right")
        for where in ("ahead", "behind")
        for quantity in (
            Quantity(f"gap {where} in the {lane} lane", f"{LONG:g} m"),
            Quantity(f"relative speed {where} in the {lane} lane", f"{FAST:g} m/s"),
        )
    ),
)
CONFIG: dict[str, Any] = {
    "observation": {"type": "Kinematics"},  # which nobody looks at
    "action": {
        "type": "ContinuousAction",
        "acceleration_range": [-PEDAL, PEDAL],
        "steering_range": [-WHEEL, WHEEL],
        "speed_range": [*EGO_SPEEDS],
    },
    "lanes_count": LANES,
    "vehicles_count": VEHICLES,
    "vehicles_density": 1.0,
    "ego_spacing": EGO_SPACING,
    "simulation_frequency": 1 / DT,
    "policy_frequency": 1 / TIME_STEP,
    # highway-env sums up time in floats; Gymnasium's time limit counts steps.
    "duration": 10 * HORIZON,
    "offroad_terminal": True,
    "normalize_reward": False,
    "high_speed_reward": 1.0,
    "reward_speed_range": [*EGO_SPEEDS],
    "right_lane_reward": 0.0,
    "collision_reward": CRASH,
}
"""Configuration of the same task in highway-env (`HighwayEnvFast`)."""


@dataclass(frozen=True)
class Traffic:
    """The task's dynamics (`envs.dynamics.Dynamics`), of JAX's arrays alone. A state is the rows of a scene,
    one after the other."""

    vehicles: int = VEHICLES
    """Besides the ego."""
    density: float = 1.0
    """Of vehicles, 1 is highway-env's."""
    act_size = 2
    bounds = (50.0,) * OBS_SIZE

    def first(self, rng: np.random.Generator) -> Array:
        """Return a first scene (12, 1 + vehicles), as highway-env draws it."""
        return first_scene(rng, self.vehicles, self.density)

    def start(self, draws: Draws) -> Any:
        low, high = np.transpose([(0, LANES), SPEEDS, SPREADS, DELTAS])[..., None]
        one = np.ones(1 + self.vehicles)
        lane, speed, spread, delta = draws.uniform(low * one, high * one)
        xp, ego = namespace(lane), np.arange(len(one)) == 0
        speed, delta = xp.where(ego, EGO_SPEED, speed), xp.where(ego, 0.0, delta)
        return in_line(xp.floor(lane), speed, spread, delta, self.density).ravel()

    def advance(self, state: Any, act: Any) -> Any:
        from envs.driving import traffic

        return _columns(traffic.step(_rows(state), act.T))

    def observe(self, state: Any) -> Any:
        from envs.driving import traffic

        return traffic.observe(_rows(state)).T

    def pay(self, state: Any, act: Any, after: Any) -> Any:
        from envs.driving import traffic

        return traffic.judge(_rows(after))[0]

    def fails(self, state: Any) -> Any:
        from envs.driving import traffic

        return traffic.judge(_rows(state))[1]

    def failure(self, state: Array) -> str:
        return "crashed" if Scene(*state.reshape(len(Scene._fields), -1)).crashed[0] else "left the road"


def _rows(state: Any) -> Any:
    """Return states (S, B) as those of traffic, (B, 12, N)."""
    return state.T.reshape(state.shape[1], len(Scene._fields), -1)


def _columns(states: Any) -> Any:
    return states.reshape(len(states), -1).T


NOMINAL = Traffic()


class Highway(gym.Env[NDArray[np.float32], NDArray[np.float32]]):
    """Observation (18,): of the ego the offset from the road's middle and from its lane's (4 m, 1 m),
    lateral speed (1 m/s), forward speed less 25 m/s (5 m/s), and the distance to the left and to the right
    (4 m, up to 8 m) of the road's edge or of a vehicle that is beside the ego or would be in a second;
    then for the left, its own and the right lane, each centred on the ego, the free gap ahead, the relative
    speed of who is there, the free gap behind, the relative speed of who is there (20 m, up to 60 m;
    5 m/s). Zeros for a lane that is not there.

    Action (2,) in [-1, 1]: acceleration and steering. Terminates on a crash or off the road.
    Reward: forward speed from 10 to 25 m/s mapped to [0, 1], less 25 on crashing, 0 off the road.
    """

    def __init__(self, physics: Traffic) -> None:
        self.physics = physics
        bounds = np.array(physics.bounds, np.float32)
        self.observation_space = spaces.Box(-bounds, bounds)
        self.action_space = spaces.Box(-1.0, 1.0, (physics.act_size,), np.float32)
        self.state = np.empty((0, 0))

    @property
    def scene(self) -> Scene:
        """The scene as it stands: its parts (1 + vehicles,) can be written to."""
        return Scene(*self.state)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.float32], dict[str, Any]]:
        super().reset(seed=seed, options=options)
        self.state = self.physics.first(self.np_random)
        obs: NDArray[np.float32] = look(self.state[None])[0]
        return obs, {}

    def step(
        self, action: NDArray[np.float32]
    ) -> tuple[NDArray[np.float32], float, bool, bool, dict[str, Any]]:
        (obs,), (reward,), (terminated,) = drive(self.state[None], np.zeros(1, np.int64), action[None])
        return obs, float(reward), bool(terminated), False, {"crashed": bool(self.scene.crashed[0])}


def first_states(seeds: Sequence[int], physics: Traffic = NOMINAL) -> Array:
    """Return the states (R, 12, 1 + vehicles) in which the episodes of these seeds begin."""
    return np.array([physics.first(seeding.np_random(seed)[0]) for seed in seeds])


def look(states: Array) -> NDArray[np.float32]:
    """Return what the egos of states (R, 12, N) see (R, 18)."""
    (obs,) = _in_blocks("look", states)
    return obs


def drive(states: Array, places: Ints, act: NDArray[Any]) -> tuple[NDArray[np.float32], Array, NDArray[Any]]:
    """Step the states (R, 12, N) at `places`, in place, by actions (B, 2). Return observations (B, 18),
    rewards (B,), and whether each episode terminated."""
    states[places], obs, rewards, terminated = _in_blocks("drive", states[places], act.astype(np.float32))
    return obs, rewards, terminated


def _in_blocks(program: str, *given: NDArray[Any]) -> list[NDArray[Any]]:
    """Return what a compiled program makes of arrays, as many rows at once as it is compiled for."""
    import jax

    count = len(given[0])
    if count % BLOCK:  # filled up with the first rows again
        given = tuple(np.resize(its, (count + -count % BLOCK, *its.shape[1:])) for its in given)
    parts = []
    with jax.enable_x64(True):
        for row in range(0, count, BLOCK):
            made = _programs()[program](*(its[row : row + BLOCK] for its in given))
            parts.append([np.asarray(its) for its in made])
    whole = parts[0] if len(parts) == 1 else [np.concatenate(its) for its in zip(*parts, strict=True)]
    return [its[:count] for its in whole]


@functools.cache
def _programs() -> dict[str, Callable[..., Any]]:
    import jax

    from envs.driving import traffic

    def drive(states: Any, act: Any) -> Any:
        states = traffic.step(states, act)
        return states, traffic.observe(states), *traffic.judge(states)

    return {"look": jax.jit(lambda states: (traffic.observe(states),)), "drive": jax.jit(drive)}


class HighwayBatch:
    """Scenes of the task in lockstep (`envs.spec.Batch`)."""

    def __init__(self, count: int, physics: Traffic) -> None:
        self._physics = physics
        self._states = np.zeros((count, len(Scene._fields), 1 + physics.vehicles))

    def reset(self, place: int, seed: int) -> Array:
        first = first_states([seed], self._physics)
        self._states[place] = first[0]
        return np.asarray(look(first)[0], np.float64)

    def step(self, places: Sequence[int], act: Array) -> tuple[Array, Array, NDArray[np.bool_]]:
        obs, rewards, terminated = drive(self._states, np.array(places), act)
        return obs.astype(np.float64), rewards, terminated

    def why_ended(self, place: int) -> str:
        return self._physics.failure(self._states[place])


def idm_return(seeds: Sequence[int]) -> tuple[Array, NDArray[np.bool_]]:
    """Return undiscounted true returns and whether it crashed, for highway-env's own driver (IDM and MOBIL,
    target speed 30 m/s) in the ego's place: the reference that an expert must reach."""
    states = first_states(seeds)
    scene = Scene(*(states[:, i] for i in range(len(Scene._fields))))
    scene.target_speed[:, 0], scene.delta[:, 0] = TARGET_SPEED, IDM_DELTA
    scene.timer[:, 0] = (scene.x[:, 0] + scene.y[:, 0]) * math.pi % 1
    scene.target[:, 0] = scene.lane[:, 0]
    returns, driving = np.zeros(len(states)), np.arange(len(states))
    for _ in range(HORIZON):
        _, rewards, ended = drive(states, driving, np.zeros((len(driving), 2)))
        returns[driving] += rewards
        driving = driving[~ended]
        if not len(driving):
            break
    return returns, scene.crashed[:, 0] > 0


def phi(obs: Array, act: Array) -> Array:
    """(B, 8) in [-1, 1], larger mostly better: forward speed, lane centring, little drift, distance to the
    road's edge, free gap ahead and behind in the own lane, opening speed to whoever is ahead, a constant."""
    edge = LANES / 2 * LANE_WIDTH - np.abs(obs[:, 0]) * WIDE
    features = [
        obs[:, 3] * FAST / 10,
        1 - np.abs(obs[:, 1]),
        1 - np.abs(obs[:, 2]) * DRIFT,
        edge / LANE_WIDTH - 0.5,
        obs[:, 10] * LONG / 20 - 1,
        obs[:, 12] * LONG / 20 - 1,
        obs[:, 11],
        np.ones(len(obs)),
    ]
    clipped: Array = np.clip(np.stack(features, axis=1), -1, 1)
    return clipped


def draw(env: gym.Env[Any, Any]) -> dict[str, Shape]:
    """Return the road from above, the ego at x = 0 driving to the right: edges, dashes between lanes, and
    vehicles as rectangles, each with an arrow as long as its way until the next action."""
    inner = env.unwrapped
    assert isinstance(inner, Highway)
    scene = inner.scene
    shapes = {}
    here = float(scene.x[0])
    along = scene.x - here
    start, end = min(along.min(), -2 * MARGIN) - MARGIN, along.max() + 4 * MARGIN
    for i in range(LANES + 1):
        side = (0.5 - i) * LANE_WIDTH  # highway-env's y points to the right of the road, ours to the left
        if i in (0, LANES):
            shapes[f"lane_{i}"] = Shape(np.array([[start, side], [end, side]]), (140, 140, 140))
            continue
        for dash in range(24):  # which move as the ego passes them
            x = 8.0 * (dash - 8) - here % 8.0
            shapes[f"dash_{i}_{dash:02d}"] = Shape(np.array([[x, side], [x + 3.0, side]]), (190, 190, 190))
    for i in (*range(1, len(scene.x)), 0):
        name, colour = (f"vehicle_{i:02d}", (66, 133, 244)) if i else ("ego", (234, 134, 51))
        ahead = np.array([scene.cos[i], -scene.sin[i]])
        left, middle = np.array([-ahead[1], ahead[0]]), np.array([along[i], -scene.y[i]])
        corners = [(-1, 1), (-1, -1), (1, -1), (1, 1), (-1, 1)]
        sides = [middle + a * LENGTH / 2 * ahead + b * WIDTH / 2 * left for a, b in corners]
        shapes[name] = Shape(np.array(sides), colour)
        nose = middle + LENGTH / 2 * ahead
        tip, across = nose + scene.speed[i] * TIME_STEP * ahead, 0.5 * left
        head = [tip - ahead + across, tip, tip - ahead - across]
        shapes[f"{name}_speed"] = Shape(np.array([nose, tip, *head]), colour)
    return shapes


def why_ended(env: gym.Env[Any, Any]) -> str:
    """Return 'crashed' or 'left the road'."""
    inner = env.unwrapped
    assert isinstance(inner, Highway)
    return inner.physics.failure(inner.state)


THESIS = DDPG(
    final_learning_rate=5e-5,
    tau=0.005,
    batch=256,
    critics=2,
    noise=0.15,
    copies=40,
    gradient_steps=20,
    checkpoint_every=4000,
    check_episodes=40,
)
"""The learner of the thesis."""

SPEC = EnvSpec(
    name="highway",
    summary="highway-env, three lanes, steering and acceleration: drive fast without crashing for 30 s",
    env_id="irl_bench_bare/Highway-v0",
    obs_size=OBS_SIZE,
    act_size=2,
    obs_names=OBS_NAMES,
    act_names=(Quantity("acceleration", "8 m/s^2"), Quantity("steering", "deg")),
    obs_scale=(1.0,) * OBS_SIZE,
    horizon=HORIZON,
    gamma=0.95,
    time_step=TIME_STEP,
    bar=lambda seeds: float(idm_return(seeds)[0].mean()),
    max_terminated={"smoke": 1.0, "quick": 0.05, "full": 0.02},
    rl_steps={"smoke": 8192, "quick": 122_880, "full": 245_760},
    solves={"smoke": 1, "quick": 1, "full": 5},
    ddpg_steps={"smoke": 600, "quick": 40_000, "full": 60_000},
    eval_episodes={"smoke": 5, "quick": 50, "full": 100},
    demo_episodes={"smoke": 5, "quick": 100, "full": 100},
    phi=phi,
    draw=draw,
    why_ended=why_ended,
    shipped=Shipped(steps=120_000, bar=67.0, terminated=0.01, checkpoint_every=1000, rl=THESIS),
    rl=replace(SMALL_PPO, copies=64, steps=32, batch=512, epochs=8, std=0.6, checkpoint_every=20_480),
    ddpg=THESIS,
    kwargs={"physics": NOMINAL},
    batch=partial(HighwayBatch, physics=NOMINAL),
    # Half as many again on the same stretch of road.
    variants={"dense": {"physics": Traffic(vehicles=18, density=1.5)}},
)
"""Each step pays the forward speed, 0 at 10 m/s and 1 at 25 m/s; a crash costs 25, and off the road a step
pays 0. Either ends the episode. The reference driver is highway-env's IDM with MOBIL's lane changes at a
target speed of 30 m/s: its return on the same episodes is what an expert must reach."""

gym.register(
    SPEC.env_id,
    entry_point="envs.driving.highway:Highway",
    max_episode_steps=HORIZON,
    disable_env_checker=True,
)
