"""What a cell's numbers come from, in stages that hand values on: demonstrate, fit, retrain, score, measure.

Whatever is done here changes the keys of all cells (`harness.registry.keys`); what is kept and recorded of it
is `harness.run.cells`'.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, cast

import numpy as np

from envs import EnvSpec
from harness.judge.advantage import known_comparison, sampled_comparison
from harness.judge.controls import control_reward
from harness.judge.evaluation import Evaluation, evaluate, totals
from harness.judge.numbers import as_text
from harness.judge.results import (
    CONTROLS,
    LONGEST_TEXT,
    MOST_CURVES,
    MOST_POINTS,
    NOMINAL,
    REFERENCE,
    Cell,
    Conditions,
    Curve,
    PolicyName,
    Row,
    Solve,
    policies_of,
    row_of,
    takes_one_solve,
    thinned,
    usable,
)
from harness.judge.solved import is_solved
from harness.learn.learned import check_learned
from harness.learn.rl import Solution
from harness.learn.seeds import evaluation_seeds, judging_seeds, rng_for
from harness.learn.simulator import Simulator
from harness.learn.world import TaskWorld, solver_for
from harness.registry import ASKING, load_method
from harness.registry.plugins import settings_for
from harness.run.codec import printable
from harness.run.experts import Shared, task_for
from methods.base import Episodes, Learned, Policy, Reward, Unsuitable, World
from methods.rewards import fast

JUDGING_EPISODES = 20
"""Episodes by which a solve is chosen."""
SAME_FIT = {"gail_mean": "gail", "shaped_ml": "shaped", "shaped_ranked": "shaped"}
"""Methods whose fit is that of another method, or begins with it: both draw the same random numbers, so they
have the same pi*."""


@dataclass(frozen=True)
class Task:
    """A cell, and what its stages need to know of it."""

    cell: Cell
    conditions: Conditions
    shared: Shared
    seconds: dict[str, float] = field(default_factory=dict)
    """That each stage took so far."""
    noted: dict[str, float] = field(default_factory=dict)
    """Columns of all its rows that became known so far."""
    tell: Callable[[str], None] = lambda doing: None
    """Told in a few words what is being done, for who waits."""

    @contextmanager
    def during(self, stage: str) -> Iterator[None]:
        """Counts the time until the context ends as the stage's."""
        self.tell(stage)
        started = time.perf_counter()
        try:
            yield
        finally:
            self.seconds[stage] = self.seconds.get(stage, 0.0) + time.perf_counter() - started

    @cached_property
    def spec(self) -> EnvSpec:
        """Where demonstrations are of, and methods learn."""
        return task_for(self.cell.env, self.conditions)

    @cached_property
    def place(self) -> EnvSpec:
        """Where what was learned is used."""
        nominal = self.cell.dynamics == NOMINAL
        return self.spec if nominal else self.spec.variant(self.cell.dynamics)

    @property
    def seeds(self) -> range:
        """Of the evaluation episodes."""
        return evaluation_seeds(self.cell.seed, self.spec.eval_episodes[self.conditions.budget])

    @property
    def rl_steps(self) -> int:
        return self.spec.rl_steps[self.conditions.budget]

    @property
    def solves(self) -> int:
        """The number of RL solves of the reward."""
        asked = self.conditions.solves or self.spec.solves[self.conditions.budget]
        return 1 if takes_one_solve(self.cell) else asked

    def rng(self, purpose: str) -> np.random.Generator:
        return rng_for(self.cell.seed, self.cell.env, self.cell.method, purpose)

    def world(self) -> TaskWorld:
        expert = self.shared.expert.policy if self.cell.method in ASKING else None
        return TaskWorld(
            *(self.spec, self.conditions.protocol, self.conditions.rl, expert),
            told=lambda steps: self.tell(f"fit, {steps:,} steps so far"),
            solve_steps=self.rl_steps,
            budget=self.conditions.budget,
        )


@dataclass(frozen=True)
class Made:
    """A policy to be scored, None where there is none and why, and what is known of how it came.

    reward: what it was trained on or found with, None where that is the true one or none.
    columns: of its row, besides the scores.
    solves: of pi_R, the policy of each solve and its return under R* on the judging episodes.
    """

    name: PolicyName
    policy: Policy | None
    reward: Reward | None = None
    columns: Mapping[str, Any] = field(default_factory=dict)
    curves: Mapping[str, Curve] = field(default_factory=dict)
    details: Mapping[str, float] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()
    solves: Sequence[tuple[Policy, float]] = ()


def policies(task: Task) -> list[Made]:
    """What a cell scores."""
    if task.cell.method == REFERENCE:
        return reference(task)
    if task.cell.method in CONTROLS:
        return [retrain(task, control(task))]
    try:
        star = carried(task) or elsewhere(task, fit(task, demonstrations(task)))
    except Unsuitable as error:
        task.noted.clear()
        reason = printable(" ".join(str(error).split()))[:LONGEST_TEXT] or type(error).__name__
        return [Made(name, None, columns={"reason": reason}) for name in policies_of(task.cell)]
    if star.reward is None:
        return [star, Made("pi_R", None, columns={"reason": "learns no reward"})]
    if not task.conditions.retrain:
        return [star, Made("pi_R", None, columns={"reason": "not asked for"})]
    trained = retrain(task, star.reward)
    task.noted["own_return_random"] = score(task, random_policy(task), star.reward).own_return
    return [star, trained]


def reference(task: Task) -> list[Made]:
    """The expert and a random policy."""
    expert = task.shared.expert
    took = {"fit_seconds": expert.seconds, "env_steps": expert.env_steps}
    took |= {"check_steps": expert.check_steps, "rl_solves": 1}
    return [
        Made("expert", expert.policy, columns=took, curves={"expert": expert.curve}),
        Made("random", random_policy(task)),
    ]


def random_policy(task: Task) -> Policy:
    """Return the random policy of the environment and seed, whose actions are the same in every cell."""
    spec, rng = task.place, rng_for(task.cell.seed, task.cell.env, REFERENCE, "random policy")
    return lambda obs: spec.random_actions(len(obs), rng)


def demonstrations(task: Task) -> Episodes:
    """Those of this environment and seed, the same for every method."""
    with task.during("demonstrate"):
        demos = task.shared.demonstrations(task.cell.shown)
    task.noted["pairs"] = sum(map(len, demos.act))
    return demos


def carried(task: Task) -> Made | None:
    """pi_star, with R*, of the same cell in the env's own dynamics, where that was kept; what `fit` finds,
    at once."""
    learned = task.shared.learned
    both = {"pi_star", "reward"} <= learned.keys()
    return Made("pi_star", learned["pi_star"], learned["reward"]) if both else None


def elsewhere(task: Task, fitted: Made) -> Made:
    """What was fitted, as `carried` has it where the cell is of other dynamics: what the fit took is told by
    the cell of the env's own."""
    if task.place is task.spec:
        return fitted
    task.noted.clear()
    return Made("pi_star", fitted.policy, fitted.reward)


def learned_by(task: Task, method: str, demos: Episodes, world: World) -> Learned:
    """What a method learns with the settings of its environment and budget."""
    settings = settings_for(method, task.cell.env, task.conditions.budget)
    rng = rng_for(task.cell.seed, task.cell.env, SAME_FIT.get(method, method), "fit")
    own = replace(demos, obs=tuple(map(np.array, demos.obs)), act=tuple(map(np.array, demos.act)))
    learned = load_method(method)(**settings).fit(own, world, rng)
    check_learned(learned, task.spec, demos)
    return learned


def fit(task: Task, demos: Episodes) -> Made:
    """pi_star, with R*."""
    world = task.world()
    with task.during("fit"):
        learned = learned_by(task, task.cell.method, demos, world)
    if learned.reward is not None and demos.whole:
        paid = totals(fast(learned.reward), list(zip(demos.obs, demos.act, strict=True)))
        task.noted["own_return_shown"] = float(paid.mean())
    took = {"fit_seconds": task.seconds["fit"], "env_steps": world.env_steps}
    took |= {"check_steps": world.check_steps, "rl_solves": world.rl_solves}
    most = MOST_CURVES - len(("pi_R", "pi_R_true", "pi_R_chosen"))
    curves = {name: curve(values) for name, values in list(learned.curves.items())[:most]}
    many = f"{task.cell.name}: of {len(learned.curves)} curves the first {most} are kept"
    warnings = (many,) if len(learned.curves) > most else ()
    details = {**learned.details, **({"answers of the expert": world.answers} if world.answers else {})}
    return Made("pi_star", learned.policy, learned.reward, took, curves, details, warnings)


def curve(values: Sequence[float]) -> Curve:
    """What is kept of one value an iteration."""
    return [(float(x), float(y)) for x, y in thinned(list(enumerate(values, 1)), MOST_POINTS)]


def control(task: Task) -> Reward | None:
    """The reward of a control, None for the true one."""
    known = task.shared.learned
    if (reward := known.get("reward")) is not None:  # which bc has none of
        return cast(Reward, reward)

    def fitted(method: str, demos: Episodes) -> Learned:
        if task.cell.method == "control_clone" and "pi_star" in known:
            return Learned(known["pi_star"], None)
        with task.during("fit"):
            return learned_by(task, method, demos, task.world())

    rng, spec = task.rng("control"), task.spec
    return control_reward(task.cell.method, lambda: demonstrations(task), fitted, spec.random_actions, rng)


def retrain(task: Task, reward: Reward | None) -> Made:
    """Return pi_R: the solve that earns the most under the reward on the judging episodes. Ties go to the
    first solve. Each learns from scratch with the expert's budget."""
    with task.during("retrain"):
        solutions = [solve(task, reward, number) for number in range(task.solves)]
        judged, judged_by = [math.nan], 0
        if reward is not None and len(solutions) > 1:
            judged, judged_by = judge(task, reward, [its.policy for its in solutions])
    chosen = max(range(len(solutions)), key=lambda i: judged[i] if usable(judged[i]) else -math.inf)
    took = {"fit_seconds": task.seconds["retrain"], "env_steps": sum(its.env_steps for its in solutions)}
    took |= {"check_steps": sum(its.check_steps for its in solutions) + judged_by}
    took |= {"rl_solves": len(solutions), "solves": len(solutions)}
    best = solutions[chosen]
    curves = {"pi_R": best.curve, "pi_R_true": best.true_curve}
    curves["pi_R_chosen"] = best.curve[best.best : best.best + 1]
    tried = [(its.policy, earned) for its, earned in zip(solutions, judged, strict=True)]
    return Made("pi_R", best.policy, reward, took | measured(task, reward), curves, solves=tried)


def solve(task: Task, reward: Reward | None, number: int) -> Solution:
    """Return what RL finds from scratch under the reward. number: of the solve. It alone decides the random
    numbers, so that one solve depends on no other."""
    before, steps = number * task.rl_steps, task.solves * task.rl_steps
    solver = solver_for(
        *(task.place, task.conditions.protocol, task.rng(f"pi_R {number}"), task.conditions.rl),
        told=lambda done: task.tell(f"retrain, step {before + done:,} of {steps:,}"),
    )
    return replace(solver.solve(reward, task.rl_steps), checkpoints=())


def judge(task: Task, reward: Reward, policies: Sequence[Policy]) -> tuple[list[float], int]:
    """Return the mean return of each policy under the reward on the judging episodes, and their steps."""
    seeds = judging_seeds(task.cell.seed, JUDGING_EPISODES)
    played = list(Simulator(task.place).run_each(policies, seeds))
    shown = [[(one.obs, one.act) for one in its] for its in played]
    earned = [float(totals(fast(reward), its).mean()) for its in shown]
    return earned, sum(len(one.act) for its in played for one in its)


def solves(task: Task, made: Made, scored: Mapping[PolicyName, Evaluation]) -> list[Solve]:
    """Return every solve of pi_R, with its returns on the evaluation episodes."""
    found = []
    for policy, judged in made.solves:
        its = scored[made.name] if policy is made.policy else score(task, policy, made.reward)
        solved = solved_by(task, its, scored)
        found.append(Solve(judged, its.own_return, float(its.returns.mean()), solved))
    return found


def solved_by(task: Task, its: Evaluation, scored: Mapping[PolicyName, Evaluation]) -> float:
    """Return `is_solved` of a policy that RL found under R*."""
    star = scored["pi_star"].own_return if "pi_star" in scored else math.nan
    return is_solved(its.own_return, star, task.noted.get("own_return_random", math.nan))


def measured(task: Task, reward: Reward | None) -> dict[str, float]:
    """How far the reward is from the true one, in the env's own dynamics."""
    spec = task.spec
    if task.place is not spec:
        return {}
    with task.during("measure"):
        if spec.tabular:
            compared = known_comparison(reward, spec.tabular, spec.gamma)
        else:
            compared = sampled_comparison(reward, task.shared.replays)
        found = {f"reward_{name}": value for name, value in compared._asdict().items()}
        if ranked := task.shared.ranked:
            found["policy_ranking"] = ranked.ranking(reward)
    return found


def score(task: Task, policy: Policy, reward: Reward | None) -> Evaluation:
    """In the original environment, by the true reward, and by the one that it was trained on or found
    with."""
    with task.during("score"):
        return evaluate(task.place, policy, task.seeds, reward and fast(reward))


def row(task: Task, made: Made, scored: Mapping[PolicyName, Evaluation]) -> Row:
    """Of scores.csv."""
    its = scored.get(made.name)
    columns = {"expert": task.shared.expert.name, **task.noted, **made.columns}
    columns |= its.columns() if its else {}
    columns |= {"solved": solved_by(task, its, scored)} if its and made.name == "pi_R" else {}
    columns["status"] = "ok" if its else "skipped"
    return row_of(task.cell, made.name, task.conditions.protocol, **columns)


def missed_bar(task: Task, expert: Evaluation) -> str:
    """Why the expert is none to be trusted, '' where it meets its bar."""
    episodes, allowed = len(expert.returns), task.place.max_terminated[task.conditions.budget]
    terminated = (episodes - expert.endings.get("time limit", 0)) / episodes
    bar = task.place.bar(task.seeds)
    if expert.returns.mean() >= bar and terminated <= allowed:
        return ""
    reached = as_text(expert.returns.mean(), ".2f")
    return (
        f"{task.cell.env}, seed {task.cell.seed}: the expert misses its bar: mean return "
        f"{reached} (at least {bar:.2f}), {terminated:.0%} of episodes terminated "
        f"early (at most {allowed:.0%})"
    )
