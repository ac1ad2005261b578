"""What one cell does, in stages that hand values on: demonstrate, fit, retrain, score, measure, record."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from envs import EnvSpec
from harness.judge.advantage import known_comparison, sampled_comparison
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
    Curve,
    PolicyName,
    Row,
    Status,
)
from harness.learn.learned import check_learned
from harness.learn.seeds import evaluation_seeds, rng_for
from harness.learn.simulator import drawings
from harness.learn.world import TaskWorld, solver_for
from harness.registry import SPECS, load_method
from harness.run.experts import Expert, demonstrations_for, expert_for, prepare, replays_for
from harness.run.files import sha256, write_atomic
from harness.run.study import ARMS, Arm
from methods.base import Episodes, Learned, Policy, Reward, World
from methods.settings import settings_for

__all__ = ["prepare", "run_cell"]


def run_cell(cell: Cell, conditions: Conditions, directory: Path) -> CellResult:
    """Everything of one cell; recordings go to `directory`/recordings. Raises what its method raises."""
    task = Task(cell, conditions)
    made = policies(task)
    scored = {one.name: score(task, one.policy) for one in made if one.policy}
    result = CellResult(
        cell,
        rows=[row(task, one, scored.get(one.name)) for one in made],
        curves={name: curve for one in made for name, curve in one.curves.items()},
        endings={name: its.endings for name, its in scored.items()},
        warnings=[warning for one in made for warning in one.warnings],
        details={name: value for one in made for name, value in one.details.items()},
    )
    if cell.method == REFERENCE and (missed := missed_bar(task, scored["expert"])):
        result = replace(result, below_bar=True, warnings=[*result.warnings, missed])
    if cell.seed == 0 and conditions.record == "first":
        for one in made:
            if one.name in scored:
                path = directory / "recordings" / f"{cell.name}__{one.name}.rrd"
                write_atomic(path, recorded(task, one, scored[one.name]))
                result.recordings[path.name] = sha256(path)
    return result


@dataclass(frozen=True)
class Task:
    """A cell, and what its stages need to know of it."""

    cell: Cell
    conditions: Conditions

    @property
    def spec(self) -> EnvSpec:
        return SPECS[self.cell.env]

    @cached_property
    def expert(self) -> Expert:
        return expert_for(self.cell.env, self.cell.seed, self.conditions)

    @property
    def seeds(self) -> range:
        """Of the evaluation episodes."""
        return evaluation_seeds(self.cell.seed, self.spec.eval_episodes[self.conditions.budget])

    @property
    def rl_steps(self) -> int:
        return self.spec.rl_steps[self.conditions.budget]

    def rng(self, purpose: str) -> np.random.Generator:
        return rng_for(self.cell.seed, self.cell.env, self.cell.method, purpose)

    def world(self) -> TaskWorld:
        return TaskWorld(self.spec, self.conditions.protocol, self.conditions.rl)


@dataclass(frozen=True)
class Made:
    """A policy to be scored, None where there is none and why, and what is known of how it came.

    reward: what it was trained on or found with, None where that is the true one or none.
    columns: of its row, besides the scores.
    """

    name: PolicyName
    policy: Policy | None
    reward: Reward | None = None
    columns: Mapping[str, Any] = field(default_factory=dict)
    curves: Mapping[str, Curve] = field(default_factory=dict)
    details: Mapping[str, float] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()


def policies(task: Task) -> list[Made]:
    """What a cell scores."""
    if task.cell.method == REFERENCE:
        return reference(task)
    if task.cell.method in CONTROLS:
        return [retrain(task, control(task))]
    star = fit(task, demonstrations(task))
    if star.reward is None:
        return [star, Made("pi_R", None, columns={"reason": "learns no reward"})]
    return [star, retrain(task, star.reward)]


def reference(task: Task) -> list[Made]:
    """The expert and a random policy."""
    expert, spec, rng = task.expert, task.spec, task.rng("random policy")
    took = {"fit_seconds": expert.seconds, "env_steps": expert.env_steps}
    took |= {"check_steps": expert.check_steps, "rl_solves": 1}
    return [
        Made("expert", expert.policy, columns=took, curves={"expert": expert.curve}),
        Made("random", lambda obs: spec.random_actions(len(obs), rng)),
    ]


def demonstrations(task: Task) -> Episodes:
    """Those of this environment and seed, the same for every method."""
    cell = task.cell
    episodes = arm_of(cell).demonstrations or task.spec.demo_episodes[task.conditions.budget]
    return demonstrations_for(cell.env, cell.seed, episodes, task.conditions)


def arm_of(cell: Cell) -> Arm:
    """The method of a cell, with what it is given besides its budget's."""
    return ARMS.get(cell.method) or Arm(cell.method, None, {})


def learned_by(task: Task, method: str, more: Mapping[str, Any], demos: Episodes, world: World) -> Learned:
    """What a method learns with the settings of its environment and budget, and `more`."""
    settings = {**settings_for(method, task.cell.env, task.conditions.budget), **more}
    learned = load_method(method)(**settings).fit(demos, world, task.rng("fit"))
    check_learned(learned, task.spec, demos)
    return learned


def fit(task: Task, demos: Episodes) -> Made:
    """pi_star, with R*."""
    arm, world = arm_of(task.cell), task.world()
    started = time.perf_counter()
    learned = learned_by(task, arm.method, arm.settings, demos, world)
    took = {"fit_seconds": time.perf_counter() - started, "env_steps": world.env_steps}
    took |= {"check_steps": world.check_steps, "rl_solves": world.rl_solves}
    most = MOST_CURVES - len(("pi_R", "pi_R_true"))
    curves = {name: thinned(values) for name, values in list(learned.curves.items())[:most]}
    many = f"{task.cell.name}: of {len(learned.curves)} curves the first {most} are kept"
    warnings = (many,) if len(learned.curves) > most else ()
    return Made("pi_star", learned.policy, learned.reward, took, curves, learned.details, warnings)


def thinned(values: Sequence[float]) -> Curve:
    """A method's curve; of a long one some points."""
    places = np.unique(np.linspace(0, len(values) - 1, min(len(values), MOST_POINTS)).astype(int))
    return [(float(x + 1), float(values[x])) for x in places]


def control(task: Task) -> Reward | None:
    """The reward of a control, None for the true one."""

    def fitted(method: str, demos: Episodes) -> Learned:
        return learned_by(task, method, {}, demos, task.world())

    rng, spec = task.rng("control"), task.spec
    return control_reward(task.cell.method, lambda: demonstrations(task), fitted, spec.random_actions, rng)


def retrain(task: Task, reward: Reward | None) -> Made:
    """pi_R: reinforcement learning from scratch under the reward, with the expert's budget."""
    started = time.perf_counter()
    solver = solver_for(task.spec, task.conditions.protocol, task.rng("pi_R"), task.conditions.rl)
    solution = solver.solve(reward, task.rl_steps)
    took = {"fit_seconds": time.perf_counter() - started, "env_steps": solution.env_steps}
    took |= {"check_steps": solution.check_steps, "rl_solves": 1}
    curves = {"pi_R": solution.curve, "pi_R_true": solution.true_curve}
    return Made("pi_R", solution.policy, reward, took | measured(task, reward), curves)


def measured(task: Task, reward: Reward | None) -> dict[str, float]:
    """How far the reward is from the true one."""
    spec, cell = task.spec, task.cell
    if spec.tabular:
        distance, rank = known_comparison(reward, spec.tabular, spec.gamma)
    else:
        distance, rank = sampled_comparison(reward, replays_for(cell.env, cell.seed, task.conditions))
    return {"reward_distance": distance, "reward_rank": rank}


def score(task: Task, policy: Policy) -> Evaluation:
    """In the original environment, by the true reward."""
    return evaluate(task.spec, policy, task.seeds)


def row(task: Task, made: Made, scored: Evaluation | None) -> Row:
    """Of scores.csv."""
    cell = task.cell
    columns = {"expert": task.expert.name, **made.columns, **(scored.columns() if scored else {})}
    status: Status = "ok" if scored else "skipped"
    return Row(cell.env, cell.method, cell.seed, made.name, task.conditions.protocol, status, **columns)


def missed_bar(task: Task, expert: Evaluation) -> str:
    """Why the expert is none to be trusted, '' where it meets its bar."""
    episodes, allowed = len(expert.returns), task.spec.max_terminated[task.conditions.budget]
    terminated = (episodes - expert.endings.get("time limit", 0)) / episodes
    bar = task.spec.bar(task.seeds)
    if expert.returns.mean() >= bar and terminated <= allowed:
        return ""
    return (
        f"{task.cell.env}, seed {task.cell.seed}: the expert misses its bar: mean return "
        f"{expert.returns.mean():.2f} (at least {bar:.2f}), {terminated:.0%} of episodes terminated "
        f"early (at most {allowed:.0%})"
    )


def recorded(task: Task, made: Made, scored: Evaluation) -> bytes:
    """The recording of its first evaluation episode."""
    from harness.show import recordings  # 30 MB, which other seeds do without

    first, reward = scored.first, made.reward
    paid = None if reward is None else reward(first.obs[:-1], first.act, first.obs[1:]) - reward.absorbing
    frames = drawings(task.spec, task.seeds[0], first.act)
    return recordings.record(task.spec, task.cell, made.name, first, frames, paid)
