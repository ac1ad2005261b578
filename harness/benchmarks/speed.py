"""Speed: ratios to the usual way, RL's solves in seconds of one core, and waits for commands."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Iterator
from functools import partial

import numpy as np

from envs import EnvSpec
from harness.benchmarks.measure import QUICK, REPEATS, SCORE, Measure, command, compare, compute
from harness.cell.experts import source_for
from harness.engines.processes import Processes
from harness.judge.evaluation import evaluate
from harness.records import Cell
from harness.registry import SPECS
from harness.rl.seeds import evaluation_seeds
from harness.rl.simulator import Simulator
from harness.rl.solving import Agent
from methods.base import Policy

EPISODES = 100
"""Evaluated at once, as cells do, and one after the other."""
SOLVES = {
    **{"cartpole": 3.0, "swingup": 3.0, "cartpole_swingup": 6.0, "pendulum": 6.0},
    **{"reacher": 20.0, "highway": 20.0, "acrobot": 60.0},
}
"""Tasks whose true reward is solved at full, and the seconds of one core that a solve may take."""
SEEDS = range(100, 100 + REPEATS)
"""Seeds of those solves."""


def measures() -> Iterator[Measure]:
    """Take each measure in turn."""
    for env, bar in (("cartpole", 10.0), ("pendulum", 3.0)):
        spec, policy = SPECS[env], source_for(env, 0, QUICK).expert.policy
        name = f"{env}, {EPISODES} episodes of a policy, against one after the other"
        yield compare(name, partial(_together, spec, policy), partial(_one_by_one, spec, policy), bar)
    for env, bar in SOLVES.items():
        yield from _solves(env, bar)
    workers = partial(_grid, 2), partial(_grid, 1)
    yield compare("8 equal cells, 2 workers against 1", *workers, bar=1.8, repeats=2)
    with tempfile.TemporaryDirectory() as directory:
        cached = ["run", "--methods", "bc", "--envs", "gridworld", "--budget", "smoke", "--out", directory]
        command(cached)
        waits = {"--help": (["--help"], 0.5), "list": (["list"], 0.5)}
        for name, (arguments, bar) in (waits | {"a run that has nothing to do": (cached, 5.0)}).items():
            yield Measure(name, "s", [command(arguments) for _ in range(REPEATS)], bar)


def _together(spec: EnvSpec, policy: Policy) -> int:
    return sum(len(e.act) for e in Simulator(spec).run(policy, range(EPISODES)))


def _one_by_one(spec: EnvSpec, policy: Policy) -> int:
    """Run the usual loop on a part of the episodes."""
    env, steps = spec.make(), 0
    for seed in range(EPISODES // 10):
        obs, ended = env.reset(seed=seed)[0], False
        while not ended:
            obs, _, terminated, truncated, _ = env.step(spec.native(policy(obs[None])[0]))
            ended, steps = terminated or truncated, steps + 1
    return steps


def _solves(env: str, bar: float) -> tuple[Measure, Measure]:
    """Return seconds of one core, and scores, of solves of the true reward."""
    bout = Agent(SPECS[env], "absorbing", np.random.default_rng(0), "sbx")
    bout.solve(None, bout.whole(1))  # compiles what solves need
    seconds, scores = zip(*(_solve(env, seed) for seed in SEEDS), strict=True)
    name = f"{env}, a solve of the true reward at full"
    return Measure(name, "s", [*seconds], bar), Measure(f"{name}, score", SCORE, [*scores], bar=0.95)


def _solve(env: str, seed: int) -> tuple[float, float]:
    """Return the seconds of one core that a solve takes, and its normalised score."""
    spec, rng = SPECS[env], np.random.default_rng(seed)
    started = time.process_time()
    solution = Agent(spec, "absorbing", rng, "sbx").solve(None, spec.rl_steps["full"])
    seconds = time.process_time() - started
    seeds, expert = evaluation_seeds(seed, EPISODES), source_for(env, seed, QUICK).expert
    policies: list[Policy] = [lambda obs: spec.random_actions(len(obs), rng), expert.policy, solution.policy]
    least, most, reached = (evaluate(spec, policy, seeds).returns.mean() for policy in policies)
    return seconds, float((reached - least) / (most - least))


def _grid(workers: int) -> int:
    cells = [Cell("cartpole", "control_true", seed) for seed in range(8)]
    return len(compute(cells, QUICK, Processes(workers)))
