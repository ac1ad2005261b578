"""Grid worlds whose model is known exactly, after Ng & Russell 2000 (`grid`) and Levine, Popovic & Koltun
2011, "Nonlinear Inverse Reinforcement Learning with Gaussian Processes" (`objectworld`).

Cell (x, y), x to the right and y up, is state y * size + x. Any action in a state pays the state's reward. So
a return over T steps counts the states at times 0 to T-1.
"""

from dataclasses import dataclass
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from envs.learners import DQN
from envs.models import Tabular
from envs.spec import Array, EnvSpec, Floats, Quantity, Shape, register

NO_NUMBERS = {"draw": "It draws pictures."}

ACTIONS = ("right", "up", "left", "down", "stay")
MOVES = np.array([[1, 0], [0, 1], [-1, 0], [0, -1], [0, 0]])  # cells, one row for each of ACTIONS


@dataclass(frozen=True)
class ObjectWorld(Tabular):
    """A `Tabular` with the states of its M objects, `cells` (M,), and their `inner` and `outer` colours."""

    cells: NDArray[np.int64]
    inner: NDArray[np.int64]
    outer: NDArray[np.int64]


def grid(size: int, slip: float) -> Tabular:
    """Return a grid with reward 1 in the top right corner and 0 elsewhere, and uniform starts.

    Features are one indicator for each state, observations (S, 2) the position from -1 to 1. Ng & Russell's
    grid has size 5 and no `stay`, and slips with probability 0.3.
    """
    model = transitions(size, slip)
    states = len(model)
    reward = np.zeros(states)
    reward[-1] = 1
    return Tabular(model, np.full(states, 1 / states), _scaled(size), reward, np.eye(states))


def objectworld(size: int, objects: int, colours: int, slip: float, rng: np.random.Generator) -> ObjectWorld:
    """Return a grid with objects in distinct random cells, each of random inner and outer colour, and uniform
    starts.

    The reward is 1 nearer than 3 cells to outer colour 0 and nearer than 2 to outer colour 1. It is -1 if
    only the former holds, else 0. Distances are Euclidean, to the nearest such object, or the grid's diagonal
    without one. The paper says "within", and its authors' code means strictly nearer.

    Observations (S, 2 + 2C) are the position, and the distances to the inner, then the outer colours, all
    from -1 to 1. Features (S, 2CN) indicate each distance being less than 1, ..., N cells. They are the
    paper's continuous and discrete features, besides the position.

    The paper has N = 32 and 30 % chance of a *different* random action, which is slip = 0.375 here. Its
    authors' code puts an object in a cell with probability 0.05. Raises ValueError for fewer than two
    colours, no objects, or too many.
    """
    if colours < 2 or not 1 <= objects <= size**2:
        raise ValueError(
            f"objectworld: needs 2 colours or more and 1 to {size**2} objects, not {colours}, {objects}"
        )
    model = transitions(size, slip)
    states = len(model)
    cells = rng.choice(states, objects, replace=False)
    inner, outer = rng.integers(colours, size=(2, objects))
    diagonal = size * np.sqrt(2)
    to_objects = np.linalg.norm(positions(size)[:, None] - positions(size)[cells], axis=2)
    nearest = np.stack(
        [
            np.where(kind == colour, to_objects, diagonal).min(axis=1)
            for kind in (inner, outer)
            for colour in range(colours)
        ],
        axis=1,
    )
    near_0, near_1 = nearest[:, colours] < 3, nearest[:, colours + 1] < 2
    reward = np.where(near_0, np.where(near_1, 1.0, -1.0), 0.0)
    obs = np.concatenate([_scaled(size), (2 * nearest / diagonal - 1).astype(np.float32)], axis=1)
    features = (nearest[:, :, None] < np.arange(1, size + 1)).reshape(states, -1).astype(np.float64)
    start = np.full(states, 1 / states)
    return ObjectWorld(model, start, obs, reward, features, cells, inner, outer)


def positions(size: int) -> NDArray[np.int64]:
    """Return x and y of each state [cells], (S, 2)."""
    y, x = np.divmod(np.arange(size**2), size)
    return np.stack([x, y], axis=1)


def _scaled(size: int) -> Array:
    """Return positions from -1 to 1, (S, 2)."""
    return (2 * positions(size) / (size - 1) - 1).astype(np.float32).astype(np.float64)


def transitions(size: int, slip: float) -> Array:
    """Return transition probabilities (S, A, S). With probability `slip` an action is replaced by a uniform
    one of all five. Moves into a wall stay. Raises ValueError for a size below 2 or a slip outside [0, 1]."""
    if size < 2 or not 0 <= slip <= 1:
        raise ValueError(f"grid: needs a size of 2 or more and a slip in [0, 1], not {size}, {slip}")
    x, y = np.moveaxis(np.clip(positions(size)[:, None] + MOVES, 0, size - 1), 2, 0)
    sure = np.zeros((size**2, len(ACTIONS), size**2))
    np.put_along_axis(sure, (y * size + x)[:, :, None], 1, axis=2)
    model: Array = (1 - slip) * sure + slip * sure.mean(axis=1, keepdims=True)
    return model


class GridWorld(gym.Env[Floats, np.int64]):
    """A `Tabular` as an environment, by default `WORLD`. `state` and `info["state"]` are the state. The
    reward is that of the state before the action. It never terminates."""

    def __init__(self, tabular: Tabular | None = None) -> None:
        self.tabular = tabular or WORLD
        self.action_space = spaces.Discrete(self.tabular.P.shape[1])
        self.observation_space = spaces.Box(-1.0, 1.0, self.tabular.obs.shape[1:], np.float32)
        self.state = 0

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Floats, dict[str, Any]]:
        super().reset(seed=seed)
        return self._arrive(self.tabular.start)

    def step(self, action: np.int64) -> tuple[Floats, float, bool, bool, dict[str, Any]]:
        reward = float(self.tabular.reward[self.state])
        obs, info = self._arrive(self.tabular.P[self.state, action])
        return obs, reward, False, False, info

    def _arrive(self, distribution: Array) -> tuple[Floats, dict[str, Any]]:
        """Draw the next state from probabilities (S,), and return its observation and info."""
        self.state = int(self.np_random.choice(len(distribution), p=distribution))
        return self.tabular.obs[self.state].astype(np.float32), {"state": self.state}


SIZE = 12  # cells
HORIZON = 50
WORLD = objectworld(SIZE, objects=10, colours=2, slip=0.3, rng=np.random.default_rng(0))
COLOURS = {1.0: (120, 190, 120), -1.0: (220, 130, 120), 0.0: (200, 200, 200)}
"""Colour of a cell, by its reward."""


def draw(env: gym.Env[Any, Any]) -> dict[str, Shape]:
    """Return a square for each cell, green for reward 1 and red for -1, and a diamond for the agent."""
    inner: Any = env.unwrapped
    square = 0.46 * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1], [-1, -1]])
    diamond = 0.35 * np.array([[-1, 0], [0, -1], [1, 0], [0, 1], [-1, 0]])
    where = positions(SIZE)
    cells = {
        f"cell_{x}_{y}": Shape(square + np.array([x, y]), COLOURS[float(reward)])
        for (x, y), reward in zip(where, WORLD.reward, strict=True)
    }
    return {**cells, "agent": Shape(diamond + where[inner.state], (66, 133, 244))}


def phi(obs: Array, act: Array) -> Array:
    """Return the features of the states observed, (B, K)."""
    return WORLD.features[WORLD.states(obs)]


SPEC = EnvSpec(
    name="gridworld",
    summary=f"objectworld, {SIZE} by {SIZE} cells: find what pays, avoid what costs; the model is known",
    env_id="irl_bench_bare/GridWorld-v0",
    obs_size=WORLD.obs.shape[1],
    act_size=len(ACTIONS),
    obs_names=(
        *map(Quantity, ("x", "y")),
        *(Quantity(f"distance to {kind} colour {i}") for kind in ("inner", "outer") for i in range(2)),
    ),
    act_names=tuple(map(Quantity, ACTIONS)),
    obs_scale=(1.0,) * WORLD.obs.shape[1],
    horizon=HORIZON,
    gamma=0.95,
    bar=lambda seeds: 0.0,
    max_terminated={"smoke": 0.0, "quick": 0.0, "full": 0.0},
    rl_steps={"smoke": 1, "quick": 1, "full": 1},
    solves={"smoke": 1, "quick": 1, "full": 1},
    eval_episodes={"smoke": 5, "quick": 100, "full": 100},
    phi=phi,
    draw=draw,
    why_ended=lambda env: "",
    discrete=True,
    rl=DQN(),
    tabular=WORLD,
)
"""Ten objects of two inner and two outer colours lie in the cells. A step moves to a neighbour, or stays, and
slips to a random one of these with probability 0.3. A cell pays 1, -1 or 0 by which objects are near. Experts
are exact: the best policy, by value iteration. No episode ends before 50 steps."""

register(SPEC, "envs.gridworld:GridWorld")
