"""A policy's actions in its evaluation episodes, and the choice of those that are recorded."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from harness.registry import Record
from harness.registry.bounds import MOST_EPISODES
from methods.base import Array, Policy


class Watched:
    """A policy that remembers its actions, so that its episodes can be played again."""

    def __init__(self, policy: Policy) -> None:
        self.policy = policy
        self._answers: list[Array] = []

    def __call__(self, obs: Array, /) -> Array:
        act = self.policy(obs)
        self._answers.append(np.array(act))  # a copy, because it may be the policy's own buffer
        return act

    def actions(self, lengths: Sequence[int]) -> list[Array]:
        """Return the actions of each episode that a `Simulator` just ran, (T, A) each, by their lengths."""
        waiting = iter(range(len(lengths)))
        playing = {place: next(waiting) for place in range(len(self._answers[0]))}
        actions: list[list[Array]] = [[] for _ in lengths]
        for answer in self._answers:
            for place, act in zip(sorted(playing), answer, strict=True):
                episode = playing[place]
                actions[episode].append(act)
                if len(actions[episode]) == lengths[episode]:
                    del playing[place]
                    if (following := next(waiting, None)) is not None:
                        playing[place] = following
        return [np.array(acts) for acts in actions]


def chosen(kind: Record, returns: Array) -> dict[str, int]:
    """Return the numbers of the episodes to record, by what each is.

    The median is the lower of two. Ties go to the first episode.
    """
    order = np.argsort(returns, kind="stable")
    named = {"median": int(order[(len(order) - 1) // 2]), "worst": int(order[0])}
    match kind:
        case "median" | "worst":
            return {kind: named[kind]}
        case "both":
            return named
        case "all":
            some = range(min(len(returns), MOST_EPISODES))
            return named | {f"episode_{i}": i for i in some if i not in named.values()}
    return {}
