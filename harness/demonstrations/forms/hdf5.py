"""HDF5 files of D4RL (`harness.demonstrations.forms.steps`), and of robomimic.

Those of robomimic have a group data/demo_<number> for each episode: obs/<key>, actions, rewards and dones,
and optionally next_obs/<key>.

The dones of robomimic may mark success, so the last one alone says whether its episode terminated.
"""

from __future__ import annotations

from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from harness.demonstrations.forms import steps
from harness.demonstrations.forms.content import beside, observed
from harness.demonstrations.recording import NUMBERS, Episode, Reading, Recording, completed, extra, joined


def read(binary: BinaryIO, how: Reading) -> Recording:
    """Return the episodes of a file. Raises BadInput where h5py is missing."""
    with extra("h5py").File(binary, "r") as file:
        if "data" in file:
            return Recording(
                "robomimic", completed(joined(_robomimic(file["data"], how)), how.last_observation)
            )
        if not {"observations", "terminals"} <= {*file}:
            raise ValueError(
                f"it has neither the group data nor D4RL's observations and terminals, but {[*file]}"
            )
        return steps.of_d4rl({name: np.asarray(file[name]) for name in steps.D4RL if name in file}, how)


def _robomimic(data: Any, how: Reading) -> list[Episode]:
    names = sorted((name for name in data if name.startswith("demo_")), key=lambda name: (len(name), name))
    keys, episodes = None, []
    for name in names:
        demo = data[name]
        keys = keys or observed(widths(demo["obs"]), how)
        obs = columns(demo["obs"], keys)
        act = np.asarray(demo["actions"]) if "actions" in demo else np.zeros((len(obs), 0))
        if "next_obs" in demo:
            obs = np.concatenate([obs, columns(demo["next_obs"], keys)[-1:]])
        rewards = np.asarray(demo["rewards"]) if "rewards" in demo else None
        ended = bool(demo["dones"][-1]) if "dones" in demo else False
        episodes.append(Episode(obs, act, ended, rewards))
    return episodes


def widths(group: Any) -> dict[str, int]:
    """Return how many numbers of each key of a group there are in a row; images are left out. Keys of nested
    groups have / between them."""
    flat = dict[str, int]()

    def add(key: str, one: Any) -> None:
        if getattr(one, "ndim", 0) in (1, 2) and one.dtype.kind in NUMBERS:
            flat[key] = 1 if one.ndim == 1 else one.shape[1]

    group.visititems(add)
    return flat


def columns(group: Any, keys: Any) -> NDArray[Any]:
    """Return the observations of these keys, (N, sum of their widths)."""
    return beside([np.asarray(group[key]) for key in keys])
