"""A recording: episodes as a file holds them, for whatever task."""

from __future__ import annotations

import importlib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from harness.registry import BadInput, LastObservation
from harness.registry.packages import to_install

OWN_FORM = "npz"
"""The form of this project's files."""
NUMBERS, FLAT = "fiub", "flat rows of numbers are needed"
ONE_MORE = (
    "an episode has one observation more than actions, of where its last one led; without it, give "
    "--last-observation repeat or drop"
)
Bounds = NDArray[np.float64]
"""Lowest and highest actions: (2, A), or (2, 1) where all components have the same."""


@dataclass(frozen=True)
class Reading:
    """Options for files that do not say by themselves how to read them.

    `last_observation`: for episodes with as many observations as actions. 'repeat' repeats the last
    observation. 'drop' leaves out the last action, so that the episode counts as cut.
    `obs_keys`: names of the file's observations, in the order of the task's.
    """

    last_observation: LastObservation | None = None
    obs_keys: tuple[str, ...] = ()


AS_IT_IS = Reading()


@dataclass(frozen=True)
class Recording:
    """Episodes as a file holds them.

    `form`: name of the file's form. `arrays`: as of `harness.demonstrations.arrays`, with the file's types
    and units; choices may be whole numbers (sum of T,), and act is (sum of T, 0) where actions are not known.
    `bounds`: None where a file has none, infinite where Minari lacks them. `first`: number of the first
    choice, if the file says it. `unended`: episodes that neither terminated nor were cut. `states`: the first
    number of an observation and how many there are, if the file says that observations are single numbers.
    Raises ValueError for arrays of different episodes, and for bounds whose low one is above the high one.
    """

    form: str
    arrays: dict[str, NDArray[Any]]
    bounds: Bounds | None = None
    first: int | None = None
    unended: tuple[int, ...] = ()
    states: tuple[int, int] | None = None

    def __post_init__(self) -> None:
        bounds = {} if self.bounds is None else {"bounds": self.bounds}
        for name, array in (self.arrays | bounds).items():
            if array.dtype.kind not in NUMBERS or array.ndim == 0:
                raise ValueError(f"its {name} is {array.dtype} {array.shape}; {FLAT}")
        lengths, steps, ends = self.arrays["lengths"], len(self.arrays["act"]), self.arrays["terminated"]
        if lengths.dtype.kind not in "iu" or lengths.ndim != 1:
            raise ValueError(f"its lengths are {lengths.dtype} {lengths.shape}; whole numbers are needed")
        if not len(lengths):
            raise ValueError("it holds no episode")
        if ends.shape != lengths.shape or not np.isin(ends, (0, 1)).all():
            raise ValueError("its endings must be true or false, one for each episode")
        if (shortest := lengths.min()) < 1:
            raise ValueError(
                f"episode {lengths.argmin()} has {shortest} steps; leave out episodes without any"
            )
        if lengths.max() > steps or lengths.sum() != steps:
            raise ValueError(f"its lengths do not sum to its {steps} actions")
        observed = len(self.arrays["obs"])
        if observed != steps + len(lengths):
            hint = f"; {ONE_MORE}" if observed == steps else ""
            raise ValueError(f"it has {observed} observations for {steps} actions{hint}")
        if self.arrays.get("rewards", np.zeros(steps)).shape != (steps,):
            raise ValueError(f"it has rewards {self.arrays['rewards'].shape} for {steps} steps")
        if self.bounds is not None and not (
            self.bounds.ndim == 2 and len(self.bounds) == 2 and (self.bounds[0] <= self.bounds[1]).all()
        ):
            raise ValueError(f"its bounds {self.bounds.shape} are no (2, A) of lows and highs")

    @property
    def calls_all_ends_terminal(self) -> bool:
        """True where an end at the horizon may be called terminal, though it was cut there."""
        return self.form.startswith(("imitation", "il-datasets", "robomimic", "LeRobot"))

    @property
    def has_actions(self) -> bool:
        """True where actions are known."""
        return self.arrays["act"].shape[1:] != (0,)


class Episode(NamedTuple):
    """An episode of T steps: obs (T+1, O), act (T, A) or (T,), whether it terminated, and rewards (T,)."""

    obs: NDArray[Any]
    act: NDArray[Any]
    terminated: object
    rewards: NDArray[Any] | None


def joined(episodes: Sequence[Episode]) -> dict[str, NDArray[Any]]:
    """Return episodes as `Recording.arrays`, where obs may lack the last rows of all. Raises ValueError for
    rows of several shapes, and for an episode that has not one observation more than actions."""
    if not episodes:
        raise ValueError("it holds no episode")
    lack_last = all(len(one.obs) == len(one.act) for one in episodes)
    for i, one in enumerate(episodes):
        if {one.obs.dtype.kind, one.act.dtype.kind} - {*NUMBERS}:
            raise ValueError(f"episode {i} observes {one.obs.dtype}, acts {one.act.dtype}; {FLAT}")
        steps = len(one.act)
        if len(one.obs) != steps + 1 and not lack_last:
            hint = f" and as many actions; {ONE_MORE}" if len(one.obs) == steps else f" for {steps} actions"
            raise ValueError(f"episode {i} has {len(one.obs)} observations{hint}")
        if one.rewards is not None and len(one.rewards) != steps:
            raise ValueError(f"episode {i} has {len(one.rewards)} rewards for {steps} actions")
    rewards = [one.rewards for one in episodes if one.rewards is not None]
    arrays = {
        "obs": np.concatenate([one.obs for one in episodes]),
        "act": np.concatenate([one.act for one in episodes]),
        "lengths": np.array([len(one.act) for one in episodes]),
        "terminated": np.array([one.terminated for one in episodes]),
    }
    return arrays | ({"rewards": np.concatenate(rewards)} if len(rewards) == len(episodes) else {})


def completed(arrays: dict[str, NDArray[Any]], how: LastObservation | None) -> dict[str, NDArray[Any]]:
    """Return arrays whose episodes end with an observation, of ones that end with an action.

    how: as of `Reading`. None leaves arrays as they are. Where actions are not known, it is 'drop'.
    Arrays that need no change, or that `Recording` refuses, are returned as they are. Raises ValueError for
    'drop' where an episode has one step.
    """
    obs, act, lengths = (arrays[name] for name in ("obs", "act", "lengths"))
    how = how or ("drop" if act.shape[1:] == (0,) else None)
    ends = np.cumsum(lengths) if lengths.dtype.kind in "iu" and lengths.ndim == 1 else np.array([])
    if how is None or len(obs) != len(act) or not len(ends) or lengths.min() < 1 or ends[-1] != len(act):
        return arrays
    is_last = np.zeros(len(act), bool)
    is_last[ends.astype(np.int64) - 1] = True
    if how == "repeat":
        return arrays | {"obs": obs.repeat(1 + is_last, axis=0)}
    if lengths.min() == 1:
        raise ValueError(
            f"episode {lengths.argmin()} has one step, which is its last; leave it out of the file, or give "
            "--last-observation repeat"
        )
    shorter = {
        name: arrays[name][~is_last] for name in ("act", "rewards") if len(arrays.get(name, ())) == len(act)
    }
    return arrays | shorter | {"lengths": lengths - 1, "terminated": np.zeros(len(lengths), bool)}


def extra(module: str) -> Any:
    """Return a module that the extra `minari` installs. Raises BadInput where it cannot be imported."""
    try:
        return importlib.import_module(module)
    except ImportError as error:
        reason = f"{module} cannot be imported: {to_install('minari')}"
        raise BadInput(reason, page="demonstrations") from error
