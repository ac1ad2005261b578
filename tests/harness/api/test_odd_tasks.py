"""Tasks of others that are odd: what they mean is what happens, or they are refused at once by name."""

from __future__ import annotations

import dataclasses
import itertools
import re
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium import spaces
from gymnasium.envs.registration import EnvSpec as Registered
from gymnasium.envs.registration import WrapperSpec
from gymnasium.wrappers import TimeLimit

from envs import EnvSpec, Shape, from_gymnasium
from envs.copies import Copies, alone, try_out
from envs.scaled import scaled
from harness.api.exported import Exported, ExportedPolicy, LearnedReward
from harness.demonstrations.reading import read
from harness.registry import BadInput
from harness.registry.contract.tasks import checks
from harness.rl.simulator import Simulator, drawings
from harness.rl.training_env import TrainingEnv
from methods.base import Array

LIMIT = 20
BOX = spaces.Box(-1.0, 1.0, (2,), np.float32)


class Odd(gym.Env):
    """It observes the steps taken and a start in [0, 1], pays 1, and keeps what it was told to do."""

    observation_space = spaces.Box(-np.inf, np.inf, (2,), np.float32)
    told: list[Any]

    def __init__(self, act: spaces.Space = BOX, **odd: Any) -> None:
        self.action_space, self.odd, self.steps = act, odd, 0
        self.told = []
        self.buffer = np.zeros(2, np.float32)

    def seen(self) -> Any:
        self.buffer[:] = self.steps, self.start
        if "observe" in self.odd:
            return self.odd["observe"](self)
        return self.buffer if self.odd.get("reuse") else self.buffer.copy()

    def reset(self, *, seed: int | None = None, options: dict | None = None) -> tuple:
        super().reset(seed=seed)
        self.steps, self.start = 0, self.np_random.random()
        return self.seen(), {}

    def step(self, action: Any) -> tuple:
        assert self.action_space.contains(action), action
        self.told.append(action)
        self.steps += 1
        pay, end, cut = (
            self.odd.get(name, of) for name, of in (("pay", one), ("end", never), ("cut", never))
        )
        return self.seen(), pay(self), end(self), cut(self), {}


def one(env: Odd) -> Any:
    return 1.0


def never(env: Odd) -> Any:
    return False


def after(steps: int) -> Callable[[Odd], bool]:
    return lambda env: env.steps >= steps


@pytest.fixture
def task(monkeypatch: pytest.MonkeyPatch) -> Callable[..., str]:
    """Registers an odd task, or one that a function makes, for the test alone; its id."""
    numbers = itertools.count()

    def register(
        entry: Callable[..., gym.Env] | None = None,
        limit: int | None = LIMIT,
        wrapped: tuple = (),
        **odd: Any,
    ) -> str:
        env_id = f"irl_bench_tests/Odd{next(numbers)}-v0"
        spec = Registered(
            env_id,
            entry or partial(Odd, **odd),
            max_episode_steps=limit,
            disable_env_checker=True,
            additional_wrappers=wrapped,
        )
        monkeypatch.setitem(gym.registry, env_id, spec)
        return env_id

    return register


def lengths(spec: EnvSpec, count: int = 4) -> set[tuple[int, bool, str]]:
    episodes = Simulator(spec, lanes=3).run(lambda obs: np.zeros((len(obs), spec.act_size)), range(count))
    return {(len(episode.act), episode.terminated, episode.ending) for episode in episodes}


def inner(env: gym.Env) -> Odd:
    its = env.unwrapped
    assert isinstance(its, Odd)
    return its


@pytest.mark.parametrize("start", [-5, -1, 0, 1, 7])
def test_choices_begin_where_the_task_says(task: Callable[..., str], start: int) -> None:
    derived = from_gymnasium(task(act=spaces.Discrete(3, start=start)), "odd")
    written = dataclasses.replace(derived, summary="written", wrap=lambda env: env)
    for spec in (derived, written):
        env = spec.make()
        assert env.action_space == spaces.Discrete(3)
        env.reset(seed=0)
        for choice in np.eye(3):
            env.step(spec.native(choice))
        assert inner(env).told == [start, start + 1, start + 2]


def test_a_files_numbers_of_choices_are_the_tasks_own(task: Callable[..., str], tmp_path: Path) -> None:
    obs, ends = np.zeros((3, 2)), {"lengths": np.array([2]), "terminated": np.array([True])}
    for start, act, chosen in (
        (0, [1, 2], [1, 2]),
        (1, [1, 2], [0, 1]),
        (-1, [-1, 1], [0, 2]),
        (1, np.eye(3)[[1, 2]], [1, 2]),
        (1, [0, 1], None),
    ):
        spec = from_gymnasium(task(act=spaces.Discrete(3, start=start)), "odd")
        np.savez(tmp_path / "shown.npz", obs=obs, act=np.array(act), **ends)
        if chosen is None:
            with pytest.raises(BadInput, match="choices must be whole numbers from 1 to 3"):
                read(tmp_path / "shown.npz", spec)
        else:
            assert read(tmp_path / "shown.npz", spec).episodes.act[0].argmax(axis=1).tolist() == chosen


def limited(steps: int) -> gym.Env:
    return TimeLimit(Odd(), steps)


INSIDE = {
    "in its code": {"cut": after(8)},
    "in its code, as an array": {"cut": lambda env: np.array([env.steps >= 8])},
    "in its own wrappers": {"entry": lambda **given: limited(8)},
    "in its own wrappers alone": {"entry": lambda **given: limited(8), "limit": None},
    "in a registered wrapper": {
        "wrapped": (WrapperSpec("TimeLimit", "gymnasium.wrappers:TimeLimit", {"max_episode_steps": 8}),)
    },
}


@pytest.mark.parametrize("where", INSIDE)
def test_an_episode_ends_where_the_task_truncates_it(task: Callable[..., str], where: str) -> None:
    spec = from_gymnasium(task(**INSIDE[where]), "odd")
    try_out(spec)
    assert lengths(spec) == {(8, False, "time limit")}
    env: Any = TrainingEnv(spec, "native", np.random.default_rng(0), 2)
    env.reset()
    steps = [env.step(np.zeros((2, 2), np.float32)) for _ in range(16)]
    assert [bool(done.all()) for _, _, done, _ in steps] == [i in (7, 15) for i in range(16)]
    for info in steps[7][3]:
        assert info["TimeLimit.truncated"]
        assert info["terminal_observation"][0] * spec.obs_scale[0] == pytest.approx(8)
    if "array" not in where:  # which Gymnasium's own checks do not take
        assert [check.outcome() for check in checks(spec) if check.outcome()[0] == "FAILED"] == []


def test_each_instance_may_truncate_where_it_likes(task: Callable[..., str]) -> None:
    later = itertools.count(5)

    def made(**given: Any) -> gym.Env:
        return Odd(cut=after(next(later)))

    assert len(lengths(from_gymnasium(task(made), "odd"), 6)) == 3  # of as many lanes
    limits = itertools.cycle([8, 12])
    with pytest.raises(ValueError, match="its time limit is 8 in one instance and 12 in another"):
        from_gymnasium(task(lambda **given: limited(next(limits))), "odd")


def test_what_terminates_as_it_is_truncated_has_terminated(task: Callable[..., str]) -> None:
    spec = from_gymnasium(task(cut=after(8), end=after(8)), "odd")
    assert lengths(spec) == {(8, True, "terminated")}


BOUNDS = {
    "a dead one": ([-2.0, 3.0], [2.0, 3.0], np.float32),
    "all dead": ([1.5, 0.0], [1.5, 0.0], np.float32),
    "a large dead one": ([-2.0, 1e9], [2.0, 1e9], np.float32),
    "different ones": ([-2.0, 0.0], [1.0, 5.0], np.float32),
    "far from zero": ([1000.1, -0.3], [1000.7, 0.7], np.float32),
    "64 bits": ([-2.0, 0.1], [1.0, 0.7], np.float64),
    "16 bits": ([-2.0, 0.1], [1.0, 0.7], np.float16),
}


@pytest.mark.parametrize("which", BOUNDS)
def test_actions_lie_within_their_own_bounds(task: Callable[..., str], which: str) -> None:
    low, high, kind = BOUNDS[which]
    box = spaces.Box(np.array(low, kind), np.array(high, kind), dtype=kind)
    spec = from_gymnasium(task(act=box), "odd")
    try_out(spec)
    env = spec.make()
    env.reset(seed=0)
    for act in ([-1.0, 1.0], [0.0, 0.0], [1.0, -1.0], [0.37, -0.61]):
        env.step(spec.native(np.array(act)))
        wanted = box.low.astype(float) + (np.array(act) + 1) / 2 * (box.high.astype(float) - box.low)
        # Actions have 32 bits at most.
        tolerance = 4 * max(np.finfo(kind).eps, 1e-7) * max(1, np.abs([low, high]).max())
        np.testing.assert_allclose(inner(env).told[-1], wanted, atol=tolerance)
    assert inner(env).told[0].tolist() == [box.low[0], box.high[1]]


def test_healthy_actions_are_scaled_as_gymnasium_scales_them() -> None:
    for low, high in (([-2.0], [2.0]), ([-0.4], [0.4]), ([-3.0], [1.0])):
        env = Odd(spaces.Box(np.array(low, np.float32), np.array(high, np.float32)))
        theirs = gym.wrappers.RescaleAction(env, np.float32(-1), np.float32(1))
        act = np.random.default_rng(0).uniform(-1, 1, (100, 1)).astype(np.float32)
        assert np.array_equal(scaled(env).action(act), theirs.action(act))


@pytest.mark.parametrize(
    ("low", "high", "kind"),
    [
        (0, 1e-45, np.float32),
        (0, 1e-38, np.float32),
        (1e8, 1e8 + 8, np.float32),
        (1e8, 1e8 + 32, np.float32),
        (-(2.0**24), 2.0**24 + 2, np.float32),
        (-3e38, 3e38, np.float32),
        (0, 5e-324, np.float64),
        (1e15, 1e15 + 1, np.float64),
        (-1.7e308, 1.7e308, np.float64),
        (60_000, 60_032, np.float16),
    ],
)
def test_odd_bounds_are_reached_and_what_lies_between_is_even(low: float, high: float, kind: Any) -> None:
    """A healthy component beside an odd one is scaled as ever."""
    with np.errstate(all="ignore"):
        box = spaces.Box(np.array([low, -2], kind), np.array([high, 2], kind), dtype=kind)
        its = scaled(Odd(box))
        done = np.array([its.action(np.full(2, act, np.float32)) for act in np.linspace(-1, 1, 21)])
    assert done.dtype == kind
    wanted = np.linspace(0, 1, 21) * float(box.high[0]) + np.linspace(1, 0, 21) * float(box.low[0])
    size = kind(max(abs(box.low[0]), abs(box.high[0])))
    step = float(np.nextafter(size, kind(0))) - float(size)
    half = float(box.high[0]) / 2 - float(box.low[0]) / 2
    assert (np.abs(done[[0, -1], 0].astype(float) - [box.low[0], box.high[0]]) <= 1e-9 * half).all()
    assert (np.abs(done[:, 0].astype(float) - wanted) <= abs(step) + 0.01 * half).all()
    assert np.allclose(done[:, 1].astype(float), np.linspace(-2, 2, 21), atol=4 * np.finfo(kind).eps + 1e-6)


def test_what_is_observed_is_copied(task: Callable[..., str]) -> None:
    own, reused = (from_gymnasium(task(reuse=reuse), "odd") for reuse in (False, True))
    assert reused.obs_scale == own.obs_scale
    for spec in (own, reused):
        (episode,) = Simulator(spec).run(lambda obs: np.zeros((len(obs), 2)), [0])
        assert episode.obs[:, 0].tolist() == [*range(LIMIT + 1)]
        assert [check.outcome() for check in checks(spec) if check.outcome()[0] == "FAILED"] == []

    def draw(env: gym.Env) -> dict[str, Shape]:
        return {"its": Shape(inner(env).buffer[None], (0, 0, 0))}

    frames = drawings(dataclasses.replace(own, draw=draw), 0, np.zeros((3, 2)))
    assert [frame["its"].points[0, 0] for frame in frames] == [0, 1, 2, 3]


def test_a_learned_reward_sees_where_a_step_began(task: Callable[..., str]) -> None:
    class Steps:
        absorbing = 0.0

        def __call__(self, obs: Array, act: Array, next_obs: Array, /) -> Array:
            return next_obs[:, 0] - obs[:, 0]

    spec = from_gymnasium(task(reuse=True, pay=of_one), "odd")
    learned = Exported(ExportedPolicy(lambda obs: np.zeros((len(obs), 2)), spec), Steps(), spec, {})
    env = LearnedReward(spec.make(), learned)
    env.reset(seed=0)
    for _ in range(3):
        _, paid, _, _, info = env.step(np.zeros(2, np.float32))
        assert (paid, info["true_reward"]) == (1.0, 1.0)


@pytest.mark.parametrize(
    ("size", "kind"), [(200, np.uint8), (60_000, np.float16), (1e30, np.float32), (1e-30, np.float32)]
)
def test_a_typical_size_is_what_is_observed(task: Callable[..., str], size: float, kind: type) -> None:
    spec = from_gymnasium(task(observe=lambda env: np.array([size, 0], kind)), "odd")
    assert spec.obs_scale == pytest.approx((float(kind(size)), 1.0), rel=1e-3)


def of_one(env: Odd) -> np.ndarray:
    return np.array([[1.0]], np.float32)


def now_and_then(env: Odd) -> Any:
    return np.array([1.0]) if env.steps % 3 else 1


@pytest.mark.parametrize("pay", [of_one, now_and_then, lambda env: np.int64(1), lambda env: True])
def test_a_reward_of_one_entry_is_a_number(task: Callable[..., str], pay: Callable[[Odd], Any]) -> None:
    spec = from_gymnasium(task(pay=pay), "odd")
    for episode in Simulator(spec).run(lambda obs: np.zeros((len(obs), 2)), range(3)):
        assert episode.rewards.tolist() == [1.0] * LIMIT
    assert [check.outcome() for check in checks(spec) if check.outcome()[0] == "FAILED"] == []


def at(step: int, value: Any, usual: Callable[[Odd], Any]) -> Callable[[Odd], Any]:
    return lambda env: value if env.steps == step else usual(env)


def steady(env: Odd) -> np.ndarray:
    return env.buffer.copy()


NAN = np.array([0, np.nan], np.float32)
REFUSED: dict[str, tuple[dict[str, Any], str]] = {
    "whole actions": ({"act": spaces.Box(0, 5, (2,), np.int32)}, r"real numbers, not whole ones, Box\(0, 5"),
    "bytes": ({"act": spaces.Box(0, 255, (2,), np.uint8)}, "not whole ones"),
    "no bounds": ({"act": spaces.Box(-np.inf, np.inf, (2,))}, "a bounded box, not"),
    "one bound": ({"act": spaces.Box(np.array([0, -np.inf]), 1, dtype=np.float64)}, "a bounded box, not"),
    "a matrix": ({"act": spaces.Box(-1, 1, (2, 2))}, "a bounded box, not"),
    "a number": ({"act": spaces.Box(-1, 1, ())}, "a bounded box, not"),
    "no action": (
        {"act": spaces.Box(-1, 1, (0,))},
        "sizes, horizon, steps, solves and episodes must be positive",
    ),
    "many choices": ({"act": spaces.MultiDiscrete([2, 3])}, "a bounded box, not"),
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


@pytest.mark.parametrize("size", [0.0, -1.0, np.nan, np.inf])
def test_a_typical_size_is_positive_and_finite(task: Callable[..., str], size: float) -> None:
    with pytest.raises(ValueError, match="a positive, finite number"):
        from_gymnasium(task(), "odd", obs_scale=(1.0, size))


def test_whole_actions_of_a_task_that_is_written_down_are_refused(task: Callable[..., str]) -> None:
    env_id = task(act=spaces.Box(0, 5, (2,), np.int32))
    with pytest.raises(ValueError, match="not whole ones"):
        try_out(EnvSpec("odd", env_id, 2, 2, (1.0, 1.0), LIMIT))


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
        (0, "gives 2.0 as obs 1, alone 0.5"),
        (1, "gives 2.0 as reward, alone 1.0"),
        (2, "gives True as terminated, alone False"),
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


def test_copies_count_the_steps_of_their_own_episodes(task: Callable[..., str]) -> None:
    spec = EnvSpec("odd", task(pay=at(3, np.nan, one)), 2, 2, (1.0, 1.0), LIMIT)
    copies: Copies = alone(spec, 2)
    for place in (0, 1):
        copies.reset(place, 0)
    copies.step([1], np.zeros((1, 2)))
    copies.step([0, 1], np.zeros((2, 2)))
    with pytest.raises(ValueError, match="the task odd gives nan as reward of step 3"):
        copies.step([0, 1], np.zeros((2, 2)))


@pytest.fixture(autouse=True)
def quiet() -> Iterator[None]:
    """Gymnasium tells casts of bounds."""
    with np.errstate(over="ignore"):
        yield
