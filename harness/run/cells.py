"""What one cell does: draw demonstrations, fit, train pi_R, score, record."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from envs import EnvSpec
from harness.judge.advantage import Comparison, known_comparison, sampled_comparison
from harness.judge.controls import control_reward
from harness.judge.evaluation import Evaluation, evaluate
from harness.judge.results import (
    CONTROLS,
    MOST_CURVES,
    MOST_POINTS,
    REFERENCE,
    Cell,
    CellResult,
    Conditions,
    PolicyName,
    Row,
)
from harness.learn.seeds import evaluation_seeds, rng_for
from harness.learn.simulator import drawings
from harness.learn.world import TaskWorld, solver_for
from harness.registry import SPECS, load_method
from harness.run.experts import Expert, demonstrations_for, expert_for, prepare, replays_for
from harness.run.files import sha256, write_atomic
from harness.run.study import ARMS, Arm
from methods.base import Array, Episodes, Learned, Policy, Reward
from methods.settings import settings_for

__all__ = ["prepare", "run_cell"]


def run_cell(cell: Cell, conditions: Conditions, directory: Path) -> CellResult:
    """Everything of one cell; recordings go to `directory`/recordings. Raises what its method raises."""
    work = _Work(cell, conditions, directory)
    if cell.method == REFERENCE:
        work.reference()
    elif cell.method in CONTROLS:
        work.control()
    else:
        work.method()
    return work.result


class _Work:
    def __init__(self, cell: Cell, conditions: Conditions, directory: Path) -> None:
        self.cell, self.directory = cell, directory
        self.budget, self.protocol, self.rl = conditions.budget, conditions.protocol, conditions.rl
        self.spec: EnvSpec = SPECS[cell.env]
        self.conditions = conditions
        self.expert: Expert = expert_for(cell.env, cell.seed, conditions)
        self.arm = ARMS.get(cell.method) or Arm(cell.method, None, {})
        self.result = CellResult(cell, [])

    def rng(self, purpose: str) -> np.random.Generator:
        return rng_for(self.cell.seed, self.cell.env, self.cell.method, purpose)

    def demos(self) -> Episodes:
        """The demonstrations of this environment and seed, the same for every method."""
        cell = self.cell
        episodes = self.arm.demonstrations or self.spec.demo_episodes[self.budget]
        return demonstrations_for(cell.env, cell.seed, episodes, self.conditions)

    def reference(self) -> None:
        expert, rng = self.expert, self.rng("random policy")
        took = {"fit_seconds": expert.seconds, "env_steps": expert.env_steps}
        took |= {"check_steps": expert.check_steps, "rl_solves": 1}
        scored = self.score("expert", expert.policy, None, took)
        self.result.curves["expert"] = expert.curve
        self.score("random", lambda obs: self.spec.random_actions(len(obs), rng), None)
        episodes = len(scored.returns)
        terminated = (episodes - scored.endings.get("time limit", 0)) / episodes
        bar = self.spec.bar(self.seeds)
        if scored.returns.mean() < bar or terminated > self.spec.max_terminated[self.budget]:
            self.result = dataclasses.replace(self.result, below_bar=True)
            self.result.warnings.append(
                f"{self.cell.env}, seed {self.cell.seed}: the expert misses its bar: mean return "
                f"{scored.returns.mean():.2f} (at least {bar:.2f}), {terminated:.0%} of episodes terminated "
                f"early (at most {self.spec.max_terminated[self.budget]:.0%})"
            )

    def control(self) -> None:
        def fit(method: str, demos: Episodes) -> Learned:
            return self.fit(method, {}, demos, self.world())

        rng = self.rng("control")
        self.retrain(control_reward(self.cell.method, self.demos, fit, self.spec.random_actions, rng))

    def world(self) -> TaskWorld:
        return TaskWorld(self.spec, self.protocol, self.rl)

    def fit(self, method: str, settings: dict[str, Any], demos: Episodes, world: TaskWorld) -> Learned:
        settings = settings_for(method, self.cell.env, self.budget) | settings
        return load_method(method)(**settings).fit(demos, world, self.rng("fit"))

    def method(self) -> None:
        demos, world = self.demos(), self.world()
        started = time.perf_counter()
        learned = self.fit(self.arm.method, self.arm.settings, demos, world)
        seconds = time.perf_counter() - started
        self.keep_curves(learned.curves)
        self.result.details.update(learned.details)
        took = {"fit_seconds": seconds, "env_steps": world.env_steps}
        took |= {"check_steps": world.check_steps, "rl_solves": world.rl_solves}
        self.score("pi_star", learned.policy, learned.reward, took)
        if learned.reward is None:
            cell = self.cell
            row = Row(cell.env, cell.method, cell.seed, "pi_R", self.protocol, "skipped", "learns no reward")
            row = dataclasses.replace(row, expert=self.expert.name)
            self.result.rows.append(row)
        else:
            self.retrain(learned.reward)

    def keep_curves(self, curves: Mapping[str, Sequence[float]]) -> None:
        """The method's own; of long ones some points, of very many the first."""
        most = MOST_CURVES - len(("pi_R", "pi_R_true"))
        for name, values in list(curves.items())[:most]:
            places = np.unique(np.linspace(0, len(values) - 1, min(len(values), MOST_POINTS)).astype(int))
            self.result.curves[name] = [(float(x + 1), float(values[x])) for x in places]
        if len(curves) > most:
            warning = f"{self.cell.name}: of {len(curves)} curves the first {most} are kept"
            self.result.warnings.append(warning)

    def retrain(self, reward: Reward | None) -> None:
        """pi_R: reinforcement learning from scratch under the reward, with the expert's budget."""
        started = time.perf_counter()
        solver = solver_for(self.spec, self.protocol, self.rng("pi_R"), self.rl)
        solution = solver.solve(reward, self.spec.rl_steps[self.budget])
        seconds = time.perf_counter() - started
        self.result.curves["pi_R"] = solution.curve
        self.result.curves["pi_R_true"] = solution.true_curve
        took = {"fit_seconds": seconds, "env_steps": solution.env_steps}
        took |= {"check_steps": solution.check_steps, "rl_solves": 1}
        compared = self.compared(reward)
        measures = {"reward_distance": compared.distance, "reward_rank": compared.rank}
        self.score("pi_R", solution.policy, reward, took | measures)

    def compared(self, reward: Reward | None) -> Comparison:
        """The reward with the true one."""
        if self.spec.tabular:
            return known_comparison(reward, self.spec.tabular, self.spec.gamma)
        return sampled_comparison(reward, replays_for(self.cell.env, self.cell.seed, self.conditions))

    @property
    def seeds(self) -> range:
        return evaluation_seeds(self.cell.seed, self.spec.eval_episodes[self.budget])

    def score(
        self,
        name: PolicyName,
        policy: Policy,
        reward: Reward | None,
        columns: Mapping[str, Any] = MappingProxyType({}),
    ) -> Evaluation:
        """Evaluate, add the row with these columns besides, and record seed 0's first episode if asked to."""
        cell = self.cell
        scored = evaluate(self.spec, policy, self.seeds)
        self.result.endings[name] = scored.endings
        self.result.rows.append(
            Row(
                cell.env,
                cell.method,
                cell.seed,
                name,
                self.protocol,
                expert=self.expert.name,
                **scored.columns(),
                **columns,
            )
        )
        if cell.seed == 0 and self.conditions.record == "first":
            from harness.show import recordings  # 30 MB, which other seeds do without

            path = self.directory / "recordings" / f"{cell.name}__{name}.rrd"
            learned = None if reward is None else _above_absorbing(reward, scored.first.obs, scored.first.act)
            frames = drawings(self.spec, self.seeds[0], scored.first.act)
            write_atomic(path, recordings.record(self.spec, cell, name, scored.first, frames, learned))
            self.result.recordings[path.name] = sha256(path)
        return scored


def _above_absorbing(reward: Reward, obs: Array, act: Array) -> Array:
    return reward(obs[:-1], act, obs[1:]) - reward.absorbing
