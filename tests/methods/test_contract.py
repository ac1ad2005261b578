"""What every method must satisfy."""

import re
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from harness import registry
from harness.registry import load_method
from harness.registry.contract import ContractError, check_method
from harness.registry.contract.check import Check
from harness.registry.contract.methods import checks
from methods.airl import AIRL
from methods.base import Array, Episodes, Learned, Method, World
from methods.settings import settings_for
from methods.sqil import SQIL

pytestmark = pytest.mark.usefixtures("fused_adam")
METHODS: dict[str, Method] = {
    name: load_method(name)(**(settings_for(name, "gridworld", "smoke")))
    for name in (*registry.METHODS, *registry.VARIANTS)
}
CHECKS = [(name, check) for name, method in METHODS.items() for check in checks(method)]


@pytest.mark.parametrize(("name", "check"), CHECKS, ids=[f"{name}: {check.title}" for name, check in CHECKS])
def test_every_method_keeps_the_contract(name: str, check: Check) -> None:
    outcome, why = check.outcome()
    if check.title == "so it does of every other step" and isinstance(METHODS[name], AIRL | SQIL):
        assert (outcome, "every step is shown" in why) == ("skipped", True)
    else:
        assert (outcome, why) == ("ok", "")


def linear(obs: Array) -> Array:
    return np.clip(obs[:, :2], -1, 1)


@dataclass(frozen=True)
class Pays:
    value: float = 1.0
    absorbing: Any = 0.0
    size: int = 1

    def __call__(self, obs: Array, act: Array, next_obs: Array) -> Array:
        return np.full(len(obs) * self.size, self.value)


@dataclass(frozen=True)
class Returns:
    """A method that returns what it is told."""

    learned: Any

    def fit(self, demos: Episodes, world: World, rng: np.random.Generator) -> Any:
        return self.learned(demos, rng) if callable(self.learned) else self.learned


@dataclass
class Thawed:
    def fit(self, demos: Episodes, world: World, rng: np.random.Generator) -> Learned:
        return Learned(linear, None)


def change(demos: Episodes, rng: np.random.Generator) -> Learned:
    for obs in demos.obs:
        obs.flags.writeable = True
        obs[:] = obs + 1
    return Learned(linear, None)


def draw(demos: Episodes, rng: np.random.Generator) -> Learned:
    shift = np.random.uniform(-0.1, 0.1)  # noqa: NPY002
    return Learned(lambda obs: 0.5 * linear(obs) + shift, None)


BROKEN = [
    (Thawed(), "it is a frozen dataclass", "must be frozen"),
    (Returns(None), "fit returns a policy and a reward", "fit must return a Learned, not NoneType"),
    (Returns(Learned(lambda obs: obs[:, :2], None)), "fit returns", r"lie in \[-1, 1\]"),
    (Returns(Learned(lambda obs: linear(obs - len(obs)), None)), "fit returns", "same batch"),
    (Returns(Learned(linear, linear)), "fit returns", "lacks `absorbing`"),  # type: ignore[arg-type]
    (Returns(Learned(linear, Pays(size=2))), "fit returns", r"one number a step, \(40,\), not \(80,\)"),
    (Returns(Learned(linear, Pays(np.inf))), "fit returns", "one finite number for each step"),
    (Returns(Learned(linear, Pays(absorbing=np.inf))), "fit returns", "one finite number"),
    (Returns(change), "it leaves demonstrations as they are", "changed the demonstrations"),
    (Returns(draw), "nothing but its generator decides", "draw from `rng` alone"),
    (Returns(lambda demos, rng: 1 / 0), "fit returns", "ZeroDivisionError"),
]


@pytest.mark.parametrize(("method", "title", "why"), BROKEN)
def test_who_breaks_the_contract_is_told_how(method: Method, title: str, why: str) -> None:
    failed = {check.title: check.outcome()[1] for check in checks(method) if check.outcome()[0] == "FAILED"}
    (found,) = [text for its_title, text in failed.items() if its_title.startswith(title)]
    assert re.search(why, found)
    with pytest.raises(ContractError):
        check_method(method)
