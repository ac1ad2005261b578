"""PPO (Schulman et al. 2017) by the RL libraries. Its actor's mean ends in a tanh, as other learners' actors
do; rewards are scaled by the deviation of their discounted sums, as is usual in the libraries."""

from __future__ import annotations

from typing import Any

import flax.linen as nn
import jax.numpy as jnp
import numpy as np
import sbx
import stable_baselines3 as sb3
import tensorflow_probability.substrates.jax as tfp
import torch
from sbx.ppo.policies import Actor
from stable_baselines3.common.running_mean_std import RunningMeanStd
from stable_baselines3.common.vec_env import VecNormalize

from envs.learners import PPO
from harness.learn.training_env import TrainingEnv
from harness.registry import Library
from methods.network import ADAM

FIRST_ACTIONS = 0.01
"""Size of an untrained actor's last weights, as Stable-Baselines3 draws them."""
EPSILON = 1e-5  # of Adam, as in the libraries


class TanhActor(Actor):
    """SBX's, whose mean is a tanh."""

    @nn.compact
    def __call__(self, x: jnp.ndarray) -> Any:
        for units in self.net_arch:
            x = self.activation_fn(nn.Dense(units)(x))
        first = nn.initializers.orthogonal(FIRST_ACTIONS)
        mean = jnp.tanh(nn.Dense(self.action_dim, kernel_init=first)(x))
        log_std = self.param("log_std", nn.initializers.zeros, (self.action_dim,))
        return tfp.distributions.MultivariateNormalDiag(mean, jnp.exp(log_std))


def ppo(s: PPO, library: Library, env: TrainingEnv, common: dict[str, Any]) -> sbx.PPO | sb3.PPO:
    """An untrained model. common: what it is made with besides."""
    common = common | {
        "env": VecNormalize(env, norm_obs=False, gamma=env.spec.gamma),
        "n_steps": s.steps,
        "n_epochs": s.epochs,
        "gae_lambda": s.gae_lambda,
    }
    network: dict[str, Any] = {"net_arch": list(s.net)}
    if library == "sbx":
        network |= {"activation_fn": nn.relu, "actor_class": TanhActor}
        return sbx.PPO(**common, policy_kwargs=network)
    network |= {"activation_fn": torch.nn.ReLU, "optimizer_kwargs": ADAM | {"eps": EPSILON}}
    model = sb3.PPO(**common, policy_kwargs=network)
    model.policy.action_net = torch.nn.Sequential(model.policy.action_net, torch.nn.Tanh())
    return model


def forget_rewards(model: sbx.PPO | sb3.PPO) -> None:
    """Has it scale rewards by those to come alone."""
    env = model.get_vec_normalize_env()
    assert env is not None
    env.ret_rms = RunningMeanStd(shape=())
    env.returns = np.zeros(env.num_envs)


def explore(model: sbx.PPO | sb3.PPO, noise: float) -> None:
    """Has it explore by so much at least: after it has learned it hardly does, and another reward may ask for
    other actions."""
    least = np.log(noise)
    if isinstance(model, sb3.PPO):
        model.policy.log_std.data.clamp_(min=least)
        return
    state = model.policy.actor_state
    params = state.params["params"]
    params = {"params": {**params, "log_std": jnp.maximum(params["log_std"], least)}}
    model.policy.actor_state = state.replace(params=params)


def layers(model: sb3.PPO) -> torch.nn.Module:
    """The actor's."""
    return torch.nn.ModuleList([model.policy.mlp_extractor.policy_net, model.policy.action_net])
