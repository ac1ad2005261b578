"""Answers of a task that no task may give, and batches that answer otherwise than the task."""

from __future__ import annotations

import re
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import pytest
from gymnasium import spaces

from envs import EnvSpec, from_gymnasium
from envs.copies import try_out
from harness.registry.contract.tasks import checks
from methods.base import Array
from tests.harness.odd_env import LIMIT, Odd, after, lengths, never, one


def at(step: int, value: Any, usual: Callable[[Odd], Any]) -> Callable[[Odd], Any]:
    return lambda env: value if env.steps == step else usual(env)


def steady(env: Odd) -> np.ndarray:
    return env.buffer.copy()


NAN = np.array([0, np.nan], np.float32)
REFUSED: dict[str, tuple[dict[str, Any], str]] = {
    "whole actions": ({"act": spaces.Box(0, 9, (2,), np.int32)}, "have 100 combinations, more than the 64"),
    "bytes": ({"act": spaces.Box(0, 255, (2,), np.uint8)}, "have 65,536 combinations"),
    "no bounds": ({"act": spaces.Box(-np.inf, np.inf, (2,))}, "actions must have bounds"),
    "one bound": ({"act": spaces.Box(np.array([0, -np.inf]), 1, dtype=np.float64)}, "must have bounds"),
    "no action": ({"act": spaces.Box(-1, 1, (0,))}, "actions must have a component, which .* wrap= of"),
    "parts in order": (
        {"act": spaces.Tuple([spaces.Discrete(2), spaces.Discrete(3)])},
        "choices or bounded numbers, not Tuple.* wrap= of",
    ),
    "many choices": ({"act": spaces.MultiDiscrete([9, 8])}, "have 72 combinations"),
    "parts": ({"act": spaces.Dict({"gas": spaces.Discrete(2)})}, "choices or bounded numbers, not Dict"),
    "no limit": ({"limit": None}, "no time limit"),
    "NaN at first": ({"observe": at(0, NAN, steady)}, "gives nan as observation 1 after step 0"),
    "NaN later": ({"observe": at(7, NAN, steady)}, "gives nan as observation 1 after step 7"),
    "infinite": (
        {"observe": at(3, np.array([0, -np.inf]), steady)},
        "gives -inf as observation 1 after step 3",
    ),
    "a reward of NaN": ({"pay": at(5, np.nan, one)}, "gives nan as reward of step 5"),
    "a huge reward": ({"pay": at(5, 1e200, one)}, r"gives 1e\+200 as reward of step 5"),
    "two rewards": (
        {"pay": at(5, np.ones(2), one)},
        r"gives array\(\[1., 1.\]\) as reward of step 5, which must be one number",
    ),
    "no reward": ({"pay": at(5, None, one)}, "gives None as reward of step 5, which must be real numbers"),
    "a text": ({"pay": at(5, "1", one)}, "gives '1' as reward of step 5, which must be real numbers"),
    "a masked reward": ({"pay": at(5, np.ma.masked, one)}, "gives masked as reward of step 5"),
    "a complex reward": ({"pay": at(5, 1j, one)}, "gives 1j as reward of step 5"),
    "a masked observation": (
        {"observe": at(4, np.ma.array([1.0, 2.0], mask=[1, 0]), steady)},
        r"gives masked_array\(.* as observation of step 4, which must be real numbers without a mask",
    ),
    "a complex observation": ({"observe": at(4, np.array([1j, 0]), steady)}, "as observation of step 4"),
    "texts observed": ({"observe": at(0, np.array(["1", "2"]), steady)}, "as observation of step 0"),
    "rows of several lengths": ({"observe": at(4, [[1.0], [1.0, 2.0]], steady)}, "as observation of step 4"),
    **{
        f"{name} {i}": (
            {name: at(6, value, never)},
            re.escape(
                f"gives {' '.join(repr(value).split())} as {said} of step 6, which must be true or false"
            ),
        )
        for name, said in (("end", "terminated"), ("cut", "truncated"))
        for i, value in enumerate(
            ("no", None, float("nan"), 1, np.array([False, True]), np.ma.array([True], mask=[False]))
        )
    },
    "another shape": ({"observe": at(2, np.zeros((2, 1)), steady)}, r"of the shape \(2, 1\), not \(2,\)"),
    "less": ({"observe": at(2, np.zeros(1), steady)}, r"of the shape \(1,\), not \(2,\)"),
}


@pytest.mark.parametrize("what", REFUSED)
def test_what_no_task_may_give_is_refused_by_name(task: Callable[..., str], what: str) -> None:
    """By `from_gymnasium`, and of a task that is written down by `try_out`, a step and `check`."""
    odd, why = REFUSED[what]
    env_id = task(**odd)
    with pytest.raises(ValueError, match=why):
        from_gymnasium(env_id, "odd")
    if "act" in odd or "limit" in odd:
        return
    spec = EnvSpec("odd", env_id, 2, 2, (1.0, 1.0), LIMIT)
    with pytest.raises(ValueError, match=why):
        try_out(spec)
    with pytest.raises(ValueError, match=f"the task odd gives|{why}"):
        lengths(spec)
    if {"end", "cut"} & odd.keys():
        return  # which Gymnasium's own checks may not reach
    failed = {check.title: check.outcome()[1] for check in checks(spec) if check.outcome()[0] == "FAILED"}
    assert any("odd gives" in told for told in failed.values())


class Batch:
    """Copies of `Odd` that forget that they truncate."""

    def __init__(self, count: int) -> None:
        self.steps = np.zeros(count)

    def reset(self, place: int, seed: int) -> Array:
        self.steps[place] = 0
        return self._seen([place], seed)[0]

    def _seen(self, places: Any, seed: int) -> Array:
        return np.column_stack([self.steps[places], np.full(len(places), 0.5)])

    def step(self, places: Any, act: Array) -> Any:
        self.steps[places] += 1
        return self._seen(places, 0), np.ones(len(places)), np.zeros(len(places), bool)


def test_a_batch_that_forgets_to_truncate_breaks_the_contract(task: Callable[..., str]) -> None:
    def start(env: Odd) -> Any:
        return np.array([env.steps, 0.5], np.float32)

    for cut, outcome in ((never, "ok"), (after(8), "FAILED")):
        spec = from_gymnasium(task(observe=start, cut=cut), "odd", batch=Batch)
        (found,) = [check.outcome()[0] for check in checks(spec) if check.title.startswith("copies step")]
        assert found == outcome


class Wrong(Batch):
    """What it gives of the third copy is another number from its tenth step on."""

    def __init__(self, entry: int, count: int) -> None:
        super().__init__(count)
        self.entry = entry

    def step(self, places: Any, act: Array) -> Any:
        given = list(super().step(places, act))
        for row in np.flatnonzero((np.asarray(places) == 2) & (self.steps[places] >= 10)):
            given[self.entry][(row, 1) if self.entry == 0 else row] = 2
        return tuple(given)


@pytest.mark.parametrize(
    ("entry", "why"),
    [
        (0, r"gives obs \[10. 2.\], alone \[10. 0.5\]"),
        (1, "gives reward 2.0, alone 1.0"),
        (2, "gives terminated True, alone False"),
    ],
)
def test_where_a_batch_is_wrong_step_copy_and_entry_are_told(
    task: Callable[..., str], entry: int, why: str
) -> None:
    def start(env: Odd) -> Any:
        return np.array([env.steps, 0.5], np.float32)

    spec = from_gymnasium(task(observe=start), "odd", batch=partial(Wrong, entry))
    (told,) = [check.outcome()[1] for check in checks(spec) if check.title.startswith("copies step")]
    assert re.match(rf"at step \d+, copy 2 of a batch {why}", told), told
