"""The swing-up as a camera sees it: 32 by 32 pixels of a rod, and the image before."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from envs.dynamics import DynamicsBatch
from envs.encoders import Images
from envs.images import seen
from envs.spec import Array, Flags
from envs.swingups import swingup
from envs.swingups.swingup import NOMINAL, Physics

SIDE = 32
"""Pixels of a side."""
EDGE = 1.3
"""The distance of a side from the middle [m]."""
WIDTH = 0.08
"""Width of the rod's blurred edge [m]."""
PLACES = EDGE * (2 * np.arange(SIDE, dtype=np.float32) + 1 - SIDE) / SIDE


class View:
    """Copies of the pendulum (`envs.images.View`). The angle alone is in an image, and no number is beside
    it."""

    act_size = 1

    def __init__(self, count: int, physics: Physics = NOMINAL) -> None:
        self._batch = DynamicsBatch(count, physics=physics)
        self._length = physics.length

    def reset(self, place: int, seed: int) -> tuple[Images, Array]:
        return drawn(self._batch.reset(place, seed)[None], self._length)[0], np.zeros(0)

    def step(self, places: Sequence[int], act: Array) -> tuple[Images, Array, Array, Flags]:
        obs, rewards, terminated = self._batch.step(places, act)
        return drawn(obs, self._length), np.zeros((len(obs), 0)), rewards, terminated

    def why_ended(self, place: int) -> str:
        return self._batch.why_ended(place)


def drawn(obs: Array, length: float) -> Images:
    """Return images (B, SIDE, SIDE, 1) of rods of a length [m], by observations of the state, (B, 3)."""
    cosine, sine = (obs[:, i, None, None].astype(np.float32) for i in (0, 1))
    x, y = PLACES[None, None, :], -PLACES[None, :, None]
    along = np.clip(-x * sine + y * cosine, 0, length)
    off = np.hypot(x + along * sine, y - along * cosine)
    return np.asarray(np.clip(400 - 255 / WIDTH * off, 0, 255).astype(np.uint8)[..., None])


SPEC = seen(
    swingup.SPEC,
    "swingup_pixels",
    View,
    {},
    summary="swingup as a camera sees it, in 32 by 32 pixels",
    rl=replace(swingup.SPEC.rl, checkpoint_every=16_384),
)
"""The pendulum in images. The angle is in an image, the rate in the difference from the one before."""
