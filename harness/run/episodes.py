"""What is recorded of the evaluation episodes that `harness.run.watched` chooses."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from envs import EnvSpec
from harness.judge.advantage import policy_advantage
from harness.judge.evaluation import Evaluation
from harness.judge.numbers import as_text
from harness.judge.results import LARGEST, recording_of
from harness.learn.exact import expected_rewards
from harness.learn.simulator import Simulator, Trajectory
from harness.run.stages import Made, Task
from harness.run.watched import Watched, chosen
from harness.show.maps import maps
from harness.show.recordings import Advantage, Episode, record
from harness.show.scenes import scene
from methods.base import Array, Policy, Reward
from methods.tabular.model import greedy, value_iteration

NO_NUMBERS = "It records episodes that were scored before."

MOMENTS = 6
"""Stretches of an episode whose advantage is told, where the model is not known."""
LANES = 100
"""Episodes that are played side by side, at most."""
SLACK = 1e-9
"""The largest difference, as a share, of an episode's return from the scored one when it is played again."""
LEAST_WEIGHT = 0.05
"""What the expert would go on to reach counts until the discount has fallen to this."""


def recorded(
    task: Task, made: Made, scored: Evaluation, watched: Watched
) -> tuple[dict[str, bytes], list[str]]:
    """Return the recordings of a policy's episodes by the files' names, and warnings.

    A warning says that an episode was not recorded. It earned another return when it was played again.
    """
    with task.during("record"):
        spec, reward, policy, expert = task.place, made.reward, made.policy, None
        assert policy is not None
        if spec is task.spec and task.conditions.experts != "none" and made.name != "expert":
            expert = task.shared.expert.policy
        actions = watched.actions([int(length) for length in scored.lengths])
        numbers = chosen(task.conditions.record, scored.returns)
        seeds = [task.seeds[number] for number in numbers.values()]
        played = play(spec, seeds, [actions[number] for number in numbers.values()])
        worth: Sequence[Advantage | None] = [None] * len(played)
        if expert is not None:
            worth = advantages(spec, expert, played, seeds, reward)
        found, troubles = {}, []
        for (which, number), seed, trajectory, one in zip(numbers.items(), seeds, played, worth, strict=True):
            again, once = float(trajectory.rewards.sum()), float(scored.returns[number])
            if not math.isclose(again, once, rel_tol=SLACK, abs_tol=SLACK):
                told = (
                    f"{as_text(once, '.6g')}, and {as_text(again, '.6g')} when its actions were played again"
                )
                what = f"{task.cell.name}, {made.name}: evaluation episode {number}"
                troubles.append(f"{what} returned {told}: the task is not reproducible, nothing is recorded")
                continue
            obs = trajectory.obs[:-1]
            shaped = _shaped(reward, obs)
            episode = Episode(
                trajectory,
                scene=None if spec.name == "gridworld" else scene(spec, seed, trajectory.act),
                learned=None if reward is None else _paid(reward, trajectory),
                expert=None if expert is None else np.array(spec.executed(expert(obs.copy()))),
                f=shaped[0] if shaped else None,
                precision=shaped[1] if shaped else None,
                advantage=one,
                maps=maps(spec, policy, reward, trajectory.obs),
                facts=_among(scored, number),
            )
            name = recording_of(task.cell, made.name, which)
            found[name] = record(spec, task.cell, made.name, which, episode)
        return found, troubles


def play(spec: EnvSpec, seeds: Sequence[int], acts: Sequence[Array]) -> list[Trajectory]:
    """The episodes of these actions (T, A), as a policy chose them."""
    done = [spec.executed(act) for act in acts]
    simulator = Simulator(spec, min(LANES, len(seeds)))
    return simulator.run(lambda obs: np.zeros((len(obs), spec.act_size)), seeds, done)


def _among(scored: Evaluation, number: int) -> dict[str, str | float]:
    """What tells this episode from the policy's others."""
    low, high = scored.returns.min(), scored.returns.max()
    endings = ", ".join(f"{count} {why}" for why, count in scored.endings.items())
    return {
        "evaluation episode": f"{number} of {len(scored.returns)}",
        "mean return of all": round(float(scored.returns.mean()), 6),
        "returns of all": f"{low:.6g} to {high:.6g}",
        "endings of all": endings,
    }


def _paid(reward: Reward, trajectory: Trajectory) -> Array:
    """(T,): what R* pays above absorption; numbers that mean nothing are 0."""
    obs, act = trajectory.obs.copy(), trajectory.act.copy()
    told = np.asarray(reward(obs[:-1], act, obs[1:].copy()) - reward.absorbing, np.float64)
    return np.where(np.abs(told) <= LARGEST, told, 0.0)


def _shaped(reward: Reward | None, obs: Array) -> tuple[Array, Array] | None:
    """f(s) and the eigenvalues of L(s) L(s)^T + I, (T, A) each, where the reward is of that form."""
    from methods.shaped import ShapedReward  # torch, which other cells may do without

    if not isinstance(reward, ShapedReward):
        return None
    flat = reward.chol(obs)
    size = math.isqrt(flat.shape[1])
    values = np.linalg.svd(flat.reshape(-1, size, size), compute_uv=False)
    return reward.f(obs), 1 + np.square(values[:, ::-1])


def advantages(
    spec: EnvSpec,
    expert: Policy,
    played: Sequence[Trajectory],
    seeds: Sequence[int],
    reward: Reward | None,
) -> list[Advantage | None]:
    """What each episode's actions are worth over the expert's, by both rewards: of each action where the
    model is known, or of each of `MOMENTS` stretches, by what the expert reaches from where they begin and
    end. None where a cut episode is too short to tell."""
    if spec.tabular:
        return [_known_advantage(spec, trajectory, reward) for trajectory in played]
    most = math.ceil(math.log(LEAST_WEIGHT) / math.log(spec.gamma))
    moments = [np.unique(np.linspace(0, len(one.act), MOMENTS + 1).astype(np.int64)) for one in played]
    begun = [one.act[:at] for one, its in zip(played, moments, strict=True) for at in its[:-1]]
    each = [seed for seed, its in zip(seeds, moments, strict=True) for _ in its[:-1]]
    after = iter(Simulator(spec, min(LANES, len(begun))).run(expert, each, begun, most))
    found = list[Advantage | None]()
    for one, its in zip(played, moments, strict=True):
        on = [next(after) for _ in its[:-1]]
        # How an episode that was cut at the horizon would have gone on is not known.
        told = slice(None if one.terminated else -1)
        true = _gained(one.rewards, [other.rewards for other in on], its, spec.gamma)[told]
        learned = None
        if reward is not None:
            theirs = [_paid(reward, other) for other in on]
            learned = _gained(_paid(reward, one), theirs, its, spec.gamma)[told]
        found.append(Advantage(its[1:][told], true, learned) if len(true) else None)
    return found


def _gained(rewards: Array, of_expert: Sequence[Array], moments: NDArray[np.int64], gamma: float) -> Array:
    """(K,): of each stretch between K + 1 moments, by these rewards (T,), and by those of the episodes in
    which the expert takes over at each."""
    values = [_discounted(its[at:], gamma) for its, at in zip(of_expert, moments[:-1], strict=True)]
    values.append(0.0)  # nothing is to be had where an episode has ended
    found = []
    for i, (at, to) in enumerate(pairwise(moments)):
        own = _discounted(rewards[at:to], gamma)
        found.append(own + gamma ** (to - at) * values[i + 1] - values[i])
    return np.array(found)


def _known_advantage(spec: EnvSpec, trajectory: Trajectory, reward: Reward | None) -> Advantage:
    """Of each action, by value iteration."""
    tabular = spec.tabular
    assert tabular is not None
    expert = greedy(value_iteration(tabular.P, tabular.reward, spec.gamma)[1])
    true = np.broadcast_to(tabular.reward[:, None], tabular.P.shape[:2])
    at = tabular.states(trajectory.obs[:-1]), trajectory.act.argmax(axis=1)
    found = [
        policy_advantage(tabular.P, rewards, expert, spec.gamma)[at]
        for rewards in (true, *([] if reward is None else [expected_rewards(tabular, reward)]))
    ]
    return Advantage(np.arange(len(trajectory.act)), found[0], found[1] if found[1:] else None)


def _discounted(rewards: Array, gamma: float) -> float:
    return float(rewards @ gamma ** np.arange(len(rewards)))
