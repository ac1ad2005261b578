"""Demonstrations, files of them, and how a file is refused."""

import json
import warnings
from pathlib import Path
from typing import Any

import minari
import numpy as np
import pyarrow as pa
import pytest
from gymnasium import spaces

from harness.demonstrations.reading import read
from harness.demonstrations.recording import AS_IT_IS, Reading
from harness.registry import SPECS, BadInput
from methods.base import Episodes

SWINGUP, CHOICES = SPECS["swingup"], SPECS["cartpole_discrete"]
FORMS = ("hdf5", "parquet", "arrow")
"""Formats of Minari."""
FLAGS = ("terminations", "truncations")


def made(
    lengths: tuple[int, ...] = (200, 7, 3), ended: tuple[bool, ...] = (False, True, True), spec: Any = SWINGUP
) -> tuple[Episodes, tuple[np.ndarray, ...]]:
    """Return episodes and rewards."""
    rng = np.random.default_rng(0)
    obs = tuple(
        rng.uniform(-0.4, 0.4, (n + 1, spec.obs_size)).astype(np.float32).astype(float) for n in lengths
    )
    act = tuple(spec.random_actions(n, rng) for n in lengths)
    return Episodes(obs, act, ended), tuple(rng.normal(size=n) for n in lengths)


def same(one: Episodes, other: Episodes) -> bool:
    pairs = zip((*one.obs, *one.act), (*other.obs, *other.act), strict=True)
    return all(map(np.array_equal, *zip(*pairs, strict=True))) and one.terminated == other.terminated


def refused(path: Path, why: str, spec: Any = SWINGUP, bounds: Any = None, how: Reading = AS_IT_IS) -> None:
    """Assert that a file is refused in a line that says why."""
    with pytest.raises(BadInput, match=f"no demonstrations of {spec.name}: ") as error:
        read(path, spec, bounds, how)
    assert str(error.value).isprintable()
    assert why in str(error.value), str(error.value)


def imitation(path: Path, episodes: Episodes, rewards: Any, parts: int = 2, act: Any = None) -> Path:
    """Make a folder as `datasets` of imitation's trajectories is saved, with every end called terminal, and
    texts in `infos` that would run something if they were decoded."""
    path.mkdir()
    rows = {
        "obs": [obs.tolist() for obs in episodes.obs],
        "acts": [a.tolist() for a in (episodes.act if act is None else act)],
        "infos": [
            ['{"py/reduce": [{"py/function": "os.abort"}, {"py/tuple": []}]}'] * n for n in episodes.lengths
        ],
        "terminal": [True] * len(episodes),
        "rews": [r.tolist() for r in rewards],
    }
    names = []
    for part in range(parts):
        table = pa.table({name: values[part::parts] for name, values in rows.items()})
        names.append(f"data-{part:05d}-of-{parts:05d}.arrow")
        with pa.OSFile(str(path / names[-1]), "wb") as file, pa.ipc.new_stream(file, table.schema) as stream:
            stream.write_table(table)
    (path / "state.json").write_text(json.dumps({"_data_files": [{"filename": name} for name in names]}))
    return path


def minari_folder(
    path: Path,
    form: str,
    content: Any,
    space: spaces.Space[Any] | None = None,
    kind: Any = None,
    **changes: Any,
) -> Path:
    """Make a dataset as Minari writes it, of episodes and rewards; those that did not end were cut.

    space: of actions. kind: of numbers. changes: of each episode's buffer, or its observation_space.
    """
    (episodes, rewards), discrete = content, isinstance(space, spaces.Discrete)
    seen, buffers = changes.pop("observation_space", None), []
    for obs, act, end, paid in zip(episodes.obs, episodes.act, episodes.terminated, rewards, strict=True):
        last = np.arange(len(act)) == len(act) - 1
        columns: Any = {
            "observations": obs.astype(kind or float),
            "actions": act.argmax(axis=1) + space.start if discrete else act.astype(kind or float),
            "rewards": paid,
            "terminations": last & end,
            "truncations": last & (not end),
            "infos": {},
        }
        buffers.append(minari.data_collector.EpisodeBuffer(**columns | changes))
    size = episodes.obs[0].shape[1:]
    with pytest.MonkeyPatch.context() as patch, warnings.catch_warnings():
        warnings.simplefilter("ignore")  # about an author and more, which it is not given
        patch.setenv("MINARI_DATASETS_PATH", str(path.parent))
        minari.create_dataset_from_buffers(
            f"{path.name}-v0",
            buffers,
            action_space=space or spaces.Box(-1, 1, episodes.act[0].shape[1:], kind or np.float64),
            observation_space=seen or spaces.Box(-np.inf, np.inf, size, kind or np.float64),
            data_format=form,
        )
    return path.with_name(f"{path.name}-v0").rename(path)
