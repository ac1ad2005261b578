"""Which evaluation episodes of a policy are recorded, and what it did in them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from harness.judge.results import MOST_EPISODES
from harness.registry import Record
from methods.base import Array, Policy


class Watched:
    """A policy, and what it did, so that whatever it is like its episodes can be played again."""

    def __init__(self, policy: Policy) -> None:
        self.policy = policy
        self._answers: list[Array] = []

    def __call__(self, obs: Array, /) -> Array:
        act = self.policy(obs)
        self._answers.append(np.array(act))  # for it may be the policy's own buffer
        return act

    def actions(self, lengths: Sequence[int]) -> list[Array]:
        """What it did in each of the episodes of these lengths that a `Simulator` just ran, (T, A) each."""
        waiting = iter(range(len(lengths)))
        playing = {place: next(waiting) for place in range(len(self._answers[0]))}
        found: list[list[Array]] = [[] for _ in lengths]
        for answer in self._answers:
            for place, act in zip(sorted(playing), answer, strict=True):
                episode = playing[place]
                found[episode].append(act)
                if len(found[episode]) == lengths[episode]:
                    del playing[place]
                    if (following := next(waiting, None)) is not None:
                        playing[place] = following
        return [np.array(acts) for acts in found]


def chosen(kind: Record, returns: Array) -> dict[str, int]:
    """The numbers of the episodes to record, by what each is: the median, the lower of two, and the worst;
    the first of those that return as much."""
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
