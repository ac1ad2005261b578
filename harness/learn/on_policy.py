"""An agent that learns by PPO: ours (`harness.learn.ppo`), and that of Stable-Baselines3, which ours is
checked against. There rewards are scaled by the deviation of their discounted sums, as is usual."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import stable_baselines3 as sb3
import torch
from gymnasium import spaces
from stable_baselines3.common.running_mean_std import RunningMeanStd
from stable_baselines3.common.vec_env import VecNormalize

from envs import EnvSpec
from envs.dynamics import Dynamics
from envs.learners import PPO
from harness.learn import ppo
from harness.learn.ppo import Kind, Steps
from harness.learn.seeds import training_seeds
from harness.learn.training_env import TrainingEnv
from methods.base import Array, Transitions
from methods.network import ADAM, Network
from methods.stochastic import Gaussian, Softmax

REWARD_SIZE = 0.3
"""Mean absolute reward of the first bout after scaling; the scale is kept until the reward changes."""


class OnPolicy:
    """PPO in one environment, of which it steps the copies and asks what steps pay."""

    def __init__(self, env: TrainingEnv, settings: PPO, seed: int) -> None:
        spec = env.spec
        self._env, self._settings = env, settings
        kind = Kind(settings, spec.obs_size, spec.act_size, spec.discrete, spec.gamma)
        self._functions = ppo.functions(kind)
        self._scale = np.array(spec.obs_scale, np.float32)
        self.set_random_seed(seed)
        self._state = self._functions.begin(self._next_key())
        physics = dynamics_of(spec)
        self._uniform = -np.log(spec.act_size) if spec.discrete else -spec.act_size * np.log(2)
        self.latest: Transitions
        """The steps of the latest bout."""
        self._collect: _Compiled | _Stepped = (
            _Stepped(kind, env) if physics is None else _Compiled(kind, physics, spec, self._next_key())
        )

    def set_random_seed(self, seed: int) -> None:
        self._key = jax.random.key(seed)

    def learn(
        self, steps: int, rate: Callable[[float], float], done: Callable[[int], None], entropy: float
    ) -> None:
        """Learn for a number of environment steps, beginning with the settings' noise at least.

        rate: gives the learning rate of a share of the steps, that in the middle of each bout. done: called
        with the number of steps after each bout. entropy: what a nat of it is worth to the agent, the
        entropy of uniform actions being 0.
        """
        s, size = self._settings, 0.0
        params = self._state.params
        if "log_std" in params:
            least = jnp.maximum(params["log_std"], np.float32(np.log(s.noise)))
            self._state = self._state._replace(params={**params, "log_std": least})
        for taken in range(s.unit, steps + 1, s.unit):
            seen = self._collect(self._state.params, self._scale, self._next_key())
            true = np.asarray(seen.true, np.float64).ravel()
            self.latest = _transitions(self._env.spec, seen)
            paid = self._env.paid(self.latest, true)
            if entropy:
                log_prob = np.asarray(seen.log_prob, np.float64).ravel()
                paid = paid - entropy * (log_prob - self._uniform)
            if taken == s.unit:
                size = max(float(np.abs(paid).mean()) / REWARD_SIZE, 1e-9)
            rewards = (paid / size).reshape(s.steps, s.copies).astype(np.float32)
            now = np.float32(rate((taken - s.unit / 2) / steps))
            self._state = self._functions.learn(
                self._state, seen, rewards, self._scale, now, self._next_key()
            )
            done(taken)

    @property
    def behaviour(self) -> Gaussian | Softmax:
        """The policy that it explores with."""
        if self._env.spec.discrete:
            return Softmax(self.network)
        log_std = np.asarray(self._state.params["log_std"], np.float64)
        return Gaussian(replace(self.network, tanh=True), log_std)

    @property
    def network(self) -> Network:
        """The actor, before any tanh."""
        layers = [[np.asarray(part, np.float64) for part in layer] for layer in self._state.params["actor"]]
        weights, biases = zip(*layers, strict=True)
        scale = np.array(self._env.spec.obs_scale)
        return Network(np.zeros_like(scale), scale, weights, biases)

    def _next_key(self) -> Any:
        self._key, key = jax.random.split(self._key)
        return key


def dynamics_of(spec: EnvSpec) -> Dynamics | None:
    """Return a task's written dynamics, None where it has none."""
    physics = getattr(spec.batch, "keywords", {}).get("physics")
    return physics if isinstance(physics, Dynamics) else None


class _Compiled:
    """The collector of bouts of steps by written dynamics."""

    def __init__(self, kind: Kind, physics: Dynamics, spec: EnvSpec, key: Any) -> None:
        first, self._go_on = ppo.collector(kind, physics, spec.horizon)
        with jax.enable_x64(True):
            self._scene = first(key)

    def __call__(self, params: Any, scale: Any, key: Any) -> Steps:
        with jax.enable_x64(True):
            self._scene, steps = self._go_on(params, self._scene, scale, key)
        found: Steps = steps
        return found


class _Stepped:
    """The collector of bouts of steps of any other task."""

    def __init__(self, kind: Kind, env: TrainingEnv) -> None:
        self._kind, self._env = kind, env
        copies = kind.settings.copies
        self._obs = np.stack([self._reset(place) for place in range(copies)])
        self._age = np.arange(copies) * env.spec.horizon // copies

    def _reset(self, place: int) -> Array:
        return self._env.batch.reset(place, training_seeds(self._env.rng, 1)[0])

    def __call__(self, params: Any, scale: Any, key: Any) -> Steps:
        spec, places = self._env.spec, list(range(self._kind.settings.copies))
        act = ppo.functions(self._kind).act
        rows = []
        for number in range(self._kind.settings.steps):
            obs = self._obs
            drawn, log_prob = map(np.asarray, act(params, (obs / scale).astype(np.float32), key, number))
            after, true, terminated, truncated = self._env.batch.step(places, _executed(spec, drawn))
            self._age += 1
            cut = ~terminated & (truncated | (self._age == spec.horizon))
            rows.append((obs, drawn, after, log_prob, true, terminated, cut))
            self._obs = after.copy()
            for place in np.flatnonzero(terminated | cut):
                self._obs[place], self._age[place] = self._reset(int(place)), 0
        return Steps(*map(np.stack, zip(*rows, strict=True)))


def _executed(spec: EnvSpec, drawn: Any) -> Array:
    """Return what actions (..., A), or choices (...), amount to, (..., A)."""
    act: Array = np.eye(spec.act_size)[drawn] if spec.discrete else np.clip(drawn, -1, 1).astype(np.float64)
    return act


def _transitions(spec: EnvSpec, seen: Steps) -> Transitions:
    terminated = np.asarray(seen.terminated).ravel()
    act = _executed(spec, np.asarray(seen.act)).reshape(-1, spec.act_size)
    obs, after = (np.asarray(o, np.float64).reshape(-1, spec.obs_size) for o in (seen.obs, seen.next_obs))
    return Transitions.own(obs, act, after, np.zeros_like(terminated), terminated)


def by_sb3(s: PPO, env: TrainingEnv, common: dict[str, Any]) -> sb3.PPO:
    """Return an untrained model of Stable-Baselines3. common: what it is made with besides."""
    model = sb3.PPO(
        **common
        | {
            "env": VecNormalize(env, norm_obs=False, gamma=env.spec.gamma),
            "n_steps": s.steps,
            "n_epochs": s.epochs,
            "gae_lambda": s.gae_lambda,
            "clip_range": ppo.CLIP,
        },
        policy_kwargs={
            "net_arch": list(s.net),
            "activation_fn": torch.nn.ReLU,
            "log_std_init": float(np.log(s.std)),
            "optimizer_kwargs": ADAM | {"eps": ppo.EPSILON},
        },
    )
    if not env.spec.discrete:
        model.policy.action_net = torch.nn.Sequential(model.policy.action_net, torch.nn.Tanh())
    return model


def forget_rewards(model: sb3.PPO) -> None:
    """Have it scale rewards by those to come alone."""
    env = model.get_vec_normalize_env()
    assert env is not None
    env.ret_rms = RunningMeanStd(shape=())
    env.returns = np.zeros(env.num_envs)


def explore(model: sb3.PPO, noise: float) -> None:
    """Have it explore by so much at least: after it has learned it hardly does, and another reward may ask
    for other actions. Where actions are choices it draws by their probabilities, and nothing is done."""
    if isinstance(model.action_space, spaces.Box):
        model.policy.log_std.data.clamp_(min=np.log(noise))


def layers(model: sb3.PPO) -> torch.nn.Module:
    """Return the actor's."""
    return torch.nn.ModuleList([model.policy.mlp_extractor.policy_net, model.policy.action_net])
