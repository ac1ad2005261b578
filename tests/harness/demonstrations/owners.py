"""Files of demonstrations of one task, laid out as the owners of each form write them."""

import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import h5py
import numpy as np
import pyarrow as pa
from pyarrow import parquet

from envs import from_gymnasium

PENDULUM = from_gymnasium("Pendulum-v1", "pendulum_of_gymnasium")
LENGTHS = (20, 7, 30)


class Played(NamedTuple):
    """An episode: obs (T+1, 3), native torques (T, 1), and rewards (T,)."""

    obs: Any
    act: Any
    rewards: Any


def play() -> list[Played]:
    """Return episodes of random actions, of `LENGTHS` steps."""
    env, rng, episodes = PENDULUM.make(), np.random.default_rng(0), []
    for seed, steps in enumerate(LENGTHS):
        obs, rewards = [env.reset(seed=seed)[0]], []
        scaled = rng.uniform(-1, 1, (steps, 1))
        for act in scaled:
            after, reward, *_ = env.step(act)
            obs.append(after)
            rewards.append(reward)
        episodes.append(Played(np.float64(obs), np.float32(2 * scaled), np.array(rewards)))
    return episodes


def stacked(episodes: Sequence[Played]) -> dict[str, Any]:
    """Return columns of all steps, with the observations before and after each."""
    return {
        "before": np.concatenate([one.obs[:-1] for one in episodes]),
        "after": np.concatenate([one.obs[1:] for one in episodes]),
        "act": np.concatenate([one.act for one in episodes]),
        "rewards": np.concatenate([one.rewards for one in episodes]),
        "last": np.concatenate([np.arange(len(one.act)) == len(one.act) - 1 for one in episodes]),
        "frame": np.concatenate([np.arange(len(one.act)) for one in episodes]),
        "episode": np.repeat(np.arange(len(episodes)), [len(one.act) for one in episodes]),
    }


def d4rl(path: Path, episodes: Sequence[Played], after: bool = False) -> Path:
    with h5py.File(path := path.with_suffix(".hdf5"), "w") as file:
        for name, column in d4rl_columns(episodes, after).items():
            file[name] = column
        file["infos/qpos"] = np.zeros(3)
    return path


def d4rl_columns(episodes: Sequence[Played], after: bool = False) -> dict[str, Any]:
    steps = stacked(episodes)
    more = {"next_observations": steps["after"]} if after else {}
    return {
        **{"observations": steps["before"], "actions": steps["act"], "rewards": steps["rewards"]},
        **{"terminals": np.zeros(len(steps["act"]), bool), "timeouts": steps["last"]},
        **more,
    }


def dictionary(path: Path, episodes: Sequence[Played]) -> Path:
    np.savez(path := path.with_suffix(".npz"), **d4rl_columns(episodes))
    return path


def robomimic(path: Path, episodes: Sequence[Played], after: bool = True) -> Path:
    """As its `dataset_states_to_obs.py` writes them, from the twelfth on as demo_11."""
    with h5py.File(path := path.with_suffix(".hdf5"), "w") as file:
        for i, one in enumerate(episodes):
            demo = file.create_group(f"data/demo_{9 + i}")
            demo["actions"], demo["rewards"] = one.act, one.rewards
            demo["dones"] = np.arange(len(one.act)) >= len(one.act) - 2
            for name, obs in {"obs": one.obs[:-1], "next_obs": one.obs[1:]}.items():
                if name == "obs" or after:
                    demo[f"{name}/rate"], demo[f"{name}/direction"] = obs[:, 2], obs[:, :2]
                    demo[f"{name}/image"] = np.zeros((len(obs), 4, 4, 3), np.uint8)
    return path


def lerobot(path: Path, episodes: Sequence[Played], version: str) -> Path:
    """A file for each episode until version 2.1, and one of all since."""
    steps = stacked(episodes)
    columns = {
        "observation.state": pa.array(
            [*map(list, np.float32(steps["before"][:, :2]))], pa.list_(pa.float32())
        ),
        "observation.rate": pa.array(np.float32(steps["before"][:, 2])),
        "action": pa.FixedSizeListArray.from_arrays(pa.array(steps["act"].ravel()), 1),
        "next.reward": pa.array(np.float32(steps["rewards"])),
        "next.done": pa.array(steps["last"]),
        **{
            "frame_index": steps["frame"],
            "episode_index": steps["episode"],
            "task_index": 0 * steps["frame"],
        },
    }
    shapes = {"observation.state": ("float32", [2]), "observation.image": ("video", [3, 4, 4])}
    features = {name: {"dtype": "float32", "shape": [1]} for name in columns} | {
        name: {"dtype": kind, "shape": shape, "names": None} for name, (kind, shape) in shapes.items()
    }
    info = {"codebase_version": version, "total_frames": len(steps["act"]), "features": features}
    (path / "meta").mkdir(parents=True)
    (path / "data/chunk-000").mkdir(parents=True)
    (path / "meta/info.json").write_text(json.dumps(info))
    table = pa.table(columns)
    if version == "v3.0":
        parquet.write_table(table, path / "data/chunk-000/file-000.parquet")
    for i in range(len(episodes) if version == "v2.1" else 0):
        one = table.filter(pa.array(steps["episode"] == i))
        parquet.write_table(one, path / f"data/chunk-000/episode_{i:06d}.parquet")
    return path


def il_columns(episodes: Sequence[Played]) -> dict[str, Any]:
    """As its `baseline_collate` makes them: actions and starts are flat."""
    steps = stacked(episodes)
    return {
        **{"obs": steps["before"], "actions": steps["act"].reshape(-1), "rewards": steps["rewards"]},
        **{"episode_returns": np.zeros(len(episodes)), "episode_starts": 1.0 * (steps["frame"] == 0)},
    }


def il_datasets(path: Path, episodes: Sequence[Played]) -> Path:
    np.savez(path := path.with_suffix(".npz"), **il_columns(episodes))
    return path


def il_lines(path: Path, episodes: Sequence[Played]) -> Path:
    """As its `baseline_to_huggingface` writes them."""
    columns = {
        name: column.tolist() for name, column in il_columns(episodes).items() if name != "episode_returns"
    }
    rows = [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)]
    (path := path.with_suffix(".jsonl")).write_text("".join(f"{json.dumps(row)}\n" for row in rows))
    return path


def il_folder(path: Path, episodes: Sequence[Played]) -> Path:
    """As `datasets` saves what it loads of those lines."""
    columns = il_columns(episodes)
    del columns["episode_returns"]
    table = pa.table({name: pa.array(column.tolist()) for name, column in columns.items()})
    path.mkdir()
    for name, part in (("a.arrow", table[:25]), ("b.arrow", table[25:])):
        with pa.OSFile(str(path / name), "wb") as file, pa.ipc.new_stream(file, table.schema) as stream:
            stream.write_table(part)
    files = [{"filename": "a.arrow"}, {"filename": "b.arrow"}]
    (path / "state.json").write_text(json.dumps({"_data_files": files}))
    return path


Writer = Callable[[Path, Sequence[Played]], Path]
STATE_KEYS, MIMIC_KEYS = ("observation.state", "observation.rate"), ("direction", "rate")
WITHOUT_LAST: dict[str, tuple[Writer, tuple[str, ...]]] = {
    "D4RL": (d4rl, ()),
    "D4RL, npz": (dictionary, ()),
    "il-datasets": (il_datasets, ()),
    "il-datasets, lines": (il_lines, ()),
    "il-datasets, folder": (il_folder, ()),
    "LeRobot 3.0": (lambda path, episodes: lerobot(path, episodes, "v3.0"), STATE_KEYS),
    "LeRobot 2.1": (lambda path, episodes: lerobot(path, episodes, "v2.1"), STATE_KEYS),
    "robomimic": (lambda path, episodes: robomimic(path, episodes, False), MIMIC_KEYS),
}
WITH_LAST: dict[str, tuple[Writer, tuple[str, ...]]] = {
    "D4RL": (lambda path, episodes: d4rl(path, episodes, True), ()),
    "robomimic": (robomimic, MIMIC_KEYS),
}
