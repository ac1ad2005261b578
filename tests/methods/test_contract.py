"""What every method must satisfy, and what methods make of demonstrations."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
import torch

from harness import registry
from harness.registry import load_method
from harness.registry.contract import ContractError, check_method
from harness.registry.contract.check import Check
from harness.registry.contract.methods import checks
from methods.airl import AIRL
from methods.base import Array, Episodes, Learned, Method, Transitions, World
from methods.fourier import FourierFeatures
from methods.gaifo import GAIfO
from methods.network import mlp
from methods.rewards import NetworkReward, default_absorbing, deterred, paid
from methods.settings import settings_for
from methods.sqil import SQIL
from methods.visits import visitations, visited

pytestmark = pytest.mark.usefixtures("fused_adam")
METHODS: dict[str, Method] = {
    name: load_method(name)(**(settings_for(name, "gridworld", "smoke")))
    for name in (*registry.METHODS, *registry.VARIANTS)
    if name not in registry.THESIS or name == "shaped_thesis"
}
"""The arms of `shaped_thesis` are one class with other switches, and its own tests have each."""
OF_STATES = ("gail_mean_state", "gaifo", "f_irl", "maxent_state", "trex")
CHECKS = [(name, check) for name, method in METHODS.items() for check in checks(method)]


@pytest.mark.parametrize(("name", "check"), CHECKS, ids=[f"{name}: {check.title}" for name, check in CHECKS])
def test_every_method_keeps_the_contract(name: str, check: Check) -> None:
    outcome, why = check.outcome()
    if check.title == "so it does of every other step" and isinstance(METHODS[name], AIRL | GAIfO | SQIL):
        assert (outcome, "every step is shown" in why) == ("skipped", True)
    elif check.title == "so it does without actions" and name not in OF_STATES:
        assert (outcome, "the demonstrations have none" in why) == ("skipped", True)
    elif name == "trex" and "of one step" in check.title:
        assert (outcome, "T-REX learns from demonstrations with ranks" in why) == ("skipped", True)
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


def episodes(lengths: list[int], terminated: bool = False) -> Episodes:
    rng = np.random.default_rng(0)
    return Episodes(
        tuple(rng.standard_normal((n + 1, 3)) for n in lengths),
        tuple(rng.uniform(-1, 1, (n, 2)) for n in lengths),
        tuple(terminated for _ in lengths),
    )


def test_transitions_are_of_steps_that_follow_each_other() -> None:
    obs = tuple(np.arange(n + 1.0)[:, None] + 100 * n for n in (4, 7))
    act = tuple(np.linspace(-1, 1, n)[:, None] for n in (4, 7))
    before, done, after = Episodes(obs, act, (False, False)).transitions()
    np.testing.assert_array_equal(done, np.concatenate(act))
    np.testing.assert_array_equal(after, before + 1)
    times = (np.array([0, 1, 3]), np.array([2, 5, 6]))
    some = [tuple(rows[at] for rows, at in zip(column, times, strict=True)) for column in (obs, act)]
    before, done, after = Episodes(*some, (False, False), times, (4, 7)).transitions()
    assert (before[:, 0].tolist(), after[:, 0].tolist()) == ([400, 705], [401, 706])
    np.testing.assert_array_equal(done, [act[0][0], act[1][5]])


def test_bad_episodes_are_refused() -> None:
    obs, act = np.zeros((4, 3)), np.zeros((3, 2))
    assert len(Episodes((obs,), (act,), (False,)).act) == 1
    for wrong in (((), ()), ((obs,), (obs,)), ((obs * np.nan,), (act,)), ((obs,), (act + 1.5,))):
        with pytest.raises(ValueError, match="episode"):
            Episodes(*wrong, (False,) * len(wrong[0]))
    for times in ([0, 0, 1], [3, 4, 9], [3, 4]):
        with pytest.raises(ValueError, match="ascend"):
            Episodes((obs[:3],), (act,), (False,), times=(np.array(times),), steps=(9,))


def uniform(count: int, rng: np.random.Generator) -> np.ndarray:
    return rng.uniform(-1, 1, (count, 2))


MEAN, STD = np.array([1.0, -1.0, 0.5]), np.array([2.0, 0.5, 1.0])


def test_steps_of_an_agent_are_described_as_those_of_episodes_are() -> None:
    rng = np.random.default_rng(0)
    episodes = Episodes((rng.normal(size=(5, 3)),), (rng.uniform(-1, 1, (4, 2)),), (True,))
    obs, act = episodes.pairs()
    absorbing = np.array([False] * 4 + [True] * 2)
    there = np.full((2, 3), 7.0), np.full((2, 2), 0.5)
    obs, act = np.concatenate([obs, there[0]]), np.concatenate([act, there[1]])
    steps = Transitions.own(obs, act, obs, absorbing, absorbing)
    for actions in (True, False):
        rows = visitations(episodes, 2, MEAN, STD, actions)
        np.testing.assert_array_equal(visited(steps, MEAN, STD, actions), rows)


def test_an_end_pays_the_mean_of_uniform_actions_unless_all_demonstrations_end() -> None:
    class Quadratic:
        absorbing = 0.0

        def __call__(self, obs: Array, act: Array, next_obs: Array) -> Array:
            return np.asarray(-np.square(act).sum(1))

    lives, dies, rng = episodes([20_000]), episodes([50, 7], terminated=True), np.random.default_rng(1)
    assert default_absorbing(Quadratic(), lives, uniform, rng) == pytest.approx(-2 / 3, abs=0.02)
    shown = -np.square(dies.pairs()[1]).sum(1).mean()
    assert default_absorbing(Quadratic(), dies, uniform, rng) == pytest.approx(shown)


def test_products_of_random_waves_are_a_kernels_and_follow_the_tasks_own_features() -> None:
    rng, width = np.random.default_rng(0), 1.7
    obs, act = MEAN + STD * rng.normal(size=(200, 3)), rng.uniform(-1, 1, (200, 2))
    own = lambda obs, act: np.column_stack([obs[:, 0], act[:, 1]])  # noqa: E731
    features = FourierFeatures.drawn(own, obs, 2, 20_000, width, rng)(obs, act)
    np.testing.assert_array_equal(features[:, :2], own(obs, act))
    x = np.column_stack([(obs - obs.mean(axis=0)) / obs.std(axis=0), act])
    squares = np.square(x[:, None] - x).sum(axis=2)
    kernel = np.exp(-squares / (2 * width**2))
    np.testing.assert_allclose(features[:, 2:] @ features[:, 2:].T, kernel, atol=0.05)


def test_the_reward_is_the_torch_network_on_standardised_observations_and_bounded() -> None:
    layers = mlp(3 + 2 + 1, 16, 1, generator=torch.Generator().manual_seed(0))
    reward = NetworkReward.of(layers, MEAN, STD, bound=1.5)
    rng = np.random.default_rng(0)
    obs, act = rng.normal(size=(20, 3)), rng.uniform(-1, 1, (20, 2))
    inputs = np.concatenate([(obs - MEAN) / STD, act, np.zeros((20, 1))], axis=1)
    absorbed = np.array([[0, 0, 0, 0, 0, 1.0]])
    with torch.no_grad():
        output = layers.double()(torch.as_tensor(np.concatenate([inputs, absorbed])))[:, 0]
    expected = 1.5 * np.tanh(output.numpy())
    np.testing.assert_allclose(reward(obs, act, obs), expected[:-1], rtol=1e-6)
    assert reward.absorbing == pytest.approx(expected[-1], rel=1e-6)


def reward(seed: int) -> NetworkReward:
    layers = mlp(3 + 2 + 1, 16, 1, generator=torch.Generator().manual_seed(seed))
    return NetworkReward.of(layers, np.zeros(3), np.ones(3))


@pytest.mark.parametrize("most", [-100.0, 100.0])
def test_where_random_actions_end_more_often_an_end_pays_no_more_than_is_said(most: float) -> None:
    shown, random = episodes([2, 2]), episodes([2, 2], terminated=True)
    before = reward(0)
    after = deterred(before, shown, random, most)
    assert after.absorbing == min(before.absorbing, most)
    for seen in (shown, random):
        np.testing.assert_array_equal(paid(after, seen), paid(before, seen))
    assert deterred(before, shown, shown, -100.0) is before
