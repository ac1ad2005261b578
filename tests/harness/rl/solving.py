"""One solve, and whether two policies are one."""

from __future__ import annotations

from typing import Any

import numpy as np

from envs import EnvSpec
from harness.registry import Library
from harness.rl.solving import Agent, Solution
from methods.network import Network

STEPS = 1500


def solve(
    spec: EnvSpec,
    reward: Any,
    protocol: str = "absorbing",
    steps: int = STEPS,
    seed: int = 0,
    library: Library = "sb3",
) -> Solution:
    """By default with Stable-Baselines3, whose first step takes no seconds of compiling."""
    return Agent(spec, protocol, np.random.default_rng(seed), library).solve(reward, steps)


def same(one: Network, other: Network) -> bool:
    a, b = one.arrays(), other.arrays()
    return all(np.array_equal(a[name], b[name]) for name in a)
