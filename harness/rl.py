"""Reinforcement learning for every purpose here: the expert, inner loops, and pi_R. The only file that
knows the RL library (DDPG of Stable-Baselines3).

Protocol `absorbing` (Kostrikov et al. 2019, Discriminator-Actor-Critic): observations carry an absorbing
indicator; what would terminate goes to the absorbing state instead, stays there a few steps, and is
truncated and bootstrapped like a time limit. The agent learns on reward - reward.absorbing, so that the
absorbing state pays 0 and a constant reward is 0 everywhere. Protocol `native`: episodes end.

One rule says which checkpoint counts, for all: the best mean undiscounted return under the very reward
that the agent learns from, over a fixed number of fresh episodes up to the horizon; the latest of equals.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import gymnasium as gym
import numpy as np
import torch
from gymnasium import spaces
from stable_baselines3 import DDPG
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.noise import NormalActionNoise

from envs import EnvSpec
from harness.simulator import Simulator, Trajectory
from methods.base import Array, Policy, Reward
from methods.network import Network

ABSORBING_STEPS = 5
WARM_UP = 1000


@dataclass(frozen=True)
class Settings:
    """Hyper-parameters of DDPG; the same for the expert, inner loops and pi_R in one environment."""

    net: tuple[int, ...] = (64, 64)
    learning_rate: float = 1e-3
    tau: float = 0.02
    batch: int = 128
    noise: float = 0.3
    gamma: float = 0.99
    every: int = 1
    reward_scale: float = 0.1
    checkpoints: int = 10
    check_episodes: int = 10


SETTINGS: dict[str, Settings] = {}
