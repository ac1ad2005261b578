"""Sources of the expert and the demonstrations of a task and run seed: one type with five cases.

`Shipped`: one of the shipped experts is played. `Controlled`: the task's controller is played. `Trained`:
an expert is trained, or solved where the model is known, and played. `FromFile`: demonstrations are a
file's, beside an expert of these. `NoExpert`: they are a file's, and what they return scores 1.
"""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, astuple, dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from envs import EnvSpec
from harness.cell import given
from harness.cell.shipped import ShippedExpert, shipped_experts
from harness.demonstrations import preferences
from harness.demonstrations.arrays import from_arrays as episodes_from
from harness.demonstrations.arrays import split, to_arrays
from harness.records import ALL_SHOWN, UNSHOWN, Conditions, Shown
from harness.registry import SPECS, BadInput, Demonstrator
from harness.registry.keys import encoder_version, experts_version
from harness.registry.plugins import method_for
from harness.registry.tasks import task_for
from harness.rl.learned import check_learned
from harness.rl.seeds import demonstration_seeds, rng_for
from harness.rl.simulator import Simulator, Trajectory
from harness.rl.solving import disturbed
from harness.rl.stored import from_arrays
from harness.rl.stored import to_arrays as stored_arrays
from harness.rl.world import TaskWorld, solver_for, without_rewards
from harness.store.cache import Kept, kept
from methods.base import Episodes, Policy

NOISE = 0.3
"""Standard deviation of the noise on a noisy demonstrator's actions, in [-1, 1]."""
STAND_IN = "bc"
"""Method whose clone of the demonstrations replaces an absent expert where rewards are compared."""


@dataclass(frozen=True)
class Expert:
    """An expert, and what its training took.

    `name`: 'VERSION:NUMBER' if shipped, 'trained:SEED' if trained for this seed alone. It is 'exact' if the
    model is known, 'controller' for a controller, 'file:DIGEST' for a clone that stands in.
    `curve`: (environment steps, mean true return) at checkpoints.
    `shown`: name of a file's demonstrations, or ''.
    `returns`: columns of scores.csv of what scores 1, where that is not what the policy returns.
    """

    name: str
    policy: Policy
    curve: tuple[tuple[float, float], ...] = ()
    seconds: float = 0.0
    env_steps: int = 0
    check_steps: int = 0
    shown: str = ""
    returns: tuple[tuple[str, float], ...] = ()

    def column(self, method: str) -> str:
        """Return the column `expert` of a method's rows."""
        return self.name if method in UNSHOWN else self.shown or self.name


def to_kept(expert: Expert) -> Kept:
    """Return an expert as arrays and facts."""
    return Kept(*stored_arrays(expert, "expert"))


def from_kept(content: Kept) -> Expert:
    """Return the expert of such arrays and facts."""
    expert: Expert = from_arrays(content.arrays, content.facts)
    return expert


@dataclass(frozen=True)
class Source(ABC):
    """The expert and the demonstrations of a task and run seed."""

    env: str
    seed: int
    conditions: Conditions

    @property
    def spec(self) -> EnvSpec:
        """The task, with the learner of the conditions."""
        return task_for(self.env, self.conditions)

    @cached_property
    @abstractmethod
    def expert(self) -> Expert:
        """The expert, or what stands in for it."""

    @abstractmethod
    def demonstrations(self, shown: Shown) -> Episodes:
        """Return what is shown to every method."""

    def thinned(self, episodes: Episodes, shown: Shown) -> Episodes:
        """Return the steps that are shown."""
        if shown.every == 1:
            return episodes
        return episodes.every(shown.every, rng_for(self.seed, self.env, "steps shown"))

    def kept(self, name: str, asked: object, compute: Callable[[], Kept]) -> Kept:
        """Return what `compute` makes with the expert, by the cache where that knows it. asked: what JSON can
        hold."""
        if self.expert.returns:
            return compute()
        made_with = [self.conditions.rl, self.conditions.learner, self.conditions.budget]
        made_with += encoder_version(self.conditions.encoder)
        return kept(f"{name}{self.seed}", self.env, [self.expert.name, *made_with, asked], compute)


class Played(Source):
    """An expert that is played to demonstrate."""

    def demonstrations(self, shown: Shown) -> Episodes:
        shown = replace(shown, demos=shown.demos or self.spec.demo_episodes[self.conditions.budget])

        def draw() -> Kept:
            played = self.play(shown.demos, shown.demonstrator)
            demos = without_rewards(played)
            if shown.demonstrator == "ranked":
                returns = [float(one.rewards.sum()) for one in played]
                demos = replace(demos, preferences=preferences.by_returns(returns))
            return Kept(to_arrays(self.thinned(demos, shown)), {})

        return episodes_from(self.kept("demonstrations", astuple(shown), draw).arrays)

    def play(self, demos: int, kind: Demonstrator) -> list[Trajectory]:
        """Return the first episodes of a demonstrator, with their true rewards; of 'ranked', a third by
        each other one. Raises BadInput for a medium one that was not shipped."""
        if kind == "ranked":
            kinds: tuple[Demonstrator, ...] = ("expert", "noisy", "medium")
            return [one for each in kinds for one in self.play(-(-demos // 3), each)][:demos]
        policy = self.medium() if kind == "medium" else self.expert.policy
        if kind == "noisy":
            policy = disturbed(policy, self.spec, NOISE, rng_for(self.seed, self.env, "noise"))
        seeds, task = demonstration_seeds(self.seed, demos), self.spec.expert_sees
        return Simulator(self.spec).shown(Simulator(task).run(policy, seeds), seeds)

    def medium(self) -> Policy:
        """Return the checkpoint of the expert's training with about half its return."""
        raise BadInput("medium demonstrators are shipped ones; leave out --experts trained")


class Shipped(Played):
    """One of a task's shipped experts, of number `seed` modulo their count."""

    @cached_property
    def shipped(self) -> tuple[int, ShippedExpert]:
        """The number of the expert, and the expert with its medium checkpoint."""
        experts = shipped_experts(self.spec.expert_sees.name)
        number = self.seed % len(experts)
        return number, experts[number]

    @cached_property
    def expert(self) -> Expert:
        number, one = self.shipped
        took = [one.facts[name] for name in ("seconds", "env_steps", "check_steps")]
        name = f"{experts_version(self.env)}:{number}"
        return Expert(name, one.expert, _curve(one.facts["curve"]), *took)

    def medium(self) -> Policy:
        return self.shipped[1].medium


class Controlled(Played):
    """A task's controller, equal for all run seeds."""

    @cached_property
    def expert(self) -> Expert:
        assert self.spec.expert_sees.controller is not None
        return Expert("controller", self.spec.expert_sees.controller)


class Trained(Played):
    """An expert that is trained for this run seed alone, which takes minutes, or is in the cache. Where the
    model is known, it is solved."""

    @cached_property
    def expert(self) -> Expert:
        if self.spec.tabular:  # which is faster than reading it
            return self._train()
        rl, steps = self.conditions.rl, self.spec.rl_steps[self.conditions.budget]
        asked: list[object] = [rl, steps, asdict(self.spec.rl)]
        asked += encoder_version(self.conditions.encoder)
        return from_kept(kept(f"expert{self.seed}", self.env, asked, lambda: to_kept(self._train())))

    def _train(self) -> Expert:
        started = time.perf_counter()
        rng = rng_for(self.seed, self.env, "expert")
        solver = solver_for(self.spec.expert_sees, "absorbing", rng, self.conditions.rl)
        solution = solver.solve(None, self.spec.rl_steps[self.conditions.budget])
        took = time.perf_counter() - started, solution.env_steps, solution.check_steps
        name = "exact" if self.spec.tabular else f"trained:{self.seed}"
        return Expert(name, solution.policy, _curve(solution.curve), *took)


class FromFile(Source):
    """Demonstrations of a file, beside an expert that scores 1."""

    @cached_property
    def expert(self) -> Expert:
        return replace(played_for(self.env, self.seed, self.conditions).expert, shown=self.name)

    @property
    def name(self) -> str:
        """Name of the file's demonstrations in the column `expert`."""
        return f"file:{self.conditions.demonstrations.partition(':')[0]}"

    def demonstrations(self, shown: Shown) -> Episodes:
        """Return as many episodes as are asked for, drawn by the run's seed, or all. Raises ValueError where
        there are fewer, or they are gone from the cache."""
        episodes = episodes_from(given.stored(self.conditions.demonstrations))
        count = len(episodes)
        if shown.demos > count:
            raise ValueError(f"{shown.demos} demonstrations are asked for, and there are {count}")
        if shown.demos:
            order = rng_for(self.seed, self.env, "demonstrations given").permutation(count)
            numbers = np.sort(order[: shown.demos])
            episodes = preferences.chosen(episodes, numbers)
        return self.thinned(episodes, shown)


class NoExpert(FromFile):
    """Demonstrations of a file without an expert. What they return scores 1; where rewards are compared, in
    states that the expert visits, a clone stands in for it."""

    @cached_property
    def expert(self) -> Expert:
        spec, conditions = self.spec, self.conditions
        demos, steps = self.demonstrations(ALL_SHOWN), spec.rl_steps[conditions.budget]
        world = TaskWorld(spec, conditions.protocol, conditions.rl, solve_steps=steps)
        method = method_for(STAND_IN, self.env, conditions.budget)
        learned = method.fit(demos, world, rng_for(self.seed, self.env, STAND_IN, "fit"))
        check_learned(learned, spec, demos)
        returns = _returns(given.stored(conditions.demonstrations), spec.gamma)
        return Expert(self.name, learned.policy, returns=returns)


def source_for(env: str, seed: int, conditions: Conditions) -> Source:
    """Return where a run seed's expert and demonstrations come from under the conditions."""
    if conditions.experts == "none":
        return NoExpert(env, seed, conditions)
    kind = FromFile if conditions.demonstrations else played_for
    return kind(env, seed, conditions)


def played_for(env: str, seed: int, conditions: Conditions) -> Played:
    """Return a run seed's expert: the controller or a shipped one, unless the task has none or conditions say
    'trained'."""
    spec = SPECS[env]
    kind: type[Played] = Trained
    if conditions.experts == "shipped" and not spec.tabular:
        kind = Controlled if spec.expert_sees.controller else Shipped if experts_version(env) else Trained
    return kind(env, seed, conditions)


def _curve(points: Iterable[Sequence[float]]) -> tuple[tuple[float, float], ...]:
    return tuple((float(steps), float(value)) for steps, value in points)


def _returns(arrays: Mapping[str, NDArray[Any]], gamma: float) -> tuple[tuple[str, float], ...]:
    """Return what demonstrations return, by the file's rewards, and how long they last, as columns of
    scores.csv."""
    paid = split(arrays["rewards"], arrays["lengths"])
    measures = {
        "return": [rewards.sum() for rewards in paid],
        "discounted": [rewards @ gamma ** np.arange(len(rewards)) for rewards in paid],
        "length": [len(rewards) for rewards in paid],
    }
    columns: dict[str, float] = {"episodes": len(paid)}
    for name, values in measures.items():
        columns |= {f"{name}_mean": float(np.mean(values)), f"{name}_std": float(np.std(values))}
    return tuple(columns.items())
