"""The contract of tasks, cheap checks first."""

from __future__ import annotations

import warnings
from copy import deepcopy
from functools import partial
from typing import Any

import numpy as np
from gymnasium import spaces
from gymnasium.utils.env_checker import check_env as gymnasium_accepts
from gymnasium.wrappers import TransformObservation

from envs import BUDGETS, EnvSpec
from envs.copies import Copies, alone
from harness.registry.contract.check import Check, expect
from harness.registry.contract.lockstep import assert_together_as_alone
from methods.base import Array

LARGE = 100
"""Observations that features are tried on have this standard deviation."""


def checks(spec: EnvSpec) -> list[Check]:
    """Return the checks of a task, to be called."""
    result = [
        Check("budgets grow", partial(_budgets, spec)),
        Check("actions are scaled and sizes are as said", partial(_sizes, spec)),
        Check("features are bounded", partial(_features, spec)),
        Check("the same seed gives the same episode", partial(_reproducible, spec)),
        Check("drawings keep their names", partial(_drawings, spec)),
        Check("where it terminates it says why", partial(_endings, spec)),
        Check("Gymnasium's own checks accept it", partial(_gymnasium, spec)),
    ]
    if spec.batch:
        together = partial(assert_together_as_alone, spec, min(spec.horizon, 100))
        result.append(Check("copies step together as they do alone", together))
    for name in spec.variants:
        result.append(Check(f"the variant {name} is another task", partial(_variant, spec, name)))
    return result


def play(copy: Copies, seed: int, acts: Array) -> list[Any]:
    """Return the observations and steps of the first copy, in the episode of a seed and actions (T, A)."""
    seen: list[Any] = [copy.reset(0, seed).tolist()]
    for act in acts:
        step = [part[0].tolist() for part in copy.step([0], act[None])]
        seen.append(step)
        if step[-2] or step[-1]:
            break
    return seen


def _random(spec: EnvSpec, seed: int, steps: int) -> Array:
    return spec.random_actions(steps, np.random.default_rng(seed))


def _budgets(spec: EnvSpec) -> None:
    for name in ("rl_steps", "ddpg_steps", "solves", "eval_episodes", "demo_episodes"):
        counts = [getattr(spec, name)[budget] for budget in BUDGETS]
        expect(counts == sorted(counts), f"{name} must not fall from {BUDGETS[0]} on, as {counts} does")


def _sizes(spec: EnvSpec) -> None:
    env = spec.make()
    if spec.discrete:
        expected: spaces.Space[Any] = spaces.Discrete(spec.act_size)
    else:
        expected = spaces.Box(-1.0, 1.0, (spec.act_size,), np.float32)
    expect(env.action_space == expected, f"the action space must be {expected}, not {env.action_space}")
    shape = np.shape(env.reset(seed=0)[0])
    expect(shape == (spec.obs_size,), f"reset must give observations ({spec.obs_size},), not {shape}")


def _features(spec: EnvSpec) -> None:
    rng = np.random.default_rng(2)
    obs = LARGE * rng.standard_normal((200, spec.obs_size))
    features = spec.features(obs, spec.random_actions(200, rng))
    expect(len(features) == 200, f"phi must give a row for each of 200 steps, not {len(features)}")
    largest = np.abs(features).max()
    expect(largest <= 1, f"phi must lie within [-1, 1] whatever is observed, not reach {largest:.3g}")


def _reproducible(spec: EnvSpec) -> None:
    copy, acts = alone(spec), _random(spec, 5, 60)
    first = play(copy, 5, acts)
    expect(play(copy, 5, acts) == first, "an episode of the same seed differs after a reset")
    expect(play(alone(spec), 5, acts) == first, "an episode of the same seed differs in another copy")
    other = play(copy, 6, _random(spec, 6, 60))
    expect(other != first, "episodes of two seeds are the same")


def _drawings(spec: EnvSpec) -> None:
    env = spec.make()
    env.reset(seed=1)
    before = deepcopy(spec.draw(env))
    env.step(spec.native(np.ones(spec.act_size)))
    after = spec.draw(env)
    changed = sorted(before.keys() ^ after.keys())
    expect(not changed, f"a drawing must have the same names throughout; these come or go: {changed}")
    odd = [name for name in before if not name.isidentifier()]
    expect(not odd, f"names of shapes must be identifiers, not {odd}")
    for name, shape in after.items():
        flat = shape.points.ndim == 2 and shape.points.shape[1] == 2 and np.isfinite(shape.points).all()
        expect(flat, f"the points of {name!r} must be finite, (P, 2), not {shape.points.shape}")
    moved = any(not np.array_equal(before[name].points, after[name].points) for name in before)
    expect(moved or not before, "nothing that is drawn moves")


def _endings(spec: EnvSpec) -> None:
    env = spec.make()
    for seed in range(5):
        env.reset(seed=seed)
        terminated = truncated = False
        for _ in range(spec.horizon):
            _, _, terminated, truncated, _ = env.step(spec.native(np.ones(spec.act_size)))
            if terminated or truncated:
                break
        expect(terminated or truncated, f"an episode goes on after the horizon of {spec.horizon} steps")
        if terminated:
            expect(spec.tabular is None, "a known model has no terminal states, but an episode terminated")
            expect(spec.why_ended(env), "why_ended must say in a few words why an episode terminated")
            return


def _gymnasium(spec: EnvSpec) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # of unbounded observations, which are allowed
        env = spec.make()
        # Copied, for some tasks write the next observation into the same array, which is allowed here.
        copied = TransformObservation(env, np.array, env.observation_space)
        gymnasium_accepts(copied, skip_render_check=True)


def _variant(spec: EnvSpec, name: str) -> None:
    variant = spec.variant(name)
    pushes = np.tile(spec.executed(np.ones((1, spec.act_size))), (50, 1))
    both = [[play(alone(one), 0, acts) for acts in (_random(spec, 0, 20), pushes)] for one in (spec, variant)]
    expect(both[0] != both[1], f"in the variant {name} everything is as in the task itself")
