"""The drive as the car's camera sees it: 32 by 16 pixels of distance and road, and what the car measures."""

from collections.abc import Sequence

import numpy as np

from envs.encoders import Images
from envs.hills import drive
from envs.hills.camera import OWN, picture
from envs.hills.car import Physics
from envs.hills.environment import NOMINAL, Drive, why_ended
from envs.hills.environment import drive as driven
from envs.images import seen
from envs.spec import Array, Flags


class View:
    """Cars with cameras (`envs.images.View`). The numbers beside an image are the first `OWN` observations of
    `drive_state`."""

    act_size = 2

    def __init__(self, count: int, physics: Physics = NOMINAL) -> None:
        self._cars = [Drive(physics) for _ in range(count)]

    def reset(self, place: int, seed: int) -> tuple[Images, Array]:
        obs, _ = self._cars[place].reset(seed=seed)
        return picture(self._cars[place]), obs[:OWN]

    def step(self, places: Sequence[int], act: Array) -> tuple[Images, Array, Array, Flags]:
        cars = [self._cars[place] for place in places]
        obs, rewards, terminated = driven(cars, act)
        return np.stack([*map(picture, cars)]), obs[:, :OWN], rewards, terminated

    def why_ended(self, place: int) -> str:
        return why_ended(self._cars[place])


SPEC = seen(
    drive.SPEC,
    "drive",
    View,
    dict(zip(drive.OBS_NAMES[:OWN], drive.SPEC.obs_scale, strict=False)),
    summary="drive_state through the car's camera, in 32 by 16 pixels of distance and road",
    variants={
        **drive.SPEC.variants,
        "camera_lowered": {"physics": Physics(camera=NOMINAL.camera / 2)},
    },
)
"""The road is in the images alone. Beside them the car measures its speeds, its tilt and its front wheels."""
