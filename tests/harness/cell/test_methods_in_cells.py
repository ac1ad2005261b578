"""What a method does in its cell: what it is given, what it may ask for and return, and say."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from envs import EnvSpec
from harness.cell import fitting, retraining
from harness.cell.experts import source_for
from harness.records import Cell, Conditions, Library, Shown
from harness.registry import SPECS, load_method
from harness.registry.bounds import LONGEST_TEXT, MOST_CURVES, MOST_POINTS
from harness.rl import world
from harness.rl.seeds import demonstration_seeds, evaluation_seeds
from harness.rl.world import solver_for
from harness.store.codec import decode, encode
from methods.base import Array, Episodes, Learned, Policy, Reward, Unsuitable, World
from tests.harness.small_cells import BC, SMOKE, cache, run  # noqa: F401


def test_who_is_marked_so_may_ask_the_expert_and_nobody_else(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asks = dataclasses.replace(BC, method="dagger")
    result = run(asks, tmp_path)
    assert result.details == {"answers of the expert": result.rows[0].env_steps}
    assert result.rows[0].env_steps > 0
    asking = load_method("dagger")
    monkeypatch.setattr(fitting, "load_method", lambda name: asking)
    with pytest.raises(ValueError, match="only methods that are marked"):
        run(BC, tmp_path)


@pytest.mark.parametrize("dynamics", ["nominal", "long"])
def test_what_a_method_is_not_made_for_is_skipped_and_says_why(tmp_path: Path, dynamics: str) -> None:
    cell = Cell("swingup", "sqil", 0, Shown(1, every=20), dynamics)
    result = run(cell, tmp_path)
    assert [(row.policy, row.status) for row in result.rows] == [("pi_star", "skipped"), ("pi_R", "skipped")]
    assert {row.reason for row in result.rows} == {
        "SQIL learns from demonstrations of which every step is shown"
    }
    assert all(row.pairs == 0 for row in result.rows)
    assert "fit" in result.seconds
    assert result.files == {}


@pytest.mark.parametrize(
    ("said", "kept"),
    [("two\nlines \x1b[31m", "two lines \\x1b[31m"), ("long " * 1000, None)],
    ids=["lines", "long"],
)
def test_whatever_it_says_its_cell_can_be_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, said: str, kept: str | None
) -> None:
    @dataclasses.dataclass
    class Refuses:
        steps: int = 0
        iterations: int = 0

        def fit(self, demos: Episodes, world: World, rng: np.random.Generator) -> Learned:
            raise Unsuitable(said)

    monkeypatch.setattr(fitting, "load_method", lambda name: Refuses)
    result = decode(encode(run(BC, tmp_path)))
    assert {row.status for row in result.rows} == {"skipped"}
    assert {row.reason for row in result.rows} == {kept or said[:LONGEST_TEXT]}


@dataclasses.dataclass
class Method:
    """Finds one policy and one reward, whatever it is given."""

    policy: Policy
    reward: Reward

    def fit(self, demos: Episodes, world: World, rng: np.random.Generator) -> Learned:
        return Learned(self.policy, self.reward, {})


@dataclasses.dataclass
class Pays:
    """A reward by what it pays for a batch."""

    pay: Callable[[Array], Array]
    absorbing: float = 0.0

    def __call__(self, obs: Array, act: Array, next_obs: Array, /) -> Array:
        return self.pay(obs)


def still(obs: Array) -> Array:
    return np.zeros((len(obs), 1))


def ones(obs: Array) -> Array:
    return np.ones(len(obs))


def test_what_breaks_the_contract_fails(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    wrong = Method(still, Pays(ones, absorbing=math.inf))
    monkeypatch.setattr(fitting, "load_method", lambda name: lambda **settings: wrong)
    with pytest.raises(ValueError, match="one finite number"):
        run(Cell("cartpole", "shaped", 1), tmp_path)


def test_long_curves_are_thinned_and_of_many_the_first_are_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Talkative(Method):
        def fit(self, demos: Episodes, world: World, rng: np.random.Generator) -> Learned:
            many = {f"curve {i}": [float(i)] for i in range(100)}
            return Learned(
                self.policy, None, {"long": [float(x) for x in range(123_456)], "none": [], **many}
            )

    monkeypatch.setattr(fitting, "load_method", lambda name: lambda **settings: Talkative(still, Pays(ones)))
    result = decode(encode(run(BC, tmp_path)))
    long = result.curves["long"]
    assert len(result.curves) < len(long) <= MOST_POINTS
    assert (long[0], long[-1]) == ((1.0, 0.0), (123_456.0, 123_455.0))
    assert all(x == y + 1 for x, y in long)
    assert result.curves["none"] == []
    assert result.warnings == [
        f"{BC.name}: of 102 curves the first {MOST_CURVES - 3} are kept",
        f"{BC.name}: pi_star is not kept (docs/plugins.md): builtins.function is no dataclass of envs, "
        "methods, harness.rl, harness.judge, harness.cell",
    ]


class Spy(Method):
    """Keeps what it is given, and solves once."""

    def fit(self, demos: Episodes, world: World, rng: np.random.Generator) -> Learned:
        self.demos = demos
        world.solve(self.reward, rng, 100)
        return super().fit(demos, world, rng)


def test_demonstrations_are_the_experts_and_of_no_evaluation_episode(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    spy = Spy(still, Pays(ones))
    monkeypatch.setattr(fitting, "load_method", lambda name: lambda **settings: spy)
    run(Cell("cartpole", "shaped", 3), tmp_path)
    env, count = SPECS["cartpole"].make(), len(spy.demos.act)
    assert count == SPECS["cartpole"].demo_episodes["smoke"]

    def starts(seeds: range) -> list[list[float]]:
        return [env.reset(seed=seed)[0].tolist() for seed in seeds]

    shown = [obs[0].tolist() for obs in spy.demos.obs]
    assert shown == starts(demonstration_seeds(3, count))
    assert not any(start in shown for start in starts(evaluation_seeds(3, 1000)))
    obs, act = spy.demos.pairs()
    np.testing.assert_allclose(source_for("cartpole", 3, SMOKE).expert.policy(obs), act)


@pytest.mark.parametrize("protocol", ["absorbing", "native"])
def test_every_solve_of_a_cell_is_under_its_protocol(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, protocol: str
) -> None:
    assert source_for("cartpole", 1, SMOKE).expert  # whatever it takes
    asked: list[tuple[str, str]] = []

    def solver(
        spec: EnvSpec, protocol: str, rng: np.random.Generator, library: Library, **more: Any
    ) -> object:
        asked.append((protocol, library))
        return solver_for(spec, protocol, rng, library, **more)

    for module in (retraining, world):
        monkeypatch.setattr(module, "solver_for", solver)
    monkeypatch.setattr(fitting, "load_method", lambda name: lambda **settings: Spy(still, Pays(ones)))
    result = run(Cell("cartpole", "shaped", 1), tmp_path, Conditions("smoke", protocol, "sb3"))
    assert asked == [(protocol, "sb3")] * 2  # the method's, and pi_R's
    assert {row.protocol for row in result.rows} == {protocol}
