"""What things cost, as ratios that survive a noisy machine: what is compared runs in turn, several times. Of
RL's solves, seconds of one core, and what they score."""

from __future__ import annotations

import contextlib
import io
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from highway_env.envs.highway_env import HighwayEnvFast

from envs import EnvSpec
from envs.driving.highway import BLOCK, CONFIG, HORIZON, drive, first_states
from harness.engines.jobs import Engine
from harness.engines.processes import Processes
from harness.judge.evaluation import evaluate
from harness.judge.results import Cell, CellResult, Conditions
from harness.learn.rl import Agent
from harness.learn.seeds import evaluation_seeds
from harness.learn.simulator import Simulator
from harness.registry import METHODS, SPECS, VARIANTS, Library
from harness.run.experts import expert_for
from harness.run.grid import Grid
from methods.base import Policy

REPEATS = 5
EPISODES = 100
"""Evaluated at once, as cells do, against one after the other."""
SOLVES = {
    **{"cartpole": 3.0, "swingup": 3.0, "cartpole_swingup": 6.0, "pendulum": 6.0},
    **{"reacher": 20.0, "highway": 20.0, "acrobot": 60.0},
}
"""Tasks whose true reward is solved at full, and the seconds of one core that a solve may take."""
SEEDS = range(100, 100 + REPEATS)
"""Of those solves."""
SCORE = "of the expert"
"""Unit of normalised scores."""
CONDITIONS = Conditions("quick", "absorbing", "sbx")


@dataclass(frozen=True)
class Measure:
    """One figure, in each repeat. unit: 'times' as fast, 's' or 'ms', '%' or 'MB' of memory, 'of the expert'.
    bar: what is wanted, at least of ratios and scores and at most of the others; None where nothing is."""

    name: str
    unit: str
    values: list[float]
    bar: float | None

    @property
    def missed(self) -> bool:
        """Whether the median is on the wrong side of the bar."""
        if self.bar is None:
            return False
        median = statistics.median(self.values)
        return median < self.bar if self.unit in ("times", SCORE) else median > self.bar

    def to_json(self) -> dict[str, Any]:
        """Name, unit, median, smallest and largest value, bar."""
        spread = {"median": statistics.median(self.values), "low": min(self.values), "high": max(self.values)}
        return {"name": self.name, "unit": self.unit, **spread, "bar": self.bar}

    def __str__(self) -> str:
        spread = "{name}: {median:.4g} {unit} ({low:.4g} to {high:.4g})".format(**self.to_json())
        return spread if self.bar is None else f"{spread}, bar {self.bar:g}{' MISSED' if self.missed else ''}"


def compare(
    name: str, ours: Callable[[], int], theirs: Callable[[], int], bar: float | None, repeats: int = REPEATS
) -> Measure:
    """Rates of work, ours over theirs; both return how much of it they did. The first time does not count."""
    ratios = []
    for repeat in range(repeats + 1):
        rates = {work: _rate(work) for work in ((ours, theirs) if repeat % 2 else (theirs, ours))}
        ratios.append(rates[ours] / rates[theirs])
    return Measure(name, "times", ratios[1:], bar)


def _rate(work: Callable[[], int]) -> float:
    started = time.perf_counter()
    return work() / (time.perf_counter() - started)


def bench() -> Iterator[Measure]:
    """Every comparison, as it is made."""
    yield compare(
        f"{BLOCK} of highway-env's scenes, ours against its own",
        _drive,
        _drive_upstream,
        bar=100,
    )
    for env, bar in (("cartpole", 10.0), ("pendulum", 3.0), ("highway", None)):
        spec, policy = SPECS[env], expert_for(env, 0, CONDITIONS).policy
        yield compare(
            f"{env}, {EPISODES} episodes of a policy, against one after the other",
            partial(_together, spec, policy),
            partial(_one_by_one, spec, policy),
            bar,
        )
    for env, bar in SOLVES.items():
        _compile(env)
        yield from _solves(env, "sbx", bar)
    yield from _solves("cartpole", "sb3", None)
    for method in (*METHODS, *VARIANTS):
        yield _fit("swingup", method, each=1000, bar=None)
    yield _fit("halfcheetah", "gail", each=100_000, bar=300)
    yield compare(
        "two bare Python loops at once, against one", partial(_loops, 2), partial(_loops, 1), bar=None
    )
    yield compare(
        "8 equal cells, 2 workers against 1", partial(_grid, 2), partial(_grid, 1), bar=1.8, repeats=2
    )
    yield Measure("cells of cart-pole, share of time beside fit and RL", "%", _beside_the_work(), bar=3)
    with tempfile.TemporaryDirectory() as directory:
        cached = ["run", "--methods", "bc", "--envs", "gridworld", "--budget", "smoke", "--out", directory]
        command(cached)
        for name, arguments, bar in (
            ("--help", ["--help"], 0.5),
            ("list", ["list"], 0.5),
            ("a run that has nothing left to do", cached, 5.0),
        ):
            yield Measure(name, "s", [command(arguments) for _ in range(REPEATS)], bar)


def command(arguments: list[str]) -> float:
    """Seconds that `python -m harness` takes with these arguments, in a process of its own."""
    started = time.perf_counter()
    subprocess.run([sys.executable, "-m", "harness", *arguments], check=True, capture_output=True)
    return time.perf_counter() - started


def _drive() -> int:
    states, rng = first_states(range(BLOCK)), np.random.default_rng(0)
    for _ in range(HORIZON):  # on after crashes, which takes as long
        drive(states, np.arange(BLOCK), rng.normal(0, [0.3, 0.05], (BLOCK, 2)))
    return BLOCK * HORIZON


def _drive_upstream() -> int:
    env, rng, steps = HighwayEnvFast(dict(CONFIG)), np.random.default_rng(0), 0
    for seed in range(3):
        env.reset(seed=seed)
        ended = False
        while not ended and steps < HORIZON * (seed + 1):
            action = rng.normal(0, [0.3, 0.05]).astype(np.float32)
            ended, steps = bool(env.step(action)[2]), steps + 1
    return steps


def _together(spec: EnvSpec, policy: Policy) -> int:
    return sum(len(e.act) for e in Simulator(spec).run(policy, range(EPISODES)))


def _one_by_one(spec: EnvSpec, policy: Policy) -> int:
    """The loop that one would write; a part of the episodes, for it is slow."""
    env, steps = spec.make(), 0
    for seed in range(EPISODES // 10):
        obs, ended = env.reset(seed=seed)[0], False
        while not ended:
            obs, _, terminated, truncated, _ = env.step(spec.native(policy(obs[None])[0]))
            ended, steps = terminated or truncated, steps + 1
    return steps


def _solves(env: str, library: Library, bar: float | None) -> tuple[Measure, Measure]:
    """Return seconds of one core, and scores, of solves of the true reward."""
    seconds, scores = zip(*(_solve(env, seed, library) for seed in SEEDS), strict=True)
    name = f"{env}, a solve of the true reward by {library} at full"
    least = None if bar is None else 0.95
    return Measure(name, "s", [*seconds], bar), Measure(f"{name}, score", SCORE, [*scores], least)


def _compile(env: str) -> None:
    """Learn one bout, and check it, so that solves find what they need compiled."""
    agent = Agent(SPECS[env], "absorbing", np.random.default_rng(0), "sbx")
    agent.learn(agent.whole(1), None)
    agent.best(None)


def _solve(env: str, seed: int, library: Library) -> tuple[float, float]:
    """Return the seconds of one core that a solve takes, and its normalised score."""
    spec, rng = SPECS[env], np.random.default_rng(seed)
    started = time.process_time()
    found = Agent(spec, "absorbing", rng, library).solve(None, spec.rl_steps["full"])
    seconds = time.process_time() - started
    played, expert = evaluation_seeds(seed, EPISODES), expert_for(env, seed, CONDITIONS)
    policies: list[Policy] = [lambda obs: spec.random_actions(len(obs), rng), expert.policy, found.policy]
    least, most, reached = (evaluate(spec, policy, played).returns.mean() for policy in policies)
    return seconds, float((reached - least) / (most - least))


def _fit(env: str, method: str, each: int, bar: float | None) -> Measure:
    """Seconds on one core of a fit for so many environment steps, or altogether where it takes none; in a
    process of its own, which compiles."""
    [result] = compute([Cell(env, method, 0)], replace(CONDITIONS, retrain=False), Processes(1))
    took = result.rows[0]
    if took.env_steps == 0:
        return Measure(f"{env}, {method}, fit", "s", [took.fit_seconds], bar)
    name = f"{env}, {method}, fit, for each {each:,} of {took.env_steps:,} environment steps"
    return Measure(name, "s", [each * took.fit_seconds / took.env_steps], bar)


def _loops(count: int) -> int:
    """What the machine itself gives processes that share nothing."""
    loop = [sys.executable, "-c", "for _ in range(10**8): pass"]
    for process in [subprocess.Popen(loop) for _ in range(count)]:
        process.wait()
    return count


def _grid(workers: int) -> int:
    return len(
        compute([Cell("cartpole", "control_true", seed) for seed in range(8)], CONDITIONS, Processes(workers))
    )


def _beside_the_work() -> list[float]:
    """Of what each cell adds to a run, its process and its evaluation included. What a run computes once for
    all methods is there before; the first cell compiles, and does not count."""
    cells = [Cell("cartpole", "shaped", seed) for seed in range(1, REPEATS + 2)]
    seconds = [result.seconds for result in compute(cells, CONDITIONS, Processes(1))[1:]]
    return [100 * (1 - (its["fit"] + its["retrain"]) / sum(its.values())) for its in seconds]


class _Results:
    """Where they go: into a list."""

    def __init__(self) -> None:
        self.found: list[CellResult] = []

    def save(self, result: CellResult, files: Mapping[str, bytes]) -> None:
        self.found.append(result)

    def log(self, printed: bytes) -> None: ...

    def learned(self, cell: Cell) -> bytes:
        return b""


def compute(cells: list[Cell], conditions: Conditions, engine: Engine) -> list[CellResult]:
    """Cells as `run` computes them, in the order in which they came. Raises RuntimeError where one failed."""
    results = _Results()
    with contextlib.redirect_stdout(io.StringIO()):
        Grid(conditions, results, engine).run(cells)
    reasons = [row.reason for result in results.found for row in result.rows if row.status == "failed"]
    if reasons:
        raise RuntimeError(f"a cell failed: {reasons[0]}")
    return results.found
