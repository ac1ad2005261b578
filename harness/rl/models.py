"""The models of RL libraries: building them from a task's settings, beginning with a policy, reading actors.

DDPG (Lillicrap et al. 2015), TD3 (Fujimoto et al. 2018) and SAC (Haarnoja et al. 2018) are those of SBX,
Stable-Baselines3 in JAX, or of Stable-Baselines3 itself. DQN (Mnih et al. 2013; thesis, figure 3.2), where
actions are discrete, is the latter's. PPO is ours (`harness.rl.on_policy`), or the latter's, which scales
rewards by the deviation of their discounted sums. All but PPO have n-step returns; SAC's leave out the
entropy of the steps between.
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
from stable_baselines3.common.running_mean_std import RunningMeanStd
from stable_baselines3.common.vec_env import VecNormalize

from envs import EnvSpec
from envs.learners import DDPG, DQN, PPO, SAC, TD3, Learner
from harness.registry import Library
from harness.rl import ppo
from harness.rl.on_policy import OnPolicy
from harness.rl.training_env import REWARD_SIZE, Replay, TrainingEnv
from methods.base import Array, Episodes, Policy, StochasticPolicy
from methods.network import ADAM, Network
from methods.stochastic import SquashedGaussian

OffPolicy = sbx.TD3 | sbx.SAC | sb3.TD3 | sb3.SAC | sb3.DQN
"""Models with a replay buffer. DDPG is a TD3 in both libraries."""
Model = OffPolicy | sb3.PPO | OnPolicy
Layers = Sequence[tuple[Array, Array]]
"""Weights (I, K) and biases (K,) of each layer. SAC's last two are heads: the mean, and the logarithm of the
standard deviation."""
FIRST_ACTIONS = 0.01
"""Size of an untrained actor's last weights, as a share of SBX's."""
_FUNCTIONS: dict[tuple[Learner, int], list[tuple[Any, Any]]] = {}
"""Functions of networks and optimizers, by settings and size of actions: those of the first such agent. JAX
compiles each function once, and would compile and keep every agent's own."""


def build(
    s: Learner,
    library: Library,
    env: TrainingEnv,
    demonstrations: Episodes | None,
    warm_up: int,
    seed: int,
    learning_rate: Callable[[], float],
) -> Model:
    """Return an untrained model, which begins to learn after `warm_up` steps and asks for its learning rate
    at each update. Raises ValueError for PPO with demonstrations."""
    if isinstance(s, PPO) and demonstrations is not None:
        raise ValueError("PPO learns from its own steps alone, and not from demonstrations")
    if isinstance(s, PPO) and library == "sbx":
        return OnPolicy(env, s, seed)
    common: dict[str, Any] = {
        "policy": "MlpPolicy",
        # The library's own progress would be wrong after a warm start.
        "learning_rate": lambda _: learning_rate(),
        "batch_size": s.batch,
        "gamma": env.spec.gamma,
        "seed": seed,
        "device": "cpu",
    }
    if isinstance(s, PPO):
        model: OffPolicy | sb3.PPO = _ppo(s, env, common)
    else:
        replay = {"source": env, "demonstrations": demonstrations, "n_steps": s.n_steps}
        common |= {
            "env": env,
            "learning_starts": warm_up,
            "buffer_size": s.buffer,
            "tau": s.tau,
            "replay_buffer_class": Replay,
            "replay_buffer_kwargs": replay | {"gamma": env.spec.gamma},
            "train_freq": 1,
            "gradient_steps": s.gradient_steps,
        }
        model = _off_policy(s, library, common, env.spec.act_size)
    model.set_logger(Logger(None, []))  # the default one leaves a folder behind
    return model


def _ppo(s: PPO, env: TrainingEnv, common: dict[str, Any]) -> sb3.PPO:
    network = {
        "net_arch": list(s.net),
        "activation_fn": torch.nn.ReLU,
        "log_std_init": float(np.log(s.std)),
        "optimizer_kwargs": ADAM | {"eps": ppo.EPSILON},
    }
    own: dict[str, Any] = {
        "n_steps": s.steps,
        "n_epochs": s.epochs,
        "gae_lambda": s.gae_lambda,
        "clip_range": ppo.CLIP,
    }
    scaled = VecNormalize(env, norm_obs=False, gamma=env.spec.gamma)
    model = sb3.PPO(**common, **own, env=scaled, policy_kwargs=network)
    if not env.spec.discrete:
        model.policy.action_net = torch.nn.Sequential(model.policy.action_net, torch.nn.Tanh())
    return model


def _off_policy(s: DDPG | TD3 | SAC | DQN, library: Library, common: dict[str, Any], size: int) -> OffPolicy:
    """Return a model with a replay buffer. `size`: of actions, A."""
    network: dict[str, Any] = {"net_arch": list(s.net)}
    if isinstance(s, DQN):
        return sb3.DQN(
            # It moves its target network once a bout of learning, not once a gradient step.
            **(common | {"tau": 1 - (1 - s.tau) ** s.gradient_steps}),
            target_update_interval=s.copies,
            exploration_initial_eps=s.noise,
            exploration_final_eps=s.noise,
            policy_kwargs=network | {"optimizer_kwargs": ADAM},
        )
    network["n_critics"] = s.critics
    noise = np.zeros(size), np.full(size, s.noise)
    if isinstance(s, SAC):
        # A learned weight of entropy begins with the size of rewards.
        common["ent_coef"] = f"auto_{REWARD_SIZE}" if s.entropy is None else float(s.entropy)
    elif isinstance(s, DDPG):
        common["action_noise"] = OrnsteinUhlenbeckActionNoise(*noise)
    else:
        common |= {
            "action_noise": NormalActionNoise(*noise),
            "policy_delay": s.policy_delay,
            "target_policy_noise": s.target_noise,
            "target_noise_clip": s.target_noise_clip,
        }
    name = type(s).__name__
    if library == "sbx":
        model: OffPolicy = _jax(s, getattr(sbx, name), common, network, size)
        return model
    network["optimizer_kwargs"] = ADAM
    theirs: sb3.TD3 | sb3.SAC = getattr(sb3, name)(**common, policy_kwargs=network)
    if isinstance(theirs, sb3.SAC) and theirs.log_ent_coef is not None:
        theirs.ent_coef_optimizer = torch.optim.Adam([theirs.log_ent_coef], s.learning_rate, **ADAM)
    return theirs


def _jax(s: DDPG | TD3 | SAC, kind: Any, common: dict[str, Any], network: dict[str, Any], size: int) -> Any:
    if not isinstance(s, SAC):  # whose learning rate is injected by SBX
        network["optimizer_class"] = optax.inject_hyperparams(optax.adam)
    model = kind(**common, qf_learning_rate=None, policy_kwargs=network)
    states = [(model.policy, "actor_state"), (model.policy, "qf_state")]
    if isinstance(s, SAC):
        states.append((model, "ent_coef_state"))
    own = [(getattr(owner, name).apply_fn, getattr(owner, name).tx) for owner, name in states]
    shared = _FUNCTIONS.setdefault((s, size), own)
    for (owner, name), (apply, optimizer) in zip(states, shared, strict=True):
        setattr(owner, name, getattr(owner, name).replace(apply_fn=apply, tx=optimizer))
    # First actions near zero, as in the paper: with SBX's initial weights an untrained agent may balance.
    layers = {**model.policy.actor_state.params["params"]}
    last = f"Dense_{len(s.net)}"
    layers[last] = {**layers[last], "kernel": FIRST_ACTIONS * layers[last]["kernel"]}
    _put(model, layers)
    return model


def _put(model: Any, layers: Mapping[str, Mapping[str, Any]]) -> None:
    """Set the parameters of an actor in JAX, and of its target, where it has one."""
    fields = ("params",) if isinstance(model, sbx.SAC) else ("params", "target_params")
    values = {field: {"params": layers} for field in fields}
    model.policy.actor_state = model.policy.actor_state.replace(**values)


def follow_reward(model: Model, noise: float) -> None:
    """Go on under what its environment pays now, also for the steps that it remembers."""
    if isinstance(model, sb3.PPO):
        env = model.get_vec_normalize_env()
        assert env is not None
        env.ret_rms, env.returns = RunningMeanStd(shape=()), np.zeros(env.num_envs)
        if hasattr(model.policy, "log_std"):
            # After learning it is small, and another reward may need other actions.
            model.policy.log_std.data.clamp_(min=np.log(noise))
    elif not isinstance(model, OnPolicy):
        replay(model).relabel()


def replay(model: Model) -> Replay:
    """Return a model's replay buffer. Raises ValueError where it has none."""
    if isinstance(model, OnPolicy | sb3.PPO):
        raise ValueError("PPO keeps no steps")
    assert isinstance(model.replay_buffer, Replay)
    return model.replay_buffer


def follow_learning_rate(model: Model, rate: float) -> None:
    """Set the learning rate of a model that does not ask for it."""
    if isinstance(model, sbx.TD3):
        for state in (model.policy.actor_state, model.policy.qf_state):
            state.opt_state.hyperparams["learning_rate"] = np.float32(rate)


def actor(model: Model, spec: EnvSpec) -> Network:
    """Return the actor before any tanh, on the environment's own observations (the absorbing indicator is 0).

    Its outputs are (B, A), and SAC's (B, 2A), as `SquashedGaussian` has them. DQN's are values of choices.
    """
    if isinstance(model, OnPolicy):
        return model.network
    scaling = np.zeros(spec.obs_size), np.array(spec.obs_scale)
    if isinstance(model, sbx.TD3 | sbx.SAC):
        net = Network.from_flax(model.policy.actor_state.params["params"], *scaling)
    else:
        layers: Any = model.q_net if isinstance(model, sb3.DQN) else model.policy
        if isinstance(model, sb3.PPO):
            layers = torch.nn.ModuleList([layers.mlp_extractor.policy_net, layers.action_net])
        elif not isinstance(model, sb3.DQN):
            layers = layers.actor
        net = Network.from_torch(layers, *scaling)
    weights, biases = [*net.weights], [*net.biases]
    if isinstance(model, sbx.SAC | sb3.SAC):
        weights[-2:] = [np.concatenate(weights[-2:], axis=1)]
        biases[-2:] = [np.concatenate(biases[-2:])]
    weights[0] = weights[0][: spec.obs_size]
    return replace(net, weights=tuple(weights), biases=tuple(biases))


def actor_layers(init: Policy | StochasticPolicy, spec: EnvSpec, settings: Learner) -> Layers:
    """Return the layers with which the actor is the policy. In the absorbing state it acts as where
    observations are 0. For a policy without a standard deviation SAC's is 1, about its untrained one.

    Raises ValueError where the actor cannot be that policy.
    """
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
        raise ValueError("a policy must end in a tanh, and a stochastic policy's network must not")
    # (x - mean) / std @ W + b = x / scale @ (scale / std * W) + (b - mean / std @ W); it sees x / scale.
    weights, biases = [*net.weights], [*net.biases]
    biases[0] = biases[0] - net.mean / net.std @ weights[0]
    weights[0] = weights[0] * (np.array(spec.obs_scale) / net.std)[:, None]
    weights[0] = np.concatenate([weights[0], np.zeros((1, len(biases[0])))])  # for the absorbing indicator
    if isinstance(settings, SAC):
        for arrays in (weights, biases):
            head = arrays.pop()
            arrays.extend(np.split(head, 2, axis=-1) if stochastic else [head, 0 * head])
    return list(zip(weights, biases, strict=True))


def begin(model: Model, layers: Layers) -> None:
    """Set the actor's layers, and its target's, where it has one."""
    if isinstance(model, sbx.TD3 | sbx.SAC):
        arrays = [{"kernel": w.astype(np.float32), "bias": b.astype(np.float32)} for w, b in layers]
        _put(model, {f"Dense_{i}": layer for i, layer in enumerate(arrays)})
        return
    assert isinstance(model, sb3.TD3 | sb3.SAC)
    linear = [m for m in model.actor.modules() if isinstance(m, torch.nn.Linear)]
    with torch.no_grad():
        for layer, (weight, bias) in zip(linear, layers, strict=True):
            layer.weight.copy_(torch.as_tensor(weight.T))
            layer.bias.copy_(torch.as_tensor(bias))
    if isinstance(model, sb3.TD3):
        model.actor_target.load_state_dict(model.actor.state_dict())
