"""What a method does in its cell, what policies do to arrays, and which episodes are recorded."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from rerun.chunk import RrdReader

from envs import EnvSpec
from harness.cell import fitting, retraining
from harness.cell.experts import source_for
from harness.cell.recording import chosen
from harness.records import Cell, Conditions, Library, Shown
from harness.registry import SPECS
from harness.registry.bounds import LONGEST_TEXT, MOST_CURVES, MOST_DETAILS, MOST_POINTS
from harness.registry.plugins import method_for
from harness.rl import world
from harness.rl.seeds import demonstration_seeds, evaluation_seeds
from harness.rl.simulator import Simulator
from harness.rl.world import solver_for
from harness.store.codec import decode, encode
from harness.store.names import files_of, recording_of
from methods.base import Array, Episodes, Learned, Unsuitable, World
from tests.harness.small_cells import BC, SMOKE, cache, run  # noqa: F401

SPEC = SPECS["cartpole"]
Fits = list[Callable[..., Learned]]


@pytest.fixture
def fits(monkeypatch: pytest.MonkeyPatch) -> Fits:
    """What the method of a cell does, the last of these."""
    given: Fits = []

    def fit(*arguments: Any) -> Learned:
        return given[-1](*arguments)

    monkeypatch.setattr(fitting, "method_for", lambda *names: SimpleNamespace(fit=fit))
    return given


def test_who_is_marked_so_may_ask_the_expert_and_nobody_else(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asks = dataclasses.replace(BC, method="dagger")
    result = run(asks, tmp_path)
    assert result.details == {"answers of the expert": result.rows[0].env_steps}
    assert result.rows[0].env_steps > 0
    monkeypatch.setattr(fitting, "method_for", lambda name, *where: method_for("dagger", *where))
    with pytest.raises(ValueError, match="only methods that are marked"):
        run(BC, tmp_path)


def test_what_a_method_is_not_made_for_is_skipped_and_says_why(tmp_path: Path) -> None:
    cell = Cell("swingup", "sqil", 0, Shown(1, every=20), "long")
    result = run(cell, tmp_path)
    assert [(row.policy, row.status) for row in result.rows] == [("pi_star", "skipped"), ("pi_R", "skipped")]
    why = "SQIL learns from demonstrations of which every step is shown"
    assert {(row.reason, row.pairs) for row in result.rows} == {(why, 0)}
    assert result.files == {}


def refuses(why: str) -> Learned:
    raise Unsuitable(why)


def test_whatever_a_method_says_its_cell_can_be_kept(tmp_path: Path, fits: Fits) -> None:
    for said, kept in (
        ("two\nlines \x1b[31m", "two lines \\x1b[31m"),
        (text := "long " * 1000, text[:LONGEST_TEXT]),
    ):
        fits.append(lambda *given, said=said: refuses(said))
        result = decode(encode(run(BC, tmp_path)))
        assert {(row.status, row.reason) for row in result.rows} == {("skipped", kept)}
    long = [float(x) for x in range(123_456)]
    curves = {"long": long, "none": [], **{f"curve {i}": [float(i)] for i in range(100)}}
    details = {f"detail {i}": np.float32(i) for i in range(40)}
    fits.append(lambda *given: Learned(still, None, curves, details))
    result = decode(encode(run(BC, tmp_path)))
    assert result.details == {f"detail {i}": float(i) for i in range(MOST_DETAILS - 1)}
    thinned = result.curves["long"]
    assert len(result.curves) < len(thinned) <= MOST_POINTS
    assert (thinned[0], thinned[-1]) == ((1.0, 0.0), (123_456.0, 123_455.0))
    assert all(x == y + 1 for x, y in thinned)
    assert result.curves["none"] == []
    assert result.warnings == [
        f"{BC.name}: of 102 curves the first {MOST_CURVES - 3} are kept",
        f"{BC.name}: pi_star is not kept (docs/plugins.md): builtins.function is no dataclass of envs, "
        "methods, harness.rl, harness.judge, harness.cell",
    ]


def still(obs: Array) -> Array:
    return np.zeros((len(obs), 1))


@dataclasses.dataclass
class Ones:
    absorbing: float = 0.0

    def __call__(self, obs: Array, act: Array, next_obs: Array, /) -> Array:
        return np.ones(len(obs))


@pytest.mark.parametrize("protocol", ["absorbing", "native"])
def test_a_method_is_given_the_experts_demonstrations_and_all_solves_are_under_the_protocol(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, fits: Fits, protocol: str
) -> None:
    expert = source_for("cartpole", 3, SMOKE).expert
    asked: list[tuple[str, str]] = []
    given: list[Episodes] = []

    def solver(spec: EnvSpec, protocol: str, rng: object, library: Library, **more: Any) -> object:
        asked.append((protocol, library))
        return solver_for(spec, protocol, rng, library, **more)  # type: ignore[arg-type]

    def fit(demos: Episodes, world: World, rng: np.random.Generator) -> Learned:
        given.append(demos)
        world.solve(Ones(), rng, 100)
        return Learned(still, Ones())

    for module in (retraining, world):
        monkeypatch.setattr(module, "solver_for", solver)
    fits.append(fit)
    result = run(Cell("cartpole", "shaped", 3), tmp_path, Conditions("smoke", protocol, "sb3"))
    assert asked == [(protocol, "sb3")] * 2  # the method's, and pi_R's
    assert {row.protocol for row in result.rows} == {protocol}
    (demos,), env = given, SPEC.make()
    count = len(demos.act)
    assert count == SPEC.demo_episodes["smoke"]

    def starts(seeds: range) -> list[list[float]]:
        return [env.reset(seed=seed)[0].tolist() for seed in seeds]

    shown = [obs[0].tolist() for obs in demos.obs]
    assert shown == starts(demonstration_seeds(3, count))
    assert not any(start in shown for start in starts(evaluation_seeds(3, 1000)))
    obs, act = demos.pairs()
    np.testing.assert_allclose(expert.policy(obs), act)


def facts_in(file: Path) -> dict[str, str]:
    """Return the recording's table."""
    for chunk in RrdReader(file).stream():
        if chunk.entity_path == "/episode":
            text = chunk.to_record_batch().column("TextDocument:text").to_pylist()[0][0]
            return dict(line.strip("| ").split(" | ") for line in text.splitlines()[2:])
    raise AssertionError


class Reusing:
    """A policy that hands out its own buffer, and writes into its observations."""

    def __init__(self) -> None:
        self.rng, self.buffers = np.random.default_rng(0), dict[int, Array]()

    def __call__(self, obs: Array) -> Array:
        buffer = self.buffers.setdefault(len(obs), np.empty((len(obs), SPEC.act_size)))
        buffer[:] = SPEC.random_actions(len(obs), self.rng)
        obs[:] = 0
        return buffer[:]


def test_what_a_policy_does_to_its_arrays_changes_no_episode() -> None:
    episodes = Simulator(SPEC, 3).run(Reusing(), range(8))
    assert len(np.unique(episodes[0].act)) == len(episodes[0].act) > 5
    again = iter([one.act for one in episodes])
    for seed, episode in enumerate(episodes):
        (same,) = Simulator(SPEC, 1).run(lambda obs: np.zeros((len(obs), 1)), [seed], [next(again)])
        for name in ("obs", "act", "rewards"):
            assert np.array_equal(getattr(same, name), getattr(episode, name)), name


def test_the_median_is_the_lower_of_two_and_the_worst_the_first_of_equals() -> None:
    returns, both = np.array([5.0, 1.0, 9.0, 2.0]), {"median": 3, "worst": 1}
    assert chosen("both", returns) == both
    assert chosen("all", returns) == {**both, "episode_0": 0, "episode_2": 2}
    assert chosen("both", np.full(4, 7.0)) == {"median": 1, "worst": 0}


@pytest.mark.filterwarnings("ignore:RRD file has no footer")
def test_recordings_are_of_the_episodes_that_were_scored_and_may_be_of_all(tmp_path: Path) -> None:
    conditions = dataclasses.replace(SMOKE, record="all", retrain=False)
    result = run(Cell("cartpole", "reference", 0), tmp_path, conditions)
    assert result.files.keys() <= files_of(result.cell)
    for row in result.rows:
        own = [name for name in result.recordings if f"__{row.policy}." in name]
        assert len(own) == row.episodes == 5
        median, worst = (
            facts_in(tmp_path / "recordings" / recording_of(result.cell, row.policy, which))
            for which in ("median", "worst")
        )
        assert float(worst["return"]) <= float(median["return"])
        assert float(median["mean return of all"]) == pytest.approx(row.return_mean, abs=1e-5)
        assert worst["returns of all"].startswith(f"{float(worst['return']):.6g} to ")
        endings = ", ".join(f"{count} {why}" for why, count in result.endings[row.policy].items())
        assert median["endings of all"] == endings
