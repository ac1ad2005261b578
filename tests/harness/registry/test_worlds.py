"""What methods presume and worlds refuse fails `check`."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from harness.registry.contract import ContractError, check_method
from methods.base import Episodes, Learned, World
from methods.rewards import Constant

STILL = Constant(0.0, 0.0)
FIT = "fit returns a policy and a reward: "


@dataclass(frozen=True)
class Calls:
    """A method that does something with its world, and returns a policy."""

    call: Callable[[World, Episodes, np.random.Generator], Any]

    def fit(self, demos: Episodes, world: World, rng: np.random.Generator) -> Learned:
        self.call(world, demos, rng)
        return Learned(lambda obs: np.eye(world.act_size)[np.zeros(len(obs), int)] * 0.5, None)


def agent(world: World, rng: np.random.Generator, reward: Any = STILL) -> Any:
    learner = world.agent(rng)
    learner.learn(320, reward)
    return learner


PRESUMED = {
    "replay of a known model": (
        lambda w, d, r: agent(w, r).replay(),
        "where the model is known: .*nothing is seen",
    ),
    "the expert's actions": (lambda w, d, r: w.ask(d.pairs()[0]), f"{FIT}.*marked as asking"),
    "a policy before learning": (lambda w, d, r: w.agent(r).policy, f"{FIT}.*not learned yet"),
    "a solve without a step": (lambda w, d, r: w.solve(STILL, r, 0), f"{FIT}.*one step at least"),
    "no reward": (lambda w, d, r: agent(w, r, None), f"{FIT}.*reward"),
    "a reward of NaN": (lambda w, d, r: agent(w, r, Constant(np.nan, 0.0)), f"{FIT}.*finite"),
    "actions too far": (
        lambda w, d, r: w.rollout(lambda o: 1.5 * np.ones((len(o), w.act_size)), 2, r),
        f"{FIT}.*actions",
    ),
}


@pytest.mark.parametrize("what", PRESUMED)
def test_a_method_that_presumes_too_much_fails_its_check(what: str) -> None:
    call, why = PRESUMED[what]
    with pytest.raises(ContractError, match=why):
        check_method(Calls(call))


def test_a_method_knows_its_budget_and_that_the_model_is_known() -> None:
    seen = set()
    check_method(Calls(lambda w, d, r: seen.add((w.budget, w.model is None))))
    assert seen == {("smoke", True), ("smoke", False)}
