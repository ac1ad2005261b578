"""Tasks that are seen in images. An encoder makes a vector of each image, and the vector is the observation.

An encoder is fixed before a method begins, and every method and all RL of a task see through the same one. So
methods differ by what they do, and an image costs one pass. The shipped encoders are convolutions with
random weights, whose outputs are projected on their principal components in a random policy's episodes
(Jarrett et al. 2009; Burda et al. 2019 compare random convolutions with learned ones). Weights, pixels and
what lies between are whole numbers, so features are equal to the last bit for any number of images and on
any processor.
"""

from __future__ import annotations

import functools
import importlib
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, Protocol

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from envs.spec import Array, EnvSpec, Flags, Floats, Quantity, Shape, register

FEATURES = 64
"""Number of features of an image and the one before it."""
FEATURE_SCALE = 1.0
"""Typical size of a feature."""
EXAMPLES = 1024
"""Images by which an encoder is made."""
COPIES = 32
"""Episodes that these images come from, at first."""
LARGEST_WEIGHT = 9
LARGEST_SHARE = 127  # largest weight of a feature
BRIGHTEST = 255
SMALL, NATURE = ((5, 2, 16), (3, 2, 32), (3, 2, 32)), ((8, 4, 32), (4, 2, 64), (3, 1, 64))
LAYERS = {"small": SMALL, "nature": NATURE}
"""Convolutions of the shipped encoders: width, stride and channels of each. `nature` is that of Mnih et al.
2015."""

Images = NDArray[np.uint8]
Encoder = Callable[[Images], Array]
"""A function of images (B, H, W, C) that returns their features, (B, FEATURES)."""


class View(Protocol):
    """Copies of a task, numbered from 0, that show images (H, W, C) and a few numbers (F,)."""

    act_size: int

    def reset(self, place: int, seed: int) -> tuple[Images, Array]:
        """Return the first image and numbers of the copy's next episode."""

    def step(self, places: Sequence[int], act: Array) -> tuple[Images, Array, Array, Flags]:
        """Step the copies by actions (B, A). Return images (B, H, W, C), numbers (B, F), rewards (B,), and
        flags of termination (B,)."""

    def drawing(self, place: int) -> dict[str, Shape]:
        """Return the copy's scene, as `envs.spec.EnvSpec.draw` does."""

    def why_ended(self, place: int) -> str:
        """Return why the copy's episode just terminated."""


class Convolutions:
    """An encoder of random convolutions and principal components, made from images (N, H, W, C)."""

    def __init__(self, layers: Sequence[tuple[int, int, int]], images: Images) -> None:
        rng, x = np.random.default_rng(0), images
        self._layers = list[tuple[int, int, Floats, np.float32]]()
        for width, stride, channels in layers:
            drawn = rng.standard_normal((width * width * x.shape[-1], channels)) * LARGEST_WEIGHT / 3
            weights = np.clip(np.rint(drawn), -LARGEST_WEIGHT, LARGEST_WEIGHT).astype(np.float32)
            y = _convolved(x, width, stride, weights)
            bits = math.ceil(math.log2(max(1.0, float(np.percentile(y, 99.5)) / BRIGHTEST)))
            self._layers.append((width, stride, weights, np.float32(0.5**bits)))
            x = _rounded(y, self._layers[-1][-1])
        flat = x.reshape(len(x), -1).astype(np.float64)
        centred = flat - flat.mean(axis=0)
        sizes, directions = np.linalg.eigh(centred @ centred.T)
        shares = centred.T @ directions[:, np.argsort(sizes)[: -FEATURES - 1 : -1]]
        shares *= np.sign(shares[np.abs(shares).argmax(axis=0), np.arange(shares.shape[1])])
        self._shares = np.rint(LARGEST_SHARE * shares / np.maximum(np.abs(shares).max(axis=0), 1e-9))
        features = flat @ self._shares
        self._mean, self._std = features.mean(axis=0), np.maximum(features.std(axis=0), 1.0)

    def __call__(self, images: Images) -> Array:
        x = images
        for width, stride, weights, scale in self._layers:
            x = _rounded(_convolved(x, width, stride, weights), scale)
        features: Array = (x.reshape(len(x), -1) @ self._shares - self._mean) / self._std
        return features.astype(np.float32).astype(np.float64)


def _convolved(x: Images, width: int, stride: int, weights: Floats) -> Floats:
    """Return the convolution of (B, H, W, C) with weights (width * width * C, K), in whole numbers below
    2^24, which 32 bits hold."""
    pad = (width // 2, width // 2)
    padded = np.pad(x, [(0, 0), pad, pad, (0, 0)])
    windows = sliding_window_view(padded, (width, width), axis=(1, 2))[:, ::stride, ::stride]
    batch, rows, columns = windows.shape[:3]
    flat = windows.reshape(batch * rows * columns, -1).astype(np.float32)
    return np.asarray((flat @ weights).reshape(batch, rows, columns, -1))


def _rounded(y: Floats, scale: np.float32) -> Images:
    whole: Images = np.clip(y * scale, 0, BRIGHTEST).astype(np.uint8)
    return whole


def made(name: str, images: Images) -> Encoder:
    """Return the encoder of a name, 'small', 'nature' or 'module:Class', whose class is called with images
    (N, H, W, C). Raises ValueError for other names, and for classes that give other shapes."""
    if name in LAYERS:
        return Convolutions(LAYERS[name], images)
    module, _, attribute = name.partition(":")
    try:
        encoder: Encoder = getattr(importlib.import_module(module), attribute)(images)
    except (ImportError, AttributeError, ValueError) as error:
        known = ", ".join(LAYERS)
        raise ValueError(f"no encoder {name!r}: give {known}, or module:Class ({error})") from error
    if (shape := np.shape(encoder(images[:2]))) != (2, FEATURES):
        raise ValueError(f"the encoder {name} gives features {shape} of 2 images, not (2, {FEATURES})")
    return encoder


@functools.cache
def encoder_for(view: Callable[[int], View], name: str) -> Encoder:
    """Return an encoder made from images of a view's random episodes, whose actions drift."""
    copies, rng = view(COPIES), np.random.default_rng(0)
    places, seeds = range(COPIES), iter(range(1, 1 << 10))
    latest = np.stack([copies.reset(place, next(seeds))[0] for place in places])
    found, act = list[Images](), np.zeros((COPIES, copies.act_size))
    while len(found) * COPIES < 4 * EXAMPLES:
        act = np.clip(0.9 * act + 0.5 * rng.standard_normal(act.shape), -1, 1)
        images, _, _, terminated = copies.step(places, act)
        found.append(np.concatenate([latest, images], axis=-1))
        latest = images
        for place in np.flatnonzero(terminated).tolist():
            latest[place] = copies.reset(place, next(seeds))[0]
    every = np.concatenate(found)
    return made(name, every[rng.permutation(len(every))[:EXAMPLES]])


class SeenBatch:
    """Copies of a task whose observations are features of their images, and the numbers beside them
    (`envs.spec.Batch`). changed: arguments of the `view` in a variant of the task."""

    def __init__(self, count: int, view: Callable[..., View], encoder: str, **changed: Any) -> None:
        self.view, self._encode = view(count, **changed), encoder_for(view, encoder)
        self._latest: Images | None = None
        self._count = count

    def reset(self, place: int, seed: int) -> Array:
        image, numbers = self.view.reset(place, seed)
        if self._latest is None:
            self._latest = np.zeros((self._count, *image.shape), np.uint8)
        self._latest[place] = image
        return np.append(self._encode(np.concatenate([image, image], axis=-1)[None])[0], numbers)

    def step(self, places: Sequence[int], act: Array) -> tuple[Array, Array, Flags]:
        assert self._latest is not None
        images, numbers, rewards, terminated = self.view.step(places, act)
        features = self._encode(np.concatenate([self._latest[places], images], axis=-1))
        self._latest[places] = images
        return np.column_stack([features, numbers]), rewards, terminated

    def why_ended(self, place: int) -> str:
        return self.view.why_ended(place)


class SeenEnv(gym.Env[Floats, Floats]):
    """One copy of it as an environment. numbers: how many are beside the features."""

    def __init__(self, view: Callable[..., View], encoder: str, numbers: int = 0, **changed: Any) -> None:
        self._batch = SeenBatch(1, view, encoder, **changed)
        self.view = self._batch.view
        self.observation_space = spaces.Box(-np.inf, np.inf, (FEATURES + numbers,), np.float32)
        self.action_space = spaces.Box(-1.0, 1.0, (self.view.act_size,), np.float32)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Floats, dict[str, Any]]:
        super().reset(seed=seed)
        drawn = int(self.np_random.integers(1 << 31)) if seed is None else seed
        return self._batch.reset(0, drawn).astype(np.float32), {}

    def step(self, action: Floats) -> tuple[Floats, float, bool, bool, dict[str, Any]]:
        obs, rewards, terminated = self._batch.step([0], action[None].astype(np.float64))
        return obs[0].astype(np.float32), float(rewards[0]), bool(terminated[0]), False, {}


def draw(env: gym.Env[Any, Any]) -> dict[str, Shape]:
    """Return the scene of a `SeenEnv`."""
    inner: Any = env.unwrapped
    drawing: dict[str, Shape] = inner.view.drawing(0)
    return drawing


def why_ended(env: gym.Env[Any, Any]) -> str:
    """Return why the episode of a `SeenEnv` terminated."""
    inner: Any = env.unwrapped
    return str(inner.view.why_ended(0))


def seen(
    states: EnvSpec, name: str, view: Callable[..., View], numbers: Mapping[Quantity, float], **fields: Any
) -> EnvSpec:
    """Return and register a task of states as images show it. Its expert sees the states.

    `numbers`: what observations have beside the image's features, with its typical size. `fields`: other
    fields of `EnvSpec` than the task of states has.
    """
    shown: dict[str, Any] = {"view": view, "encoder": "small"}
    features = tuple(Quantity(f"feature {number}") for number in range(FEATURES))
    spec = replace(
        states,
        name=name,
        env_id=f"irl_bench_bare/{name}-v0",
        obs_size=FEATURES + len(numbers),
        obs_names=(*features, *numbers),
        obs_scale=(FEATURE_SCALE,) * FEATURES + (*numbers.values(),),
        phi=None,
        draw=draw,
        why_ended=why_ended,
        kwargs={**shown, "numbers": len(numbers)},
        batch=partial(SeenBatch, **shown),
        encoder="small",
        expert_task=states,
        shipped=None,
        controller=None,
        **fields,
    )
    register(spec, f"{__name__}:SeenEnv")
    return spec
