"""Experts: RL on the true reward, trained once for each environment and budget, kept in the cache; exact
where the model is known."""

from __future__ import annotations

import time
from dataclasses import dataclass

from envs import SPECS
from harness.advantage import Deviations, deviations
from harness.cache import Kept, kept
from harness.results import Library
from harness.seeds import evaluation_seeds, rng_for
from harness.world import solver_for
from methods.base import Policy
from methods.network import Network

ADVANTAGES = {"smoke": 20, "quick": 200, "full": 500}
"""States and actions by which a reward is compared with the true advantage, for each budget."""


@dataclass(frozen=True)
class Expert:
    """A trained expert and what it took. curve: (environment steps, mean true return) at checkpoints."""

    policy: Policy
    curve: list[tuple[float, float]]
    seconds: float
    env_steps: int
    rl_steps: int


def expert_for(env: str, budget: str, library: Library) -> Expert:
    """The expert from the cache, or trained and cached now, which may take minutes."""
    spec = SPECS[env]
    if spec.tabular:  # An exact solution is found faster than it is read.
        return _trained(env, budget, library)

    def train() -> Kept:
        expert = _trained(env, budget, library)
        assert isinstance(expert.policy, Network)
        facts = {
            "curve": expert.curve,
            "seconds": expert.seconds,
            "env_steps": expert.env_steps,
            "rl_steps": expert.rl_steps,
        }
        return Kept(expert.policy.arrays(), facts)

    found = kept("expert", spec, budget, library, train)
    curve = [(x, y) for x, y in found.facts["curve"]]
    return Expert(Network.from_arrays(found.arrays), **(found.facts | {"curve": curve}))


def deviations_for(env: str, budget: str, library: Library, seed: int) -> Deviations:
    """The same states and actions for every reward of an environment and seed; of the cache as well."""
    spec = SPECS[env]

    def sample() -> Kept:
        expert = expert_for(env, budget, library)
        seeds = evaluation_seeds(seed, ADVANTAGES[budget])
        return Kept(vars(deviations(spec, expert.policy, seeds, rng_for(seed, env, "advantage"))), {})

    return Deviations(**kept(f"advantage{seed}", spec, budget, library, sample).arrays)


def _trained(env: str, budget: str, library: Library) -> Expert:
    started = time.perf_counter()
    solver = solver_for(SPECS[env], "absorbing", rng_for(0, env, "expert"), library)
    solution = solver.solve(None, SPECS[env].rl_steps[budget])
    seconds = time.perf_counter() - started
    return Expert(solution.policy, solution.curve, seconds, solution.env_steps, solution.rl_steps)
