"""What the scripts beside this one share: demonstrations and scores as `run` has them at `full`."""

from __future__ import annotations

from harness.judge.results import Conditions
from harness.learn.seeds import demonstration_seeds, evaluation_seeds, rng_for
from harness.learn.simulator import Simulator, Trajectory

from harness.cell.experts import source_for
from harness.judge.evaluation import evaluate
from harness.registry import SPECS
from methods.base import Policy

BUDGET = "full"
ENOUGH = 0.95
"""Of the expert."""


class Judge:
    """Of one environment and run seed."""

    def __init__(self, env: str, seed: int) -> None:
        self.spec = SPECS[env]
        self._seed = seed
        self._expert = source_for(env, seed, Conditions(BUDGET, "absorbing", "sbx")).expert.policy
        rng = rng_for(seed, env, "reference", "random policy")
        self._best = self._mean_return(self._expert)
        self._worst = self._mean_return(lambda obs: self.spec.random_actions(len(obs), rng))

    def demonstrations(self) -> list[Trajectory]:
        """Those that the benchmark's methods get."""
        seeds = demonstration_seeds(self._seed, self.spec.demo_episodes[BUDGET])
        return Simulator(self.spec).run(self._expert, seeds)

    def score(self, policy: Policy) -> float:
        """Its normalized score."""
        return (self._mean_return(policy) - self._worst) / (self._best - self._worst)

    def _mean_return(self, policy: Policy) -> float:
        seeds = evaluation_seeds(self._seed, self.spec.eval_episodes[BUDGET])
        return float(evaluate(self.spec, policy, seeds).returns.mean())
