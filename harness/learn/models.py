"""The models of RL libraries: built from a task's settings, begun with a policy, their actors read.

DDPG (Lillicrap et al. 2015), TD3 (Fujimoto et al. 2018) and SAC (Haarnoja et al. 2018) are those of SBX,
Stable-Baselines3 in JAX, or of Stable-Baselines3 itself. DQN (Mnih et al. 2013; thesis, figure 3.2), where
actions are discrete, is the latter's. PPO is ours, or the latter's. All but PPO have n-step returns; SAC's
leave out the entropy of the steps between.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import optax
import sbx
import stable_baselines3 as sb3
import torch
from stable_baselines3.common.logger import Logger
from stable_baselines3.common.noise import NormalActionNoise, OrnsteinUhlenbeckActionNoise

from envs import EnvSpec
from envs.learners import DDPG, DQN, PPO, SAC, TD3, Learner
from harness.learn import on_policy
from harness.learn.on_policy import OnPolicy
from harness.learn.training_env import REWARD_SIZE, Replay, TrainingEnv
from harness.registry import Library
from methods.base import Array, Episodes, Policy, StochasticPolicy
from methods.network import ADAM, Network
from methods.stochastic import SquashedGaussian

OffPolicy = sbx.TD3 | sbx.SAC | sb3.TD3 | sb3.SAC | sb3.DQN
"""DDPG is a TD3 in both libraries."""
Model = OffPolicy | sb3.PPO | OnPolicy
Layers = Sequence[tuple[Array, Array]]
"""Weights (I, K) and biases (K,), the last two of SAC's being its heads: mean and logarithm of the standard
deviation."""
FIRST_ACTIONS = 0.01
"""Size of an untrained actor's last weights, of what SBX draws."""
_FUNCTIONS: dict[tuple[Learner, int], list[tuple[Any, Any]]] = {}
"""Networks' and optimizers' functions, of the first agent with these settings and size of actions. What JAX
compiles for a function it keeps; each agent's own would be compiled, and kept, again."""


def build(
    s: Learner,
    library: Library,
    env: TrainingEnv,
    demonstrations: Episodes | None,
    warm_up: int,
    seed: int,
    learning_rate: Callable[[], float],
) -> Model:
    """An untrained model, which begins to learn after `warm_up` steps, at the rate that is told each time."""
    spec = env.spec
    common: dict[str, Any] = {
        "policy": "MlpPolicy",
        # Of the library's own progress a warm start would begin in the middle.
        "learning_rate": lambda _: learning_rate(),
        "batch_size": s.batch,
        "gamma": spec.gamma,
        "seed": seed,
        "device": "cpu",
    }
    model: OffPolicy | sb3.PPO
    if isinstance(s, PPO):
        if demonstrations is not None:
            raise ValueError("PPO learns from its own steps alone, and not from demonstrations")
        if library == "sbx":
            return OnPolicy(env, s, seed)
        model = on_policy.by_sb3(s, env, common)
    else:
        model = _off_policy(s, library, env, demonstrations, common | {"learning_starts": warm_up})
    model.set_logger(Logger(None, []))  # its own would leave a folder behind
    return model


def _off_policy(
    s: DDPG | TD3 | SAC | DQN,
    library: Library,
    env: TrainingEnv,
    demonstrations: Episodes | None,
    common: dict[str, Any],
) -> OffPolicy:
    size, gamma = env.spec.act_size, env.spec.gamma
    network: dict[str, Any] = {"net_arch": list(s.net)}
    kept = {"n_steps": s.n_steps, "gamma": gamma, "source": env, "demonstrations": demonstrations}
    common |= {
        "env": env,
        "buffer_size": s.buffer,
        "tau": s.tau,
        "replay_buffer_class": Replay,
        "replay_buffer_kwargs": kept,
        "train_freq": 1,
        "gradient_steps": s.gradient_steps,
    }
    if isinstance(s, DQN):
        return sb3.DQN(
            # It moves its target network with every bout of learning, not with every gradient step.
            **(common | {"tau": 1 - (1 - s.tau) ** s.gradient_steps}),
            target_update_interval=s.copies,
            exploration_initial_eps=s.noise,
            exploration_final_eps=s.noise,
            policy_kwargs=network | {"optimizer_kwargs": ADAM},
        )
    network["n_critics"] = s.critics
    common |= _particulars(s, size)
    return _torch(s, common, network) if library == "sb3" else _jax(s, common, network, size)


def _particulars(s: DDPG | TD3 | SAC, size: int) -> dict[str, Any]:
    if isinstance(s, SAC):
        # It begins with the size of rewards.
        return {"ent_coef": f"auto_{REWARD_SIZE}" if s.entropy is None else float(s.entropy)}
    noise = np.zeros(size), np.full(size, s.noise)
    if isinstance(s, DDPG):
        return {"action_noise": OrnsteinUhlenbeckActionNoise(*noise)}
    return {
        "action_noise": NormalActionNoise(*noise),
        "policy_delay": s.policy_delay,
        "target_policy_noise": s.target_noise,
        "target_noise_clip": s.target_noise_clip,
    }


def _torch(s: DDPG | TD3 | SAC, common: dict[str, Any], network: dict[str, Any]) -> sb3.TD3 | sb3.SAC:
    kinds: dict[type[Learner], type[sb3.TD3 | sb3.SAC]] = {DDPG: sb3.DDPG, TD3: sb3.TD3, SAC: sb3.SAC}
    model = kinds[type(s)](**common, policy_kwargs=network | {"optimizer_kwargs": ADAM})
    if isinstance(model, sb3.SAC) and model.log_ent_coef is not None:
        model.ent_coef_optimizer = torch.optim.Adam([model.log_ent_coef], s.learning_rate, **ADAM)
    return model


def _jax(s: DDPG | TD3 | SAC, common: dict[str, Any], network: dict[str, Any], size: int) -> Any:
    if not isinstance(s, SAC):  # which does so itself
        network["optimizer_class"] = optax.inject_hyperparams(optax.adam)
    kinds = {DDPG: sbx.DDPG, TD3: sbx.TD3, SAC: sbx.SAC}
    model = kinds[type(s)](**common, qf_learning_rate=None, policy_kwargs=network)
    states = [(model.policy, "actor_state"), (model.policy, "qf_state")]
    if isinstance(s, SAC):
        states.append((model, "ent_coef_state"))
    _share(s, size, states)
    # First actions near zero, as in the paper: with SBX's initial weights an untrained agent may balance.
    layers = {**model.policy.actor_state.params["params"]}
    last = f"Dense_{len(s.net)}"
    layers[last] = {**layers[last], "kernel": FIRST_ACTIONS * layers[last]["kernel"]}
    _put(model, layers)
    return model


def _share(s: Learner, size: int, states: list[tuple[Any, str]]) -> None:
    """Gives the states, each an attribute, the functions of the first agent with these settings."""
    own = [(getattr(of, name).apply_fn, getattr(of, name).tx) for of, name in states]
    for (of, name), (apply, optimizer) in zip(states, _FUNCTIONS.setdefault((s, size), own), strict=True):
        setattr(of, name, getattr(of, name).replace(apply_fn=apply, tx=optimizer))


def _put(model: Any, layers: Mapping[str, Mapping[str, Any]]) -> None:
    """Gives an actor in JAX these parameters, and its target, where it has one."""
    params = {"params": layers}
    fields = ("params",) if isinstance(model, sbx.SAC) else ("params", "target_params")
    model.policy.actor_state = model.policy.actor_state.replace(**dict.fromkeys(fields, params))


def follow_reward(model: Model, noise: float) -> None:
    """Has it go on under what its environment pays now; what it has seen is paid by that, too."""
    if isinstance(model, sb3.PPO):
        on_policy.forget_rewards(model)
        on_policy.explore(model, noise)
    elif not isinstance(model, OnPolicy):
        replay(model).relabel()


def replay(model: Model) -> Replay:
    """Raises ValueError where it has none."""
    if isinstance(model, OnPolicy | sb3.PPO):
        raise ValueError("PPO keeps no steps")
    assert isinstance(model.replay_buffer, Replay)
    return model.replay_buffer


def follow_learning_rate(model: Model, rate: float) -> None:
    """Has a model learn at the rate from now on; those that ask for it by themselves do."""
    if isinstance(model, sbx.TD3):
        for state in (model.policy.actor_state, model.policy.qf_state):
            state.opt_state.hyperparams["learning_rate"] = np.float32(rate)


def actor(model: Model, spec: EnvSpec) -> Network:
    """What the actor says before any tanh, on the environment's own observations (the absorbing indicator is
    0): (B, A); of SAC (B, 2A), as `SquashedGaussian` has it; of DQN, which has none, values."""
    size = spec.obs_size
    zeros, scale = np.zeros(size), np.array(spec.obs_scale)
    if isinstance(model, OnPolicy):
        return model.network
    if isinstance(model, sbx.TD3 | sbx.SAC):
        net = Network.from_flax(model.policy.actor_state.params["params"], zeros, scale)
    elif isinstance(model, sb3.PPO):
        net = Network.from_torch(on_policy.layers(model), zeros, scale)
    else:
        net = Network.from_torch(model.q_net if isinstance(model, sb3.DQN) else model.actor, zeros, scale)
    weights, biases = [*net.weights], [*net.biases]
    if isinstance(model, sbx.SAC | sb3.SAC):
        weights[-2:] = [np.concatenate(weights[-2:], axis=1)]
        biases[-2:] = [np.concatenate(biases[-2:])]
    weights[0] = weights[0][:size]
    return replace(net, weights=tuple(weights), biases=tuple(biases))


def actor_layers(init: Policy | StochasticPolicy, spec: EnvSpec, settings: Learner) -> Layers:
    """Those with which the actor is the policy, in the absorbing state as where observations are 0; where the
    policy has none, SAC's standard deviation is 1, about what it is untrained. Raises ValueError where the
    actor cannot be that policy."""
    net = init.network if isinstance(init, SquashedGaussian) and isinstance(settings, SAC) else init
    if not isinstance(net, Network) or isinstance(settings, DQN | PPO):
        raise ValueError(f"{type(settings).__name__} cannot begin with a {type(init).__name__}")
    stochastic = net is not init
    sizes = (*map(len, net.weights), len(net.biases[-1]))
    own = (spec.obs_size, *settings.net, spec.act_size * (2 if stochastic else 1))
    shapes = [(*w.shape, *b.shape) for w, b in zip(net.weights, net.biases, strict=True)]
    if shapes != [(before, after, after) for before, after in pairwise(own)]:
        raise ValueError(f"the policy has layers of {sizes}, the actor of {own}")
    if net.tanh == stochastic:
        raise ValueError("a policy must end in a tanh, and what a stochastic one is made of must not")
    # (x - mean) / std @ W + b = x / scale @ (scale / std * W) + (b - mean / std @ W); it sees x / scale.
    weights, biases = [*net.weights], [*net.biases]
    biases[0] = biases[0] - net.mean / net.std @ weights[0]
    weights[0] = weights[0] * (np.array(spec.obs_scale) / net.std)[:, None]
    weights[0] = np.concatenate([weights[0], np.zeros((1, len(biases[0])))])  # of the absorbing indicator
    if isinstance(settings, SAC):
        for arrays in (weights, biases):
            head = arrays.pop()
            arrays.extend(np.split(head, 2, axis=-1) if stochastic else [head, 0 * head])
    return list(zip(weights, biases, strict=True))


def begin(model: Model, layers: Layers) -> None:
    """Gives the actor these layers, and its target, where it has one."""
    if isinstance(model, sbx.TD3 | sbx.SAC):
        named = [{"kernel": w.astype(np.float32), "bias": b.astype(np.float32)} for w, b in layers]
        _put(model, {f"Dense_{i}": layer for i, layer in enumerate(named)})
        return
    assert isinstance(model, sb3.TD3 | sb3.SAC)
    linear = [m for m in model.actor.modules() if isinstance(m, torch.nn.Linear)]
    with torch.no_grad():
        for layer, (weight, bias) in zip(linear, layers, strict=True):
            layer.weight.copy_(torch.as_tensor(weight.T))
            layer.bias.copy_(torch.as_tensor(bias))
    if isinstance(model, sb3.TD3):
        model.actor_target.load_state_dict(model.actor.state_dict())
