"""Forms that hold the steps of all episodes one after the other, each step with what was observed before it.

D4RL's names are observations, actions, rewards, terminals and timeouts, and optionally next_observations. An
episode ends at each terminal and timeout, and with the last step. il-datasets' are obs, actions, rewards and
episode_starts, as its `baseline_collate` and `baseline_to_huggingface` write them. It does not say whether an
episode terminated. Its `baseline_collate` writes actions of several components one after the other.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from harness.demonstrations.forms.content import rows, table, without_keys
from harness.demonstrations.recording import FLAT, Reading, Recording, completed

D4RL = ("observations", "actions", "rewards", "terminals", "timeouts", "next_observations")
"""Columns of D4RL. The first and the fourth are needed."""
IL_DATASETS = ("obs", "actions", "rewards", "episode_starts")
"""Columns of il-datasets. The first and the last are needed."""
Columns = Mapping[str, NDArray[Any]]


def of_d4rl(columns: Columns, how: Reading) -> Recording:
    """Return the episodes of D4RL's columns."""
    count = len(columns["observations"])
    terminal = _flags(columns, "terminals", count)
    ends = np.flatnonzero(terminal | _flags(columns, "timeouts", count)) + 1
    after = columns.get("next_observations")
    return recording("D4RL", columns["observations"], columns, ends, terminal, how, after)


def of_il_datasets(columns: Columns, how: Reading) -> Recording:
    """Return the episodes of il-datasets' columns."""
    obs, columns = columns["obs"], {**columns}
    for name in ("actions", "episode_starts"):
        if name in columns and len(obs) and len(columns[name]) != len(obs):
            columns[name] = columns[name].reshape(len(obs), -1)
    starts = columns["episode_starts"].reshape(len(obs), -1)[:, 0] == 1
    if not starts[:1].all():
        raise ValueError("its first step starts no episode")
    ends = np.flatnonzero(starts)[1:]
    return recording("il-datasets", obs, columns, ends, np.ones(len(obs), bool), how)


def of_lines(path: Path, how: Reading) -> Recording:
    """Return the episodes of il-datasets' file for Hugging Face, with a JSON object for each step."""
    return of_tables([table(path, "json")], how)


def of_tables(tables: Sequence[Any], how: Reading) -> Recording:
    """Return the episodes of Arrow tables with il-datasets' columns, one after the other."""
    there = {*tables[0].column_names}
    if not {"obs", "episode_starts"} <= there:
        raise ValueError(f"it has none of the sets of columns that are known, but {sorted(there)}")
    columns = {
        name: np.concatenate([rows(one[name].combine_chunks()) for one in tables])
        for name in IL_DATASETS
        if name in there
    }
    return of_il_datasets(columns, how)


def recording(
    form: str,
    obs: NDArray[Any],
    columns: Columns,
    ends: NDArray[Any],
    terminal: NDArray[np.bool_],
    how: Reading,
    after: NDArray[Any] | None = None,
) -> Recording:
    """Return the episodes of N steps.

    `obs`: (N, O) before each step. `after`: (N, O) after each step, where known.
    `columns`: actions (N, A) or choices (N,), and rewards (N,), where known.
    `ends`: the number of steps before each end of an episode, but for the last one.
    `terminal`: (N,) true where an episode that ends there has terminated.
    """
    if form != "LeRobot":
        without_keys(form, how)
    if not (count := len(obs)):
        raise ValueError("it holds no episode")
    act, rewards = columns.get("actions", np.zeros((count, 0))), columns.get("rewards")
    known = {"actions": act, "observations after steps": obs if after is None else after}
    for name, column in known.items():
        if column.ndim == 0 or len(column) != count:
            raise ValueError(f"it has {name} {column.dtype} {column.shape} for {count} steps")
    if act.ndim == 1 and act.dtype.kind == "f":
        act = act[:, None]
    ends = np.unique(np.append(ends, count))
    if after is not None:
        if after.shape != obs.shape:
            raise ValueError(f"its observations are {obs.shape} before and {after.shape} after steps; {FLAT}")
        obs = np.insert(obs, ends, after[ends - 1], axis=0)
    arrays = {"obs": obs, "act": act, "lengths": np.diff(ends, prepend=0), "terminated": terminal[ends - 1]}
    if rewards is not None:
        arrays["rewards"] = rewards[:, 0] if rewards.shape == (count, 1) else rewards
    return Recording(form, completed(arrays, how.last_observation))


def _flags(columns: Columns, name: str, count: int) -> NDArray[np.bool_]:
    """Return a column of flags, (N,), all false where it is absent."""
    flags = columns.get(name, np.zeros(count))
    if flags.size != count or not np.isin(flags, (0, 1)).all():
        raise ValueError(f"its {name} must be true or false, one for each of {count} steps")
    return flags.reshape(count).astype(bool)
