"""What all cells of an environment and a run seed share: the expert, its demonstrations, and the replays by
which rewards are measured. Each is made once, kept in the cache, and handed to cells as bytes."""

from __future__ import annotations

import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, astuple, dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from envs import EnvSpec
from harness.judge.advantage import Replays, replay
from harness.judge.ranking import Ranked, ranked
from harness.judge.results import LEARNED, Conditions, Shown, name_of
from harness.learn.rl import disturbed
from harness.learn.seeds import demonstration_seeds, evaluation_seeds, rng_for
from harness.learn.simulator import Simulator
from harness.learn.stored import from_arrays, to_arrays
from harness.learn.world import solver_for, without_rewards
from harness.registry import SPECS, BadInput, Demonstrator
from harness.registry.keys import experts_version
from harness.run.artifacts import learned_in
from harness.run.cache import Kept, as_bytes, from_bytes, kept
from harness.run.expert_set import shipped, shipped_policies
from methods.base import Episodes, Policy
from methods.network import Network

REPLAYS = {"smoke": 20, "quick": 200, "full": 500}
"""States and actions by which a reward is compared with the true one, for each budget."""
RANKED = {"smoke": 1, "quick": 5, "full": 10}
"""Episodes of each policy that a reward must rank, for each budget."""
EXPERT, REPLAYED, RANKING = "expert", "replays", "ranking"
"""Names of what is handed to cells, beside those of demonstrations."""
NOISE = 0.3
"""Standard deviation of the noise on a noisy demonstrator's actions, in [-1, 1]."""


@dataclass(frozen=True)
class Expert:
    """An expert and what its training took.

    name: 'VERSION:NUMBER' of a shipped one, 'trained:SEED' of one trained for this run seed alone, 'exact'
    where the model is known. curve: (environment steps, mean true return) at checkpoints.
    """

    name: str
    policy: Policy
    curve: list[tuple[float, float]]
    seconds: float
    env_steps: int
    check_steps: int


def task_for(env: str, conditions: Conditions) -> EnvSpec:
    """Return a task with the learner that the conditions say."""
    return SPECS[env].by_ddpg() if conditions.learner == "ddpg" else SPECS[env]


def expert_for(env: str, seed: int, conditions: Conditions) -> Expert:
    """The expert of a run seed: the shipped one of number `seed` modulo their count. Where the task has none,
    or conditions say 'trained', one trained now with the budget of all RL, which takes minutes, or found in
    the cache."""
    spec = task_for(env, conditions)
    if spec.tabular:  # An exact solution is found faster than it is read.
        return _trained(spec, seed, conditions)
    if conditions.experts == "shipped" and (version := experts_version(env)):
        number, found = shipped(env, seed)
        facts = {key: found.facts[key] for key in ("seconds", "env_steps", "check_steps")}
        curve = [(x, y) for x, y in found.facts["curve"]]
        return Expert(f"{version}:{number}", Network.from_arrays(found.arrays), curve, **facts)
    asked = [conditions.rl, spec.rl_steps[conditions.budget], asdict(spec.rl)]
    return _expert(kept(f"expert{seed}", env, asked, lambda: _as_kept(_trained(spec, seed, conditions))))


def demonstrations_for(env: str, seed: int, shown: Shown, conditions: Conditions) -> Episodes:
    """What is shown of the run seed's expert, the same to every method."""
    return _episodes(_demonstrations(expert_for(env, seed, conditions), env, seed, shown, conditions))


def prepare(env: str, seed: int, shown: Iterable[Shown], conditions: Conditions) -> dict[str, bytes]:
    """What `Shared` reads, with these demonstrations; made now, or found in the cache."""
    expert, spec = expert_for(env, seed, conditions), SPECS[env]
    found = {EXPERT: _as_kept(expert)}
    for one in shown:
        found[name_of(one)] = _demonstrations(expert, env, seed, one, conditions)
    if conditions.retrain and not spec.tabular:
        found[REPLAYED] = _replays(expert, env, seed, conditions)
    if conditions.retrain and (policies := [expert.policy] if spec.tabular else shipped_policies(env)):
        found[RANKING] = _ranking(policies, env, seed, conditions)
    return {name: as_bytes(what) for name, what in found.items()}


@dataclass(frozen=True)
class Shared:
    """What `prepare` made, by name, and what the cell before learned. Raises KeyError for what is not
    there."""

    inputs: Mapping[str, bytes]

    @cached_property
    def expert(self) -> Expert:
        """The run seed's."""
        return _expert(from_bytes(self.inputs[EXPERT]))

    def demonstrations(self, shown: Shown) -> Episodes:
        """What is shown, the same to every method."""
        return _episodes(from_bytes(self.inputs[name_of(shown)]))

    @cached_property
    def learned(self) -> dict[str, Any]:
        """Policies and rewards by name; empty where nothing was handed over."""
        data = self.inputs.get(LEARNED)
        return learned_in(data) if data else {}

    @property
    def replays(self) -> Replays:
        """The same states and actions for every reward."""
        return Replays(**from_bytes(self.inputs[REPLAYED]).arrays)

    @property
    def ranked(self) -> Ranked | None:
        """The same policies for every reward; None where the task has none."""
        data = self.inputs.get(RANKING)
        return Ranked(**from_bytes(data).arrays) if data else None


def _demonstrations(expert: Expert, env: str, seed: int, shown: Shown, conditions: Conditions) -> Kept:
    shown = replace(shown, demos=shown.demos or SPECS[env].demo_episodes[conditions.budget])

    def draw() -> Kept:
        spec = SPECS[env]
        policy = demonstrator(expert.policy, env, seed, shown.demonstrator, conditions)
        seeds = demonstration_seeds(seed, shown.demos)
        demos = without_rewards(Simulator(spec).run(policy, seeds))
        if shown.every > 1:
            demos = demos.every(shown.every, rng_for(seed, env, "steps shown"))
        arrays: dict[str, Any] = {"obs": np.concatenate(demos.obs), "act": np.concatenate(demos.act)}
        arrays |= {"lengths": demos.lengths, "terminated": np.array(demos.terminated)}
        if demos.times is not None:
            arrays |= {"times": np.concatenate(demos.times), "shown": np.array([*map(len, demos.times)])}
        return Kept(arrays, {})

    return kept(f"demonstrations{seed}", env, _asked(expert, conditions, astuple(shown)), draw)


def demonstrator(expert: Policy, env: str, seed: int, kind: Demonstrator, conditions: Conditions) -> Policy:
    """Who demonstrates: the run seed's expert, the checkpoint of its training with about half its return, or
    the expert with noise on its actions. Raises BadInput where there is no such checkpoint."""
    if kind == "medium":
        if conditions.experts != "shipped":
            raise BadInput("medium demonstrators are shipped ones; leave out --experts trained")
        return Network.from_arrays(shipped(env, seed, medium=True)[1].arrays)
    return disturbed(expert, SPECS[env], NOISE, rng_for(seed, env, "noise")) if kind == "noisy" else expert


def _episodes(found: Kept) -> Episodes:
    arrays = found.arrays
    steps, shown = arrays["lengths"], arrays.get("shown", arrays["lengths"])
    ends, whole = np.cumsum(shown), "times" not in arrays
    rows = ends + np.arange(1, len(ends) + 1) if whole else ends
    return Episodes(
        tuple(np.split(arrays["obs"], rows[:-1])),
        tuple(np.split(arrays["act"], ends[:-1])),
        tuple(bool(x) for x in arrays["terminated"]),
        None if whole else tuple(np.split(arrays["times"], ends[:-1])),
        tuple(int(x) for x in steps),
    )


def _replays(expert: Expert, env: str, seed: int, conditions: Conditions) -> Kept:
    count = REPLAYS[conditions.budget]

    def sample() -> Kept:
        rng = rng_for(seed, env, "replays")
        return Kept(replay(SPECS[env], expert.policy, evaluation_seeds(seed, count), rng).arrays(), {})

    return kept(f"replays{seed}", env, _asked(expert, conditions, count), sample)


def _ranking(policies: Sequence[Policy], env: str, seed: int, conditions: Conditions) -> Kept:
    count = RANKED[conditions.budget]

    def sample() -> Kept:
        rng = rng_for(seed, env, "ranking")
        return Kept(ranked(SPECS[env], policies, evaluation_seeds(seed, count), rng).arrays(), {})

    return kept(f"ranking{seed}", env, [experts_version(env), count], sample)


def _asked(expert: Expert, conditions: Conditions, count: object) -> list[object]:
    trained = (
        [conditions.rl, conditions.learner, conditions.budget] if expert.name.startswith("trained") else []
    )
    return [expert.name, count, *trained]


def _as_kept(expert: Expert) -> Kept:
    arrays, policy = to_arrays(expert.policy, "policy")
    return Kept(arrays, {**vars(expert), "policy": policy})


def _expert(found: Kept) -> Expert:
    facts = {**found.facts, "policy": from_arrays(found.arrays, found.facts["policy"])}
    return Expert(**facts | {"curve": [(x, y) for x, y in facts["curve"]]})


def _trained(spec: EnvSpec, seed: int, conditions: Conditions) -> Expert:
    started = time.perf_counter()
    solver = solver_for(spec, "absorbing", rng_for(seed, spec.name, "expert"), conditions.rl)
    solution = solver.solve(None, spec.rl_steps[conditions.budget])
    seconds = time.perf_counter() - started
    name = "exact" if spec.tabular else f"trained:{seed}"
    took = (seconds, solution.env_steps, solution.check_steps)
    return Expert(name, solution.policy, solution.curve, *took)
