"""What all methods of a run seed share: the expert, its demonstrations, and the replays by which rewards are
measured. Each is made once and kept in the cache."""

from __future__ import annotations

import time
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from envs import EnvSpec
from harness.judge.advantage import Replays, replay
from harness.judge.results import Conditions
from harness.learn.seeds import demonstration_seeds, evaluation_seeds, rng_for
from harness.learn.simulator import Simulator
from harness.learn.world import solver_for, without_rewards
from harness.registry import SPECS
from harness.run.cache import Kept, kept
from harness.run.expert_set import shipped
from harness.run.keys import experts_version
from methods.base import Episodes, Policy
from methods.network import Network

REPLAYS = {"smoke": 20, "quick": 200, "full": 500}
"""States and actions by which a reward is compared with the true one, for each budget."""


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


def expert_for(env: str, seed: int, conditions: Conditions) -> Expert:
    """The expert of a run seed: the shipped one of number `seed` modulo their count. Where the task has none,
    or conditions say 'trained', one trained now with the budget of all RL, which takes minutes, or found in
    the cache."""
    spec = SPECS[env]
    if spec.tabular:  # An exact solution is found faster than it is read.
        return _trained(spec, seed, conditions)[0]
    if conditions.experts == "shipped" and (version := experts_version(env)):
        number, found = shipped(env, seed)
        name = f"{version}:{number}"
    else:
        asked = [conditions.rl, spec.rl_steps[conditions.budget], asdict(spec.rl)]
        found = kept(f"expert{seed}", env, asked, lambda: _trained(spec, seed, conditions)[1])
        name = f"trained:{seed}"
    facts = {key: found.facts[key] for key in ("seconds", "env_steps", "check_steps")}
    curve = [(x, y) for x, y in found.facts["curve"]]
    return Expert(name, Network.from_arrays(found.arrays), curve, **facts)


def demonstrations_for(env: str, seed: int, episodes: int, conditions: Conditions) -> Episodes:
    """So many demonstrations of the run seed's expert, the same for every method."""
    expert, spec = expert_for(env, seed, conditions), SPECS[env]

    def draw() -> Kept:
        seeds = demonstration_seeds(seed, episodes)
        demos = without_rewards(Simulator(spec).run(expert.policy, seeds))
        arrays: dict[str, Any] = {"obs": np.concatenate(demos.obs), "act": np.concatenate(demos.act)}
        arrays |= {"lengths": demos.lengths, "terminated": np.array(demos.terminated)}
        return Kept(arrays, {})

    found = kept(f"demonstrations{seed}", env, _shared(expert, conditions, episodes), draw).arrays
    ends = np.cumsum(found["lengths"])
    return Episodes(
        tuple(np.split(found["obs"], (ends + np.arange(1, episodes + 1))[:-1])),
        tuple(np.split(found["act"], ends[:-1])),
        tuple(bool(x) for x in found["terminated"]),
    )


def replays_for(env: str, seed: int, conditions: Conditions) -> Replays:
    """The same states and actions for every reward of an environment and run seed."""
    expert, spec, count = expert_for(env, seed, conditions), SPECS[env], REPLAYS[conditions.budget]

    def sample() -> Kept:
        rng = rng_for(seed, env, "replays")
        return Kept(replay(spec, expert.policy, evaluation_seeds(seed, count), rng).arrays(), {})

    return Replays(**kept(f"replays{seed}", env, _shared(expert, conditions, count), sample).arrays)


def prepare(env: str, seed: int, conditions: Conditions) -> None:
    """Makes sure that all of these are in the cache."""
    spec = SPECS[env]
    if not spec.tabular:
        demonstrations_for(env, seed, spec.demo_episodes[conditions.budget], conditions)
        replays_for(env, seed, conditions)


def _shared(expert: Expert, conditions: Conditions, count: int) -> list[object]:
    trained = [conditions.rl, conditions.budget] if expert.name.startswith("trained") else []
    return [expert.name, count, *trained]


def _trained(spec: EnvSpec, seed: int, conditions: Conditions) -> tuple[Expert, Kept]:
    started = time.perf_counter()
    solver = solver_for(spec, "absorbing", rng_for(seed, spec.name, "expert"), conditions.rl)
    solution = solver.solve(None, spec.rl_steps[conditions.budget])
    seconds = time.perf_counter() - started
    took = {"seconds": seconds, "env_steps": solution.env_steps, "check_steps": solution.check_steps}
    expert = Expert("exact", solution.policy, solution.curve, **took)  # type: ignore[arg-type]
    arrays = solution.policy.arrays() if isinstance(solution.policy, Network) else {}
    return expert, Kept(arrays, {"curve": solution.curve, **took})
