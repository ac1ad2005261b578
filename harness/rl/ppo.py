"""Proximal policy optimisation (Schulman et al. 2017), compiled. An agent collects a bout of steps, and
learns from it. Where a task's dynamics are written down, collecting is compiled, too.

The mean action is a tanh of the actor's output, and actions beyond [-1, 1] count as the bound. Advantages are
generalised ones (Schulman et al. 2016). The value after a termination is 0. After a cut by a time limit it is
the critic's (Pardo et al. 2018).
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax
import scipy.linalg
from numpy.typing import NDArray

from envs.dynamics import Dynamics
from envs.learners import PPO

EPSILON = 1e-5
"""Adam's epsilon."""
CLIP = 0.2
"""The largest distance from 1 at which ratios of probabilities count."""
LARGEST_GRADIENT = 0.5
"""The norm that gradients are clipped to."""
VALUE_WEIGHT = 0.5
"""The critic's share of the loss."""
LARGEST_LOG_STD = 0.0
"""The largest logarithm of actions' standard deviation."""
LEAST_DRAWN = 1 << 14
"""Random numbers that are drawn for a layer, at least: for fewer, the same program is used."""
LAST_LAYER = 0.01
"""The size of an untrained actor's last weights."""
ALIGNED = 8
"""Observations are filled up with zeros to a multiple of it. XLA's products of others round by the sizes of
the processor's caches."""


Floats = NDArray[np.float32]


class Kind(NamedTuple):
    """Everything that compiled functions depend on, besides a task's dynamics."""

    settings: PPO
    obs_size: int
    act_size: int
    discrete: bool
    gamma: float


class Steps(NamedTuple):
    """T steps of N copies: `obs` and `next_obs` (T, N, O), `act` as drawn (T, N, A), or choices (T, N).

    The others are (T, N). `true` is the environment's reward. `cut` says whether a time limit ended the
    episode.
    """

    obs: Any
    act: Any
    next_obs: Any
    log_prob: Any
    true: Any
    terminated: Any
    cut: Any


class State(NamedTuple):
    """An agent's parameters, and its optimizer's moments."""

    params: Any
    moments: Any


class Functions(NamedTuple):
    """The compiled parts of an agent.

    `begin(key)`: an untrained `State`. `act(params, seen, key, number)`: actions at scaled observations (N,
    O), and the logarithm of their density. `key` and `number` together seed the draws. `learn(state, steps,
    rewards, scale, rate, key)`: the next `State`. `rewards`: (T, N). `scale`: typical sizes of observations,
    (O,). `rate`: the learning rate.
    """

    begin: Callable[..., Any]
    act: Callable[..., Any]
    learn: Callable[..., Any]


def _output(layers: Any, x: Any) -> Any:
    missing = -x.shape[-1] % ALIGNED
    (weight, bias), *others = layers
    x = jnp.pad(x, [(0, 0)] * (x.ndim - 1) + [(0, missing)])
    layers = [(jnp.pad(weight, [(0, missing), (0, 0)]), bias), *others]
    for weight, bias in layers[:-1]:
        x = jax.nn.relu(x @ weight + bias)
    weight, bias = layers[-1]
    return x @ weight + bias


def _value(params: Any, seen: Any) -> Any:
    return _output(params["critic"], seen)[..., 0]


def _log_prob(kind: Kind, params: Any, seen: Any, act: Any) -> Any:
    """Return the logarithm of actions' density, or of choices' probability, (N,)."""
    out = _output(params["actor"], seen)
    if kind.discrete:
        return jnp.take_along_axis(jax.nn.log_softmax(out), act[..., None], -1)[..., 0]
    log_std, constant = params["log_std"], 0.5 * math.log(2 * math.pi)
    z = (act - jnp.tanh(out)) * jnp.exp(-log_std)
    return (-0.5 * z * z - log_std - constant).sum(-1)


def _draw(kind: Kind, params: Any, seen: Any, key: Any) -> tuple[Any, Any]:
    out = _output(params["actor"], seen)
    if kind.discrete:
        act = jax.random.categorical(key, out)
    else:
        noise = jax.random.normal(key, out.shape, jnp.float32)
        act = jnp.tanh(out) + jnp.exp(params["log_std"]) * noise
    return act, _log_prob(kind, params, seen, act)


@functools.partial(jax.jit, static_argnums=1)
def _normals(key: Any, count: int) -> Any:
    return jax.random.normal(key, (count,), jnp.float32)


def _orthogonal(key: Any, inputs: int, outputs: int, gain: float) -> Floats:
    """Return the first weights (inputs, outputs) of a layer: those of JAX's initializer, which would be
    compiled for each shape."""
    shape = max(inputs, outputs), min(inputs, outputs)
    count = shape[0] * shape[1]
    drawn = np.asarray(_normals(key, max(LEAST_DRAWN, 1 << (count - 1).bit_length())))
    q, r = scipy.linalg.qr(drawn[:count].reshape(shape), mode="economic")
    weights: Floats = np.float32(gain) * (q * np.sign(np.diag(r)))
    return weights if inputs >= outputs else weights.T


@functools.cache
def functions(kind: Kind) -> Functions:
    """Return the compiled parts of agents of a kind."""
    s = kind.settings
    optimizer = optax.chain(optax.clip_by_global_norm(LARGEST_GRADIENT), optax.scale_by_adam(eps=EPSILON))

    def begin(key: Any) -> State:
        keys = iter(jax.random.split(key, 2 * len(s.net) + 2))

        def layers(outputs: int, last: float) -> list[Any]:
            sizes, gains = (kind.obs_size, *s.net, outputs), [math.sqrt(2)] * len(s.net) + [last]
            return [
                (_orthogonal(next(keys), i, o, gain), np.zeros(o, np.float32))
                for i, o, gain in zip(sizes[:-1], sizes[1:], gains, strict=True)
            ]

        params: dict[str, Any] = {"actor": layers(kind.act_size, LAST_LAYER), "critic": layers(1, 1.0)}
        if not kind.discrete:
            params["log_std"] = np.full(kind.act_size, math.log(s.std), np.float32)
        return State(params, optimizer.init(params))

    @jax.jit
    def act(params: Any, seen: Any, key: Any, number: Any) -> tuple[Any, Any]:
        return _draw(kind, params, seen, jax.random.fold_in(key, number))

    def loss(params: Any, seen: Any, act: Any, before: Any, advantage: Any, target: Any) -> Any:
        ratio = jnp.exp(_log_prob(kind, params, seen, act) - before)
        advantage = (advantage - advantage.mean()) / (advantage.std() + 1e-8)
        clipped = jnp.clip(ratio, 1 - CLIP, 1 + CLIP)
        gain = jnp.minimum(ratio * advantage, clipped * advantage).mean()
        error = jnp.square(_value(params, seen) - target).mean()
        return VALUE_WEIGHT * error - gain

    @jax.jit
    def learn(state: State, steps: Steps, rewards: Any, scale: Any, rate: Any, key: Any) -> State:
        seen, ended = steps.obs / scale, steps.terminated | steps.cut
        value = _value(state.params, seen)
        following = jnp.where(steps.terminated, 0.0, _value(state.params, steps.next_obs / scale))
        surprise = rewards + kind.gamma * following - value

        def back(after: Any, at: Any) -> tuple[Any, Any]:
            delta, end = at
            here = delta + kind.gamma * s.gae_lambda * jnp.where(end, 0.0, after)
            return here, here

        _, advantage = jax.lax.scan(back, jnp.zeros(s.copies), (surprise, ended), reverse=True)
        columns = (seen, steps.act, steps.log_prob, advantage, advantage + value)
        flat = [column.reshape(s.unit, *column.shape[2:]) for column in columns]

        def minibatch(state: State, rows: Any) -> tuple[State, None]:
            slope = jax.grad(loss)(state.params, *(column[rows] for column in flat))
            way, moments = optimizer.update(slope, state.moments)
            params = jax.tree.map(lambda p, d: p - rate * d, state.params, way)
            if not kind.discrete:
                params |= {"log_std": jnp.minimum(params["log_std"], LARGEST_LOG_STD)}
            return State(params, moments), None

        def epoch(state: State, key: Any) -> tuple[State, None]:
            order = jax.random.permutation(key, s.unit)
            return jax.lax.scan(minibatch, state, order.reshape(-1, s.batch))

        return jax.lax.scan(epoch, state, jax.random.split(key, s.epochs))[0]

    return Functions(begin, act, learn)


class JaxDraws:
    """A source of first states with the methods of NumPy's generators (`envs.dynamics.Draws`)."""

    def __init__(self, key: Any) -> None:
        self._key = key

    def uniform(self, low: Any, high: Any) -> Any:
        low, high = np.asarray(low), np.asarray(high)
        return low + (high - low) * jax.random.uniform(self._key, low.shape, jnp.float64)

    def standard_normal(self, size: int) -> Any:
        return jax.random.normal(self._key, (size,), jnp.float64)


@functools.cache
def collector(kind: Kind, physics: Dynamics, horizon: int) -> tuple[Callable[..., Any], Callable[..., Any]]:
    """Return two compiled functions, to be called where JAX has 64 bits. A scene is states and ages.

    `first(key)`: a scene whose episodes are cut at even intervals.
    `collect(params, scene, scale, key)`: the scene after a bout, and its `Steps`.
    """
    copies = kind.settings.copies

    def starts(key: Any) -> Any:
        return jax.vmap(lambda one: physics.start(JaxDraws(one)), out_axes=1)(jax.random.split(key, copies))

    def step(params: Any, scale: Any, scene: Any, key: Any) -> Any:
        state, age = scene
        acting, starting = jax.random.split(key)
        obs = physics.observe(state).T.astype(jnp.float32)
        drawn, log_prob = _draw(kind, params, obs / scale, acting)
        done = jax.nn.one_hot(drawn, kind.act_size) if kind.discrete else jnp.clip(drawn, -1, 1)
        act = done.T.astype(jnp.float64)
        after = physics.advance(state, act)
        true, terminated = physics.pay(state, act, after), physics.fails(after)
        cut = ~terminated & (age + 1 == horizon)
        following = physics.observe(after).T.astype(jnp.float32)
        steps = Steps(obs, drawn, following, log_prob, true.astype(jnp.float32), terminated, cut)
        ended = terminated | cut
        return (jnp.where(ended, starts(starting), after), jnp.where(ended, 0, age + 1)), steps

    @jax.jit
    def first(key: Any) -> Any:
        return starts(key), jnp.arange(copies) * horizon // copies

    @jax.jit
    def collect(params: Any, scene: Any, scale: Any, key: Any) -> tuple[Any, Steps]:
        keys = jax.random.split(key, kind.settings.steps)
        return jax.lax.scan(lambda scene, key: step(params, scale, scene, key), scene, keys)

    return first, collect
