"""Our PPO (`harness.rl.ppo`) in one environment: it collects a bout of steps, pays them, and learns."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from envs import EnvSpec
from envs.dynamics import Dynamics
from envs.learners import PPO
from harness.rl import ppo
from harness.rl.ppo import Kind, Steps
from harness.rl.training_env import TrainingEnv
from methods.base import Array, Transitions
from methods.network import Network
from methods.stochastic import Gaussian, Softmax

REWARD_SIZE = 0.3
"""Mean absolute reward of the first bout after scaling; the scale stays until the reward changes."""
Collect = Callable[[Any, Any, Any], Steps]
"""(parameters of the agent, scale of observations (O,), key): a bout of its steps."""


class OnPolicy:
    """Our PPO in one environment. `latest`: the steps of the latest bout."""

    latest: Transitions

    def __init__(self, env: TrainingEnv, settings: PPO, seed: int) -> None:
        spec = env.spec
        self._env, self._settings = env, settings
        kind = Kind(settings, spec.obs_size, spec.act_size, spec.discrete, spec.gamma)
        self._functions = ppo.functions(kind)
        self._scale = np.array(spec.obs_scale, np.float32)
        self.set_random_seed(seed)
        self._state = self._functions.begin(self._next_key())
        self._uniform = -np.log(spec.act_size) if spec.discrete else -spec.act_size * np.log(2)
        physics = dynamics_of(spec)
        self._collect: Collect = (
            _stepped(kind, env) if physics is None else _compiled(kind, physics, spec, self._next_key())
        )

    def set_random_seed(self, seed: int) -> None:
        """Make what it draws from now on depend on the seed alone."""
        self._key = jax.random.key(seed)

    def learn(
        self, steps: int, rate: Callable[[float], float], done: Callable[[int], None], entropy: float
    ) -> None:
        """Learn for a number of environment steps, beginning with the settings' noise at least.

        `rate` gives the learning rate for a share of the steps, here the middle of each bout. `done` is
        called with the number of steps after each bout. `entropy` is the worth of a nat; uniform actions have
        0 nats.
        """
        s, size = self._settings, 0.0
        params = self._state.params
        if "log_std" in params:
            least = jnp.maximum(params["log_std"], np.float32(np.log(s.noise)))
            self._state = self._state._replace(params={**params, "log_std": least})
        for taken in range(s.unit, steps + 1, s.unit):
            seen = self._collect(self._state.params, self._scale, self._next_key())
            paid = self._paid(seen, entropy)
            if taken == s.unit:
                size = max(float(np.abs(paid).mean()) / REWARD_SIZE, 1e-9)
            rewards = (paid / size).reshape(s.steps, s.copies).astype(np.float32)
            now = np.float32(rate((taken - s.unit / 2) / steps))
            self._state = self._functions.learn(
                *(self._state, seen, rewards, self._scale, now, self._next_key())
            )
            done(taken)

    def _paid(self, seen: Steps, entropy: float) -> Array:
        """Remember a bout, and return the pay of its steps one after the other, (T * N,)."""
        spec, terminated = self._env.spec, np.asarray(seen.terminated).ravel()
        act = _executed(spec, np.asarray(seen.act)).reshape(-1, spec.act_size)
        obs, after = (np.asarray(o, np.float64).reshape(-1, spec.obs_size) for o in (seen.obs, seen.next_obs))
        self.latest = Transitions.own(obs, act, after, np.zeros_like(terminated), terminated)
        paid = self._env.paid(self.latest, np.asarray(seen.true, np.float64).ravel())
        self._env.note(paid)
        if entropy:
            paid = paid - entropy * (np.asarray(seen.log_prob, np.float64).ravel() - self._uniform)
        return paid

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
        weights, biases = zip(*self._state.params["actor"], strict=True)
        scale = np.array(self._env.spec.obs_scale)
        return Network.of(np.zeros_like(scale), scale, weights, biases)

    def _next_key(self) -> Any:
        self._key, key = jax.random.split(self._key)
        return key


def dynamics_of(spec: EnvSpec) -> Dynamics | None:
    """Return a task's written dynamics, None where it has none."""
    physics = getattr(spec.batch, "keywords", {}).get("physics")
    return physics if isinstance(physics, Dynamics) and not spec.encoder else None


def _compiled(kind: Kind, physics: Dynamics, spec: EnvSpec, key: Any) -> Collect:
    """Return a collector that steps written dynamics."""
    first, go_on = ppo.collector(kind, physics, spec.horizon)
    with jax.enable_x64(True):
        scene = first(key)

    def collect(params: Any, scale: Any, key: Any) -> Steps:
        nonlocal scene
        with jax.enable_x64(True):
            scene, steps = go_on(params, scene, scale, key)
        return Steps(*steps)

    return collect


def _stepped(kind: Kind, env: TrainingEnv) -> Collect:
    """Return a collector that steps any other task."""
    env.reset()

    def collect(params: Any, scale: Any, key: Any) -> Steps:
        act, rows = ppo.functions(kind).act, []
        for number in range(kind.settings.steps):
            obs = (env.obs / scale).astype(np.float32)
            drawn, log_prob = map(np.asarray, act(params, obs, key, number))
            terminated, cut = env.advance(_executed(env.spec, drawn))
            steps, true = env.latest
            rows.append((steps.obs, drawn, steps.next_obs, log_prob, true, terminated, cut))
            env.restart(terminated | cut)
        return Steps(*map(np.stack, zip(*rows, strict=True)))

    return collect


def _executed(spec: EnvSpec, drawn: Any) -> Array:
    """Return the actions, (..., A), that drawn ones (..., A) or choices (...) amount to."""
    act: Array = np.eye(spec.act_size)[drawn] if spec.discrete else np.clip(drawn, -1, 1).astype(np.float64)
    return act
