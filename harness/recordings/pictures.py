"""Images that are observed in an episode."""

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from envs import EnvSpec
from envs.spec import Array
from harness.recordings.common import send_columns

_CHANNELS = 3


def pictures(spec: EnvSpec, seed: int, act: Array) -> NDArray[np.uint8]:
    """Return the image after the reset and after each of the episode's actions (T, A), (T+1, H, W, C)."""
    env = spec.make()
    env.reset(seed=seed)
    images = [env.get_wrapper_attr("image").copy()]
    for action in act:
        env.step(spec.native(action))
        images.append(env.get_wrapper_attr("image").copy())
    return np.stack(images)


def send_pictures(stream: rr.RecordingStream, images: NDArray[np.uint8]) -> None:
    """Send images (N, H, W, C), as grey ones or with missing colours at 0."""
    count, height, width, channels = images.shape
    if 1 < channels < _CHANNELS:
        images = np.concatenate([images, np.zeros_like(images[..., :1])], axis=-1)
    model = rr.ColorModel.L if channels == 1 else rr.ColorModel.RGB
    shape = rr.components.ImageFormat(width=width, height=height, color_model=model, channel_datatype="U8")
    flat = images[..., :_CHANNELS].reshape(count, -1)
    send_columns(stream, "camera", np.arange(count), rr.Image.columns(buffer=flat, format=[shape] * count))
