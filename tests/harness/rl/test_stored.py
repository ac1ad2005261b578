"""What was learned can be kept and gives the same outputs afterwards; what is no such thing is refused."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from envs import EnvSpec
from harness.judge.controls import Distance
from harness.records import Cell, Conditions
from harness.registry import SPECS
from harness.rl.exact import ExactSolver
from harness.rl.stored import from_arrays
from harness.rl.world import Features
from harness.store import artifacts
from harness.store.artifacts import artifact, learned_in
from harness.store.cache import Kept, as_bytes
from methods.fourier import FourierFeatures
from methods.network import Network
from methods.rewards import Constant, LinearReward, MeanReward, NetworkReward, StateReward
from methods.shaped import ShapedReward

CELL, CONDITIONS = Cell("cartpole", "shaped", 0), Conditions("smoke", "absorbing", "sbx")
RNG = np.random.default_rng(0)


def network(inputs: int, outputs: int, half: bool = True) -> Network:
    sizes = [(inputs, 7), (7, outputs)]
    weights = [RNG.standard_normal(size) for size in sizes]
    if half:  # as those that were fitted in 32 bits
        weights = [w.astype(np.float32).astype(np.float64) for w in weights]
    return Network(np.zeros(inputs), np.ones(inputs), tuple(weights), (np.zeros(7), np.zeros(outputs)), True)


def features(waves: int = 0) -> Any:
    phi: Any = Features(SPECS["cartpole"])
    return FourierFeatures.drawn(phi, RNG.standard_normal((9, 4)), 1, waves, 1.0, RNG) if waves else phi


def linear(phi: Any) -> LinearReward:
    size = phi(np.zeros((1, 4)), np.zeros((1, 1))).shape[1]
    return LinearReward(phi, RNG.standard_normal(size + 1))


REWARDS = {
    "shaped": ShapedReward(network(4, 1), network(4, 1), absorbing=-0.1),
    "linear": linear(features()),
    "waves": linear(features(waves=8)),
    "network": NetworkReward(network(6, 1, half=False), 2.0, -1.5),
    "of states": NetworkReward(network(5, 1), 1.0, 0.25, actions=False),
    "mean": MeanReward((NetworkReward(network(6, 1), 2.0, -1.5), StateReward(network(4, 1), 0.3))),
    "constant": Constant(1.0, absorbing=-0.0),
    "distance": Distance(network(4, 1), absorbing=1e-300),
}


def kept(**learned: Any) -> dict[str, Any]:
    data, troubles = artifact(CELL, CONDITIONS, learned)
    assert troubles == []
    return learned_in(data, CELL)


@pytest.mark.parametrize("name", REWARDS)
def test_a_reward_that_was_kept_pays_the_same_bit_for_bit(name: str) -> None:
    reward, rng = REWARDS[name], np.random.default_rng(1)
    batch = rng.standard_normal((50, 4)), rng.uniform(-1, 1, (50, 1)), rng.standard_normal((50, 4))
    found = kept(reward=reward)["reward"]
    assert type(found) is type(reward)
    assert np.array_equal(found(*batch), reward(*batch))
    assert np.array([found.absorbing]).tobytes() == np.array([reward.absorbing]).tobytes()


def test_a_policy_that_was_kept_acts_the_same_bit_for_bit() -> None:
    tabular: Any = SPECS["gridworld"].tabular
    exact = ExactSolver(tabular, 0.9, np.random.default_rng(0)).solve(None, 0).policy
    found = kept(pi_star=network(4, 1), pi_R=exact)
    assert np.array_equal(found["pi_R"](tabular.obs), exact(tabular.obs))
    for policy in (network(4, 2), network(3, 2, half=False)):
        obs = np.random.default_rng(2).standard_normal((20, len(policy.mean)))
        once = kept(pi_star=policy)["pi_star"]
        for its in (once, kept(pi_star=once)["pi_star"]):
            assert np.array_equal(its(obs), policy(obs))


def test_what_cannot_be_kept_is_told_and_the_rest_is_kept(steady: EnvSpec) -> None:
    for thing, reason in (
        (lambda obs: obs, "builtins.function is no dataclass"),
        (Constant(1.0, np.array(["x"])), "an array of <U1 cannot be stored"),  # type: ignore[arg-type]
        (linear(Features(steady)), "no registered environment"),
    ):
        data, (trouble,) = artifact(CELL, CONDITIONS, {"pi_star": network(4, 1), "reward": thing})
        assert reason in trouble
        assert CELL.name in trouble
        assert set(learned_in(data)) == {"pi_star"}
        assert artifact(CELL, CONDITIONS, {"reward": thing})[0] == b""


@pytest.mark.parametrize(
    "described",
    [
        {"class": "os:system", "fields": {"command": "true"}},
        {"class": "harness.cell.run:run_cell", "fields": {}},
        {"class": "methods.rewards:Constant", "fields": {"value": 1.0}},
        {"env": "nowhere"},
    ],
)
def test_what_was_not_written_by_it_is_refused_and_runs_nothing(described: Any) -> None:
    with pytest.raises(ValueError, match="stored here"):
        from_arrays({}, described)
    with pytest.raises(ValueError, match=r"."):
        learned_in(as_bytes(Kept({}, {"format": artifacts.FORMAT, "learned": {"reward": described}})))
