"""Recordings of evaluation episodes."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from envs import EnvSpec
from harness.cell.fitting import Candidate
from harness.cell.inputs import Inputs
from harness.judge.advantage import policy_advantage
from harness.judge.evaluation import Evaluation
from harness.recordings.episode import Advantage, Episode
from harness.recordings.episode import record as recording
from harness.recordings.maps import maps
from harness.recordings.pictures import pictures
from harness.recordings.scenes import scene
from harness.registry import Record
from harness.registry.bounds import LARGEST, MOST_EPISODES
from harness.rl.exact import expected_rewards
from harness.rl.simulator import Simulator, Trajectory
from harness.store.names import recording_of
from methods.base import Array, Policy, Reward
from methods.tabular.model import greedy, value_iteration

NO_NUMBERS = "It records episodes that were scored before."

MOMENTS = 6
"""Parts of an episode whose advantage is recorded, where the model is not known."""
LEAST_WEIGHT = 0.05
"""The discount at which the expert's further rewards no longer count."""


def record(inputs: Inputs, candidate: Candidate, evaluation: Evaluation) -> dict[str, bytes]:
    """Return the recordings of a policy's episodes by file name."""
    spec, reward, policy, expert = inputs.place, candidate.reward, candidate.policy, None
    assert policy is not None
    sees_this = inputs.conditions.experts != "none" and not spec.expert_task
    if sees_this and candidate.name != "expert" and not inputs.is_transfer:
        expert = inputs.shared.expert.policy
    numbers = chosen(inputs.conditions.record, evaluation.returns)
    seeds = [inputs.seeds[number] for number in numbers.values()]
    played = [evaluation.episodes[number] for number in numbers.values()]
    worth: Sequence[Advantage | None] = [None] * len(played)
    if expert is not None:
        worth = advantages(spec, expert, played, seeds, reward)
    files = dict[str, bytes]()
    for which, seed, trajectory, advantage in zip(numbers, seeds, played, worth, strict=True):
        obs = trajectory.obs[:-1]
        f, precision = shaped_parts(reward, obs)
        episode = Episode(
            trajectory,
            scene=None if spec.name == "gridworld" else scene(spec, seed, trajectory.act),
            learned=None if reward is None else above_absorption(reward, trajectory),
            expert=None if expert is None else np.array(spec.executed(expert(obs.copy()))),
            f=f,
            precision=precision,
            advantage=advantage,
            maps=None if spec.encoder else maps(spec, policy, reward, trajectory.obs),
            pictures=pictures(spec, seed, trajectory.act) if spec.encoder else None,
            facts=_place(evaluation, numbers[which]),
        )
        name = recording_of(inputs.cell, candidate.name, which)
        files[name] = recording(spec, inputs.cell, candidate.name, which, episode)
    return files


def chosen(kind: Record, returns: Array) -> dict[str, int]:
    """Return the numbers of the episodes to record, by what each is.

    The median is the lower of two. Ties go to the first episode.
    """
    order = np.argsort(returns, kind="stable")
    named = {"median": int(order[(len(order) - 1) // 2]), "worst": int(order[0])}
    if kind in named:
        return {kind: named[kind]}
    rest = range(min(len(returns), MOST_EPISODES)) if kind == "all" else ()
    return named | {f"episode_{i}": i for i in rest if i not in named.values()}


def _place(evaluation: Evaluation, number: int) -> dict[str, str | float]:
    """Return the place of this episode among all episodes of the policy."""
    low, high = evaluation.returns.min(), evaluation.returns.max()
    endings = ", ".join(f"{count} {reason}" for reason, count in evaluation.endings.items())
    return {
        "evaluation episode": f"{number} of {len(evaluation.returns)}",
        "mean return of all": round(float(evaluation.returns.mean()), 6),
        "returns of all": f"{low:.6g} to {high:.6g}",
        "endings of all": endings,
    }


def above_absorption(reward: Reward, trajectory: Trajectory) -> Array:
    """Return R* less what absorption pays, (T,), with 0 for values that are not usable."""
    obs, act = trajectory.obs.copy(), trajectory.act.copy()
    paid = np.asarray(reward(obs[:-1], act, obs[1:].copy()) - reward.absorbing, np.float64)
    return np.where(np.abs(paid) <= LARGEST, paid, 0.0)


def shaped_parts(reward: Reward | None, obs: Array) -> tuple[Array | None, Array | None]:
    """Return f(s) and the eigenvalues of L(s) L(s)^T + I, (T, A) each. None for other rewards."""
    from methods.shaped import ShapedReward  # imports torch, which other cells do without

    if not isinstance(reward, ShapedReward):
        return None, None
    flat = reward.chol(obs)
    size = math.isqrt(flat.shape[1])
    values = np.linalg.svd(flat.reshape(-1, size, size), compute_uv=False)
    return reward.f(obs), 1 + np.square(values[:, ::-1])


def advantages(
    spec: EnvSpec, expert: Policy, played: Sequence[Trajectory], seeds: Sequence[int], reward: Reward | None
) -> list[Advantage | None]:
    """Return the advantage of each episode's actions over the expert's, under both rewards.

    Where the model is known there is one for each action. Otherwise there is one for each of `MOMENTS` parts,
    from episodes in which the expert takes over at its beginning and at its end. None for a truncated episode
    that is too short.
    """
    if spec.tabular:
        return [_known_advantage(spec, trajectory, reward) for trajectory in played]
    most = math.ceil(math.log(LEAST_WEIGHT) / math.log(spec.gamma))
    moments = [np.unique(np.linspace(0, len(one.act), MOMENTS + 1).astype(np.int64)) for one in played]
    begun = [one.act[:at] for one, times in zip(played, moments, strict=True) for at in times[:-1]]
    each = [seed for seed, times in zip(seeds, moments, strict=True) for _ in times[:-1]]
    taken_over = iter(Simulator(spec).run(expert, each, begun, most))
    result = list[Advantage | None]()
    for one, times in zip(played, moments, strict=True):
        others = [next(taken_over) for _ in times[:-1]]
        # The future of a truncated episode is unknown.
        known = slice(None if one.terminated else -1)
        true = _gained(one.rewards, [other.rewards for other in others], times, spec.gamma)[known]
        learned = None
        if reward is not None:
            paid = [above_absorption(reward, other) for other in others]
            learned = _gained(above_absorption(reward, one), paid, times, spec.gamma)[known]
        result.append(Advantage(times[1:][known], true, learned) if len(true) else None)
    return result


def _gained(rewards: Array, of_expert: Sequence[Array], moments: NDArray[np.int64], gamma: float) -> Array:
    """Return the advantage of each part between K + 1 moments, (K,).

    rewards: (T,), of the episode. of_expert: of the episodes in which the expert takes over at each moment.
    """
    values = [_discounted(paid[at:], gamma) for paid, at in zip(of_expert, moments[:-1], strict=True)]
    values.append(0.0)  # an episode that has ended pays nothing
    gained = []
    for i, (at, to) in enumerate(pairwise(moments)):
        own = _discounted(rewards[at:to], gamma)
        gained.append(own + gamma ** (to - at) * values[i + 1] - values[i])
    return np.array(gained)


def _known_advantage(spec: EnvSpec, trajectory: Trajectory, reward: Reward | None) -> Advantage:
    """Return the advantage of each action, by value iteration."""
    tabular = spec.tabular
    assert tabular is not None
    expert = greedy(value_iteration(tabular.P, tabular.reward, spec.gamma)[1])
    true = np.broadcast_to(tabular.reward[:, None], tabular.P.shape[:2])
    at = tabular.states(trajectory.obs[:-1]), trajectory.act.argmax(axis=1)
    values = [
        policy_advantage(tabular.P, rewards, expert, spec.gamma)[at]
        for rewards in (true, *([] if reward is None else [expected_rewards(tabular, reward)]))
    ]
    return Advantage(np.arange(len(trajectory.act)), values[0], values[1] if values[1:] else None)


def _discounted(rewards: Array, gamma: float) -> float:
    return float(rewards @ gamma ** np.arange(len(rewards)))
