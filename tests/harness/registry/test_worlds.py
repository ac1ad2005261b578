"""What methods presume and worlds refuse fails `check`, and answers that no run would take do, too."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from harness.registry.contract import ContractError, check_method, small
from harness.registry.contract.methods import checks
from harness.rl.learned import check_learned
from harness.rl.world import TaskWorld
from methods.base import Array, Episodes, Learned, World
from methods.rewards import Constant

STILL = Constant(0.0, 0.0)


def still(obs: Array) -> Array:
    return np.zeros((len(obs), 2))


@dataclass(frozen=True)
class Calls:
    """A method that does something with its world, and returns a policy."""

    call: Callable[[World, Episodes, np.random.Generator], Any]

    def fit(self, demos: Episodes, world: World, rng: np.random.Generator) -> Learned:
        self.call(world, demos, rng)
        return Learned(lambda obs: np.eye(world.act_size)[np.zeros(len(obs), int)] * 0.5, None)


def agent(world: World, rng: np.random.Generator, reward: Any = STILL, **wish: Any) -> Any:
    learner = world.agent(rng, **wish)
    learner.learn(320, reward)
    return learner


def pays(value: float) -> Any:
    return Constant(value, 0.0)


FIT, KNOWN = "fit returns a policy and a reward: ", "where the model is known: "
PRESUMED = {
    "replay of a known model": (lambda w, d, r: agent(w, r).replay(), f"{KNOWN}.*nothing is seen"),
    "the expert's actions": (lambda w, d, r: w.ask(d.pairs()[0]), f"{FIT}.*marked as asking"),
    "a policy before learning": (lambda w, d, r: w.agent(r).policy, f"{FIT}.*not learned yet"),
    "a solve without a step": (lambda w, d, r: w.solve(STILL, r, 0), f"{FIT}.*one step at least"),
    "no reward": (
        lambda w, d, r: agent(w, r, None) if callable(r) else w.agent(r).learn(10, None),
        f"{FIT}.*reward",
    ),
    "a reward of NaN": (lambda w, d, r: agent(w, r, pays(np.nan)), f"{FIT}.*finite"),
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


@dataclass(frozen=True)
class Pays:
    value: float
    absorbing: float = 0.0

    def __call__(self, obs: Array, act: Array, next_obs: Array, /) -> Array:
        return np.full(len(obs), self.value)


@pytest.mark.parametrize(
    ("learned", "is_taken"),
    [
        (Learned(still, Pays(1.0)), True),
        (Learned(still, Pays(1e300)), False),
        (Learned(still, Pays(np.nan)), False),
        (Learned(still, Pays(1.0, np.nan)), False),
        (Learned(still, None, {"loss": [1.0, np.nan]}), True),
        (Learned(lambda obs: still(obs) * np.nan, None), False),
    ],
)
def test_check_and_run_come_to_one_verdict(learned: Learned, is_taken: bool) -> None:
    @dataclass(frozen=True)
    class Returns:
        def fit(self, demos: Episodes, world: World, rng: np.random.Generator) -> Learned:
            return learned

    outcome, _ = checks(Returns())[1].outcome()
    assert outcome == ("ok" if is_taken else "FAILED")
    try:
        check_learned(learned, small.noise(), small.shown(small.HORIZON))
    except (TypeError, ValueError):
        assert not is_taken
    else:
        assert is_taken


def test_no_agent_of_a_known_model_acts_before_it_has_learned() -> None:
    """Its policy would be the expert's."""
    world = TaskWorld(small.known(), "absorbing", "sb3")
    with pytest.raises(ValueError, match="not learned yet"):
        world.agent(np.random.default_rng(0)).policy  # noqa: B018
