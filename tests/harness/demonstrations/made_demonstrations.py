"""Demonstrations, files of them, and how a file is refused."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest

from harness.demonstrations.reading import read
from harness.registry import SPECS, BadInput
from methods.base import Episodes

SWINGUP, CHOICES = SPECS["swingup"], SPECS["cartpole_discrete"]


def made(
    lengths: tuple[int, ...] = (200, 7, 3), ended: tuple[bool, ...] = (False, True, True), spec: Any = SWINGUP
) -> tuple[Episodes, tuple[np.ndarray, ...]]:
    """Episodes and rewards."""
    rng = np.random.default_rng(0)
    obs = tuple(
        rng.uniform(-0.4, 0.4, (n + 1, spec.obs_size)).astype(np.float32).astype(float) for n in lengths
    )
    act = tuple(spec.random_actions(n, rng) for n in lengths)
    return Episodes(obs, act, ended), tuple(rng.normal(size=n) for n in lengths)


def same(one: Episodes, other: Episodes) -> bool:
    pairs = zip((*one.obs, *one.act), (*other.obs, *other.act), strict=True)
    return all(map(np.array_equal, *zip(*pairs, strict=True))) and one.terminated == other.terminated


def refused(path: Path, why: str, spec: Any = SWINGUP, bounds: Any = None) -> None:
    """Assert that a file is refused in a line that says why."""
    with pytest.raises(BadInput, match=f"no demonstrations of {spec.name}: ") as error:
        read(path, spec, bounds)
    assert str(error.value).isprintable()
    assert why in str(error.value)


def imitation(path: Path, episodes: Episodes, rewards: Any, parts: int = 2, act: Any = None) -> Path:
    """A folder as `datasets` of imitation's trajectories is saved, with every end called terminal, and texts
    in `infos` that would run something if they were decoded."""
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
