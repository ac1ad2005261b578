"""What is recorded of the evaluation episodes that `harness.run.watched` chooses."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from envs import EnvSpec
from harness.judge.advantage import policy_advantage
from harness.judge.evaluation import Evaluation
from harness.judge.results import LARGEST, recording_of
from harness.learn.exact import expected_rewards
from harness.learn.simulator import Simulator, Trajectory
from harness.run.stages import Made, Task
from harness.run.watched import Watched, chosen
from harness.show.maps import maps
from harness.show.recordings import Advantage, Episode, record
from harness.show.scenes import scene
from methods.base import Array, Policy, Reward
from methods.tabular import greedy, value_iteration

MOMENTS = 6
"""Stretches of an episode whose advantage is told, where the model is not known."""
LEAST_WEIGHT = 0.05
"""What the expert would go on to reach counts until the discount has fallen to this."""


def recorded(task: Task, made: Made, scored: Evaluation, watched: Watched) -> dict[str, bytes]:
    """The recordings of a policy's episodes that conditions ask for, by the files' names."""
    with task.during("record"):
        actions = watched.actions([int(length) for length in scored.lengths])
        found = {
            which: record(
                *(task.place, task.cell, made.name, which),
                _episode(task, made, scored, actions[number], number),
            )
            for which, number in chosen(task.conditions.record, scored.returns).items()
        }
        return {recording_of(task.cell, made.name, which): data for which, data in found.items()}


def _episode(task: Task, made: Made, scored: Evaluation, act: Array, number: int) -> Episode:
    spec, seed, reward = task.place, task.seeds[number], made.reward
    trajectory = play(spec, seed, act)
    obs, policy, expert = trajectory.obs[:-1], made.policy, None
    assert policy is not None
    if task.place is task.spec and task.conditions.experts != "none" and made.name != "expert":
        expert = task.shared.expert.policy
    shaped = _shaped(reward, obs)
    return Episode(
        trajectory,
        scene=None if spec.name == "gridworld" else scene(spec, seed, trajectory.act),
        learned=None if reward is None else _paid(reward, trajectory),
        expert=None if expert is None else spec.executed(expert(obs)),
        f=shaped[0] if shaped else None,
        precision=shaped[1] if shaped else None,
        advantage=None if expert is None else advantage(spec, expert, trajectory, seed, reward),
        maps=maps(spec, policy, reward, trajectory.obs),
        facts=_among(scored, number),
    )


def play(spec: EnvSpec, seed: int, act: Array) -> Trajectory:
    """The episode of these actions (T, A), as the policy chose them."""
    chosen = spec.executed(act)
    (trajectory,) = Simulator(spec, 1).run(lambda obs: np.zeros((len(obs), spec.act_size)), [seed], [chosen])
    return trajectory


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
    obs = trajectory.obs
    paid = np.asarray(reward(obs[:-1], trajectory.act, obs[1:]) - reward.absorbing, np.float64)
    return np.where(np.abs(paid) <= LARGEST, paid, 0.0)


def _shaped(reward: Reward | None, obs: Array) -> tuple[Array, Array] | None:
    """f(s) and the eigenvalues of L(s) L(s)^T + I, (T, A) each, where the reward is of that form."""
    from methods.shaped import ShapedReward  # torch, which other cells may do without

    if not isinstance(reward, ShapedReward):
        return None
    flat = reward.chol(obs)
    size = math.isqrt(flat.shape[1])
    values = np.linalg.svd(flat.reshape(-1, size, size), compute_uv=False)
    return reward.f(obs), 1 + np.square(values[:, ::-1])


def advantage(
    spec: EnvSpec, expert: Policy, trajectory: Trajectory, seed: int, reward: Reward | None
) -> Advantage | None:
    """What the episode's actions are worth over the expert's, by both rewards: of each action where the model
    is known, or of each of `MOMENTS` stretches, by what the expert reaches from where they begin and end.
    None where a cut episode is too short to tell."""
    if spec.tabular:
        return _known_advantage(spec, trajectory, reward)
    length, most = len(trajectory.act), math.ceil(math.log(LEAST_WEIGHT) / math.log(spec.gamma))
    moments = np.unique(np.linspace(0, length, MOMENTS + 1).astype(np.int64))
    begun = [trajectory.act[:moment] for moment in moments[:-1]]
    after = Simulator(spec, len(begun)).run(expert, [seed] * len(begun), begun, most)

    def gained(rewards: Array, of_expert: Sequence[Array]) -> Array:
        values = [_discounted(paid[at:], spec.gamma) for paid, at in zip(of_expert, moments, strict=False)]
        values += [0.0]  # nothing is to be had where an episode has ended
        found = []
        for i, (at, to) in enumerate(pairwise(moments)):
            own = _discounted(rewards[at:to], spec.gamma)
            found.append(own + spec.gamma ** (to - at) * values[i + 1] - values[i])
        return np.array(found)

    # How an episode that was cut at the horizon would have gone on is not known.
    told = slice(None if trajectory.terminated else -1)
    if not len(moments[1:][told]):
        return None
    true = gained(trajectory.rewards, [one.rewards for one in after])
    learned = (
        None if reward is None else gained(_paid(reward, trajectory), [_paid(reward, one) for one in after])
    )
    return Advantage(moments[1:][told], true[told], None if learned is None else learned[told])


def _known_advantage(spec: EnvSpec, trajectory: Trajectory, reward: Reward | None) -> Advantage:
    """Of each action, by value iteration."""
    tabular = spec.tabular
    assert tabular is not None
    expert = greedy(value_iteration(tabular.P, tabular.reward, spec.gamma)[1])
    true = np.broadcast_to(tabular.reward[:, None], tabular.P.shape[:2])
    at = tabular.states(trajectory.obs[:-1]), trajectory.act.argmax(axis=1)
    found = [
        policy_advantage(tabular.P, paid, expert, spec.gamma)[at]
        for paid in (true, *([] if reward is None else [expected_rewards(tabular, reward)]))
    ]
    return Advantage(np.arange(len(trajectory.act)), found[0], found[1] if found[1:] else None)


def _discounted(rewards: Array, gamma: float) -> float:
    return float(rewards @ gamma ** np.arange(len(rewards)))
