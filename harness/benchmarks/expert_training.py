"""Training of one agent for the shipped experts, its checkpoints, and the bar that an expert must reach."""

from __future__ import annotations

import dataclasses
import time
from typing import NamedTuple

import numpy as np

from envs import EnvSpec
from envs.spec import Shipped
from harness.cell.shipped import ShippedExpert
from harness.judge.evaluation import evaluate
from harness.registry import SPECS, BadInput
from harness.registry.bounds import thinned
from harness.registry.machine import origin
from harness.rl.seeds import rng_for, tuning_seeds
from harness.rl.solving import Agent, disturbed
from methods.base import Policy
from methods.network import Network

MORE = 4
"""Further tuning episodes, as a multiple of the task's, that must end as seldom early: the best of several
flatters."""
FEWER = 5
"""Checkpoints of one training are compared by this fraction of those episodes."""
NEAR, MOST_NEAR = 0.01, 12
"""Checkpoints whose returns differ by less, relative to the range from random to best, are near-ties; of
more than this number, some at equal distances are compared."""
MEDIUM, MEDIUM_TRIED, MEDIUM_OFF = 0.5, 10, 0.15
"""Share of that range that a medium expert should have, the number of checkpoints that are measured for it,
and the largest distance from that share. Agents that learn suddenly have no medium expert."""
MARGIN = 0.5
"""Share of the early endings that the bar allows on tuning episodes: others may have more."""
MOST_CHECKS = 200
"""Points that are kept of a training's curve."""


class Candidate(NamedTuple):
    """A line of candidates.csv: an agent trained for `env` from `seed`, judged on tuning episodes.

    `number`: of the expert that it became, or ''. `terminated`: share of episodes that ended early.
    `confirmed`: that share of `MORE` times as many, 1 where something else rules the agent out.
    """

    env: str
    seed: int
    number: str
    mean_return: float
    terminated: float
    confirmed: float
    noisy_return: float
    medium_return: float
    random_return: float
    env_steps: int
    check_steps: int
    seconds: float


class Measured(NamedTuple):
    """An expert's mean true return and share of episodes that ended early."""

    mean_return: float
    terminated: float

    def __str__(self) -> str:
        return f"mean return {self.mean_return:.2f}, {self.terminated:.1%} ended early"


def shipped_of(spec: EnvSpec) -> Shipped:
    """Return how a task's experts are made. Raises BadInput where it has none."""
    if spec.shipped is None:
        raise BadInput(f"{spec.name} has no experts that are shipped")
    return spec.shipped


def measure(spec: EnvSpec, policy: Policy, seeds: range) -> Measured:
    """Return what a policy reaches on the episodes of these seeds."""
    scored = evaluate(spec, policy, seeds)
    early = (len(seeds) - scored.endings.get("time limit", 0)) / len(seeds)
    return Measured(float(scored.returns.mean()), early)


def meets_bar(spec: EnvSpec, measured: Measured, margin: float = 1.0) -> bool:
    """Return whether an expert does what a shipped one must do. margin: share of the early endings
    allowed."""
    shipped = shipped_of(spec)
    ended_early = round(measured.terminated, 9)  # 10 of 1,000 are 1 %, and no more
    seldom = shipped.terminated is None or ended_early <= margin * shipped.terminated
    return measured.mean_return >= shipped.bar and seldom


def is_good(one: Candidate) -> bool:
    """Return whether an agent may become an expert, by its tuning episodes, and has a medium checkpoint."""
    share = (one.medium_return - one.random_return) / (one.mean_return - one.random_return)
    worst = Measured(one.mean_return, max(one.terminated, one.confirmed))
    return meets_bar(SPECS[one.env], worst, MARGIN) and abs(share - MEDIUM) <= MEDIUM_OFF


def confirm(spec: EnvSpec, policy: Policy, judged: Measured) -> float:
    """Return the share of further tuning episodes that end early, where it matters and those before do not
    rule the policy out."""
    shipped = shipped_of(spec)
    if not meets_bar(spec, judged, MARGIN):
        return 1.0
    if shipped.terminated is None:
        return judged.terminated
    seeds = tuning_seeds((1 + MORE) * shipped.episodes)[shipped.episodes :]
    return measure(spec, policy, seeds).terminated


def train(env: str, seed: int) -> tuple[Candidate, ShippedExpert]:
    """Return an agent trained on the true reward, judged on tuning episodes, and its policies."""
    spec, started = SPECS[env], time.perf_counter()
    shipped = shipped_of(spec)
    settings = shipped.rl or spec.rl
    if every := shipped.checkpoint_every:
        settings = dataclasses.replace(settings, checkpoint_every=every)
    learner = Agent(spec, "absorbing", rng_for(seed, env, "shipped expert"), "sbx", settings)
    solution = learner.solve(None, shipped.steps)
    policies, checked = solution.checkpoints, np.array([value for _, value in solution.true_curve])
    few, rng = tuning_seeds(shipped.episodes // FEWER), rng_for(seed, env, "random")
    random_return = measure(spec, lambda obs: spec.random_actions(len(obs), rng), few).mean_return

    # Of near-ties, those come first that meet the bar and bear noise best.
    scale = checked.max() - random_return
    near = np.flatnonzero(checked >= checked.max() - NEAR * scale).tolist()
    plain = {i: measure(spec, policies[i], few) for i in thinned(near, MOST_NEAR)}
    least = max(one.mean_return for one in plain.values()) - NEAR * scale
    ties = [i for i, one in plain.items() if one.mean_return >= least]
    noisy = {i: measure(spec, disturbed(policies[i], spec, settings.noise), few).mean_return for i in ties}
    ties.sort(key=lambda i: (meets_bar(spec, plain[i], MARGIN), noisy[i], i), reverse=True)
    for chosen in ties:
        judged = measure(spec, policies[chosen], tuning_seeds(shipped.episodes))
        confirmed = confirm(spec, policies[chosen], judged)
        if meets_bar(spec, judged._replace(terminated=confirmed), MARGIN):
            break

    half = random_return + MEDIUM * (judged.mean_return - random_return)
    nearest = np.abs(checked - half).argsort(kind="stable")[:MEDIUM_TRIED].tolist()
    returns = {i: measure(spec, policies[i], few).mean_return for i in nearest}
    medium = min(returns, key=lambda i: abs(returns[i] - half))
    took = solution.env_steps, solution.check_steps, round(time.perf_counter() - started, 1)
    reached = *judged, confirmed, noisy[chosen], returns[medium], random_return
    candidate = Candidate(env, seed, "", *reached, *took)
    facts = {
        **candidate._asdict(),
        "settings": dataclasses.asdict(settings),
        "curve": thinned(solution.true_curve, MOST_CHECKS),
        "origin": origin(),
        "checkpoint": solution.true_curve[chosen][0],
        "medium_checkpoint": solution.true_curve[medium][0],
    }
    expert, half_way = policies[chosen], policies[medium]
    assert isinstance(expert, Network)
    assert isinstance(half_way, Network)
    return candidate, ShippedExpert(expert, half_way, facts)
