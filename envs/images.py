"""Tasks of the program's own that are seen in images, through an encoder (`envs.encoders`).

The image is of a state, and the expert sees the state.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, Protocol

import gymnasium as gym
import numpy as np
from gymnasium import spaces

from envs.encoders import EXAMPLES, FEATURES, Encoder, Images, made
from envs.spec import Array, EnvSpec, Flags, Floats, Quantity, register

COPIES = 32
"""Episodes that an encoder's examples come from, at first."""


class View(Protocol):
    """Copies of a task, numbered from 0, that show images (H, W, C) and a few numbers (F,)."""

    act_size: int

    def reset(self, place: int, seed: int) -> tuple[Images, Array]:
        """Return the first image and numbers of the copy's next episode."""

    def step(self, places: Sequence[int], act: Array) -> tuple[Images, Array, Array, Flags]:
        """Step the copies by actions (B, A). Return images (B, H, W, C), numbers (B, F), rewards (B,), and
        flags of termination (B,)."""

    def why_ended(self, place: int) -> str:
        """Return why the copy's episode just terminated."""


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
        first: Array = self._seen(np.concatenate([image, image], axis=-1)[None], numbers[None])[0]
        return first

    def step(self, places: Sequence[int], act: Array) -> tuple[Array, Array, Flags]:
        assert self._latest is not None
        images, numbers, rewards, terminated = self.view.step(places, act)
        obs = self._seen(np.concatenate([self._latest[places], images], axis=-1), numbers)
        self._latest[places] = images
        return obs, rewards, terminated

    def _seen(self, images: Images, numbers: Array) -> Array:
        """Return observations of images (B, H, W, 2C) and numbers (B, F), in 32 bits."""
        obs: Floats = np.column_stack([self._encode(images), numbers]).astype(np.float32)
        return obs.astype(np.float64)

    def image(self, place: int) -> Images:
        """Return the copy's latest image, (H, W, C)."""
        assert self._latest is not None
        latest: Images = self._latest[place]
        return latest

    def why_ended(self, place: int) -> str:
        return self.view.why_ended(place)


class SeenEnv(gym.Env[Floats, Floats]):
    """One copy of it as an environment. numbers: how many are beside the features."""

    def __init__(self, view: Callable[..., View], encoder: str, numbers: int = 0, **changed: Any) -> None:
        self._batch, self.encoder = SeenBatch(1, view, encoder, **changed), encoder
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

    @property
    def image(self) -> Images:
        """The latest image, (H, W, C)."""
        return self._batch.image(0)

    def encoded(self, images: Any) -> Array:
        """Raise ValueError: a file does not say what is beside an image."""
        raise ValueError("the task draws its images itself, and takes none of a file")


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
        obs_scale=(1.0,) * FEATURES + (*numbers.values(),),
        phi=None,
        draw=EnvSpec.draw,
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
