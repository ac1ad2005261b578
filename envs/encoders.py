"""Encoders, which make vectors of images, and their use on Gymnasium's environments of images.

An encoder is fixed before a method begins, and every method and all RL of a task see through the same one. So
methods differ by what they do, and an image costs one pass. The shipped encoders are convolutions with
random weights (Jarrett et al. 2009; Burda et al. 2019 compare them with learned ones). Their outputs are
projected on their principal components in a random policy's episodes. Weights, pixels and what lies between
are whole numbers, so that features do not depend on how many images are encoded at a time.
"""

from __future__ import annotations

import importlib
import math
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from gymnasium.utils import RecordConstructorArgs
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

Array = NDArray[np.float64]
Floats = NDArray[np.float32]

FEATURES = 64
"""Number of features of an image and the one before it."""
EXAMPLES = 1024
"""Images by which an encoder is made."""
LARGEST_WEIGHT = 9
LARGEST_SHARE = 127  # largest weight of a feature
BRIGHTEST = 255
MOST_CHANNELS = 4
SMALL, NATURE = ((5, 2, 16), (3, 2, 32), (3, 2, 32)), ((8, 4, 32), (4, 2, 64), (3, 1, 64))
LAYERS = {"small": SMALL, "nature": NATURE}
"""Convolutions of the shipped encoders: width, stride and channels of each. `nature` is that of Mnih et al.
2015."""

Images = NDArray[np.uint8]
Encoder = Callable[[Images], Array]
"""A function of images (B, H, W, C) that returns their features, (B, FEATURES)."""


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
        return features


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
    (N, H, W, C). Features are in units of their standard deviations among these. Raises ValueError for other
    names, and for classes that give other shapes."""
    if name in LAYERS:
        return Convolutions(LAYERS[name], images)
    module, _, attribute = name.partition(":")
    try:
        kind = getattr(importlib.import_module(module), attribute)
        encoder, again = kind(images), kind(images)
        given = encoder(images[:2]), encoder(images[:1]), again(images[:2])
        both, alone, same = (np.asarray(features, np.float64) for features in given)
    except Exception as error:
        known, why = ", ".join(LAYERS), f"{type(error).__name__}: {error}"
        raise ValueError(f"no encoder {name!r}: give {known}, or module:Class ({why})") from error
    if both.shape != (2, FEATURES) or not np.isfinite(both).all():
        raise ValueError(f"the encoder {name} gives {both.shape} of 2 images, not finite (2, {FEATURES})")
    if not (np.array_equal(both, same) and np.array_equal(both[:1], alone)):
        raise ValueError(f"the encoder {name} gives an image other features again, or beside others")
    features = np.asarray(encoder(images), np.float64)
    mean, std = features.mean(axis=0), features.std(axis=0)
    std[std < 1e-9] = 1.0
    return lambda shown: (np.asarray(encoder(shown), np.float64) - mean) / std


def channels_last(space: spaces.Space[Any]) -> tuple[int, ...] | None:
    """Return the axes that make an image (H, W, C) of an observation, None for other spaces than images."""
    if isinstance(space, spaces.Box) and space.dtype == np.uint8 and len(space.shape) == 3:
        if space.shape[2] <= MOST_CHANNELS:
            return (0, 1, 2)
        if space.shape[0] <= MOST_CHANNELS:
            return (1, 2, 0)
    return None


class Encoded(gym.Wrapper[Any, Any, Any, Any], RecordConstructorArgs):
    """An environment of images whose observations are features of the image and the one before."""

    def __init__(self, env: gym.Env[Any, Any], encoder: str = "small") -> None:
        RecordConstructorArgs.__init__(self, encoder=encoder)
        gym.Wrapper.__init__(self, env)
        axes = channels_last(env.observation_space)
        assert axes is not None
        self._axes, self.encoder = axes, encoder
        key = repr(env.spec), encoder
        if key not in _MADE:
            _MADE[key] = made(encoder, np.stack([*self._examples()]))
        self._encode, self._latest = _MADE[key], np.zeros(0, np.uint8)
        self.observation_space = spaces.Box(-np.inf, np.inf, (FEATURES,), np.float32)

    def reset(self, **options: Any) -> tuple[Floats, dict[str, Any]]:
        obs, info = self.env.reset(**options)
        self._latest = self._image(obs)
        return self._seen(self._latest), info

    def step(self, action: Any) -> tuple[Floats, Any, bool, bool, dict[str, Any]]:
        obs, *others = self.env.step(action)
        return self._seen(self._image(obs)), *others  # type: ignore[return-value]

    @property
    def image(self) -> Images:
        """The latest image, (H, W, C)."""
        return self._latest

    def encoded(self, images: NDArray[Any]) -> Array:
        """Return the observations, (T, FEATURES), of an episode's images, (T, ...), or as rows of pixels.
        Raises ValueError for images of another size."""
        shape = self.env.observation_space.shape
        assert shape is not None
        if images.dtype != np.uint8 or images.shape[1:] not in (shape, (math.prod(shape),)):
            its = f"{images.dtype} {images.shape[1:]}"
            raise ValueError(f"its observations are {its}, and the task's are images uint8 {shape}")
        seen = np.stack([self._image(image) for image in images.reshape(-1, *shape)])
        pairs = np.concatenate([seen[[0, *range(len(seen) - 1)]], seen], axis=-1)
        return np.asarray(self._encode(pairs).astype(np.float32).astype(np.float64))

    def _image(self, obs: Any) -> Images:
        return np.array(obs, np.uint8).transpose(self._axes)

    def _seen(self, image: Images) -> Floats:
        pair, self._latest = np.concatenate([self._latest, image], axis=-1), image
        features: Floats = self._encode(pair[None])[0].astype(np.float32)
        return features

    def _examples(self) -> Iterator[Images]:
        """Yield pairs of images under random actions."""
        self.env.action_space.seed(0)
        before = self._image(self.env.reset(seed=0)[0])
        for _ in range(EXAMPLES):
            obs, _, terminated, truncated, _ = self.env.step(self.env.action_space.sample())
            image = self._image(obs)
            yield np.concatenate([before, image], axis=-1)
            before = self._image(self.env.reset()[0]) if terminated or truncated else image


_MADE: dict[tuple[str, str], Encoder] = {}
"""Encoders of this process by environment and name."""
