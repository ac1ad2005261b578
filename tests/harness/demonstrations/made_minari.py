"""Datasets of Minari, as it writes them itself."""

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import minari
import numpy as np
import pytest
from gymnasium import spaces

from tests.harness.demonstrations.made_demonstrations import SWINGUP

FORMS = ("hdf5", "parquet", "arrow")
FLAGS = ("terminations", "truncations")


@contextmanager
def writing_to(folder: Path) -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch, warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of an author and more, which it is not given
        patch.setenv("MINARI_DATASETS_PATH", str(folder))
        yield


def minari_folder(
    path: Path,
    form: str,
    obs: Any,
    act: Any,
    ended: Any,
    rewards: Any,
    action_space: Any = None,
    **changes: Any,
) -> Path:
    """A dataset of the episodes, of which those that did not end were cut. changes: of each episode's buffer,
    or its observation_space."""
    seen = changes.pop("observation_space", None)
    buffers = []
    for at, did, end, paid in zip(obs, act, ended, rewards, strict=True):
        steps = {"terminations": np.zeros(len(did), bool), "truncations": np.zeros(len(did), bool)}
        steps["terminations"][-1], steps["truncations"][-1] = end, not end
        columns: Any = {"observations": at, "actions": did, "rewards": paid, **steps, "infos": {}} | changes
        buffers.append(minari.data_collector.EpisodeBuffer(**columns))
    with writing_to(path.parent):
        minari.create_dataset_from_buffers(
            f"{path.name}-v0",
            buffers,
            action_space=action_space or spaces.Box(-1, 1, act[0].shape[1:], act[0].dtype),
            observation_space=seen or spaces.Box(-np.inf, np.inf, obs[0].shape[1:], obs[0].dtype),
            data_format=form,
        )
    return path.with_name(f"{path.name}-v0").rename(path)


def made(
    kind: Any = np.float64, spec: Any = SWINGUP, lengths: tuple[int, ...] = (200, 7, 3)
) -> dict[str, Any]:
    rng = np.random.default_rng(0)
    act = [spec.random_actions(n, rng).astype(kind) for n in lengths]
    return {
        "obs": [rng.uniform(-0.4, 0.4, (n + 1, spec.obs_size)).astype(kind) for n in lengths],
        "act": [one.argmax(axis=1) for one in act] if spec.discrete else act,
        "ended": [n < 200 for n in lengths],
        "rewards": [rng.normal(size=n) for n in lengths],
    }
