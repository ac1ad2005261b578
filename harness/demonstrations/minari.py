"""New datasets of Minari, written by it, in parquet."""

from __future__ import annotations

import os
import tempfile
import warnings
from collections.abc import Sequence
from pathlib import Path
from unittest import mock

import numpy as np

from envs import EnvSpec
from harness.demonstrations.recording import extra
from methods.base import Array, Episodes

FOLDER = "MINARI_DATASETS_PATH"
"""Name of the variable that says where Minari writes."""


def write(
    path: Path,
    name: str,
    spec: EnvSpec,
    episodes: Episodes,
    rewards: Sequence[Array],
    first: int,
    **facts: str,
) -> None:
    """Write a new dataset called `name`, the folder `path`. Actions are in [-1, 1], or choices.

    first: number of the first choice. facts: for `create_dataset_from_buffers`. Raises BadInput where Minari
    is missing.
    """
    from gymnasium import spaces

    minari, buffers = extra("minari"), []
    for obs, act, ended, paid in zip(episodes.obs, episodes.act, episodes.terminated, rewards, strict=True):
        last = np.arange(len(act)) == len(act) - 1
        steps = {"terminations": last & ended, "truncations": last & (not ended), "rewards": paid}
        actions = act.argmax(axis=1) + first if spec.discrete else act
        buffers.append(
            minari.data_collector.EpisodeBuffer(observations=obs, actions=actions, infos={}, **steps)
        )
    box = spaces.Box(-1.0, 1.0, (spec.act_size,), np.float64)
    path = path.absolute()  # or Minari joins a relative one twice
    path.parent.mkdir(exist_ok=True)
    with (
        tempfile.TemporaryDirectory(prefix=f".{path.name}.", suffix=".tmp", dir=path.parent) as scratch,
        mock.patch.dict(os.environ, {FOLDER: scratch}),
        warnings.catch_warnings(),
    ):
        warnings.simplefilter("ignore")  # about a missing environment
        minari.create_dataset_from_buffers(
            name,
            buffers,
            action_space=spaces.Discrete(spec.act_size, start=first) if spec.discrete else box,
            observation_space=spaces.Box(-np.inf, np.inf, (spec.obs_size,), np.float64),
            data_format="parquet",
            **facts,
        )
        (Path(scratch) / name).rename(path)
