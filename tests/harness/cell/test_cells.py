"""A whole cell, on the smallest budget: its rows, and of several solves of a reward the one that counts."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from envs import EnvSpec
from envs.learners import DDPG, SAC
from harness.cell import fitting, retraining
from harness.cell.experts import Expert, Shipped, source_for
from harness.cell.inputs import Inputs
from harness.cell.phases import Phase
from harness.cell.retraining import JUDGING_EPISODES
from harness.cell.run import prepare, run_cell
from harness.cell.shared import Shared
from harness.judge.evaluation import evaluate, totals
from harness.records import LEARNED, NOMINAL, REFERENCE, Cell, CellResult, Conditions
from harness.registry import BUDGETS, SPECS
from harness.registry.tasks import task_for
from harness.rl.seeds import evaluation_seeds, judging_seeds, rng_for
from harness.rl.solving import Solution
from harness.rl.world import solver_for
from harness.store.artifacts import learned_in
from harness.store.codec import decode, encode
from methods.base import Array, Learned, Policy, Reward
from methods.network import Network
from tests.harness.small_cells import BC, SMOKE, cache, run  # noqa: F401


def timeless(result: CellResult) -> str:
    """Without seconds, and recordings' checksums: rerun numbers its chunks as it likes."""
    rows = [dataclasses.replace(row, fit_seconds=0.0) for row in result.rows]
    named = dict.fromkeys(result.recordings, "")
    result = dataclasses.replace(result, rows=rows, recordings=named, seconds={})
    return repr(result)  # where NaN equals NaN


def test_a_method_without_reward_has_pi_star_and_a_reason(tmp_path: Path) -> None:
    result = run(BC, tmp_path)
    star, skipped = result.rows
    assert (star.policy, star.status, star.reason) == ("pi_star", "ok", "")
    assert (star.env, star.method, star.seed, star.protocol) == ("cartpole", "bc", 0, "absorbing")
    assert star.episodes == 5
    assert 1 <= star.length_mean <= 500
    assert 0 < star.discounted_mean < star.return_mean <= star.length_mean
    assert star.fit_seconds > 0
    assert (star.env_steps, star.check_steps, star.rl_solves) == (0, 0, 0)
    assert (skipped.policy, skipped.status, skipped.reason) == ("pi_R", "skipped", "learns no reward")
    assert math.isnan(skipped.return_mean)
    assert sum(result.endings["pi_star"].values()) == 5
    assert [x for x, _ in result.curves["loss"]] == list(range(1, 101))
    recorded = sorted(path.name for path in tmp_path.rglob("*.rrd"))
    assert recorded == [f"cartpole__bc__seed0__pi_star.{it}.rrd" for it in ("median", "worst")]

    again = run(BC, tmp_path / "again")
    assert timeless(again) == timeless(result)


def test_what_was_learned_is_kept_and_scores_as_it_did(tmp_path: Path) -> None:
    cell = Cell("cartpole", "shaped", 1)
    result = run(cell, tmp_path)
    learned = learned_in((tmp_path / LEARNED).read_bytes())
    assert set(learned) == {"pi_star", "pi_R", "reward"}
    for row in result.rows:
        seeds = evaluation_seeds(1, row.episodes)
        scored = evaluate(SPECS["cartpole"], learned[row.policy], seeds, learned["reward"])
        assert scored.columns() == {name: getattr(row, name) for name in scored.columns()}
        assert "own_return" in scored.columns()
        demos = source_for("cartpole", 1, SMOKE).demonstrations(cell.shown)
        shown = totals(learned["reward"], list(zip(demos.obs, demos.act, strict=True)))
        assert row.own_return_shown == pytest.approx(np.mean(shown))
    told: list[int] = []
    rng = rng_for(1, "cartpole", "shaped", "pi_R 0")
    solver = solver_for(SPECS["cartpole"], "absorbing", rng, "sb3", told=lambda done, _: told.append(done))
    again = solver.solve(learned["reward"], SPECS["cartpole"].rl_steps["smoke"])
    assert told == [x for x, _ in result.curves["pi_R"]]
    assert result.curves["pi_R_chosen"] == [max(result.curves["pi_R"], key=lambda point: point[1])]
    obs = np.random.default_rng(0).standard_normal((20, 4))
    assert np.array_equal(again.policy(obs), learned["pi_R"](obs))


def test_where_nothing_is_recorded_scores_and_what_was_learned_are_the_same(tmp_path: Path) -> None:
    conditions, told = dataclasses.replace(SMOKE, record="none"), list[Phase]()
    result, files = run_cell(BC, conditions, prepare([BC], conditions), told.append)
    assert [phase.stage for phase in told] == ["demonstrate", "fit", "score", "score", "record"]
    assert told[-1].returns == {"pi_star": result.rows[0].return_mean}
    assert files.keys() == result.files.keys() == {LEARNED}
    recorded = run(BC, tmp_path)
    rows = [[dataclasses.replace(row, fit_seconds=0.0) for row in its.rows] for its in (result, recorded)]
    assert repr(rows[0]) == repr(rows[1])  # NaN equals NaN
    assert result.recordings == {}
    kept = learned_in((tmp_path / LEARNED).read_bytes())
    obs = np.random.default_rng(0).standard_normal((20, 4))
    assert np.array_equal(learned_in(files[LEARNED])["pi_star"](obs), kept["pi_star"](obs))


def test_the_reference_scores_the_expert_and_a_random_policy(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out_of_reach = dataclasses.replace(SPECS["cartpole"], bar=lambda seeds: 501.0)
    monkeypatch.setitem(SPECS, "cartpole", out_of_reach)
    result = run(Cell("cartpole", "reference", 0), tmp_path)
    expert, random = result.rows
    assert [(row.policy, row.status) for row in result.rows] == [("expert", "ok"), ("random", "ok")]
    shipped = out_of_reach.shipped
    assert shipped is not None
    assert (expert.env_steps, expert.rl_solves) == (shipped.steps, 1)
    assert (random.env_steps, random.check_steps, random.rl_solves) == (0, 0, 0)
    assert random.length_mean < 100
    assert result.curves["expert"] == list(source_for("cartpole", 0, SMOKE).expert.curve)
    assert set(result.endings) == {"expert", "random"}
    (warning,) = result.warnings
    assert result.below_bar
    assert "misses its bar" in warning
    assert f"{expert.return_mean:.2f}" in warning


def test_an_expert_that_is_no_better_than_chance_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    always = dict.fromkeys(BUDGETS, 1.0)
    easy = dataclasses.replace(SPECS["cartpole"], bar=lambda seeds: -1.0, max_terminated=always)
    monkeypatch.setitem(SPECS, "cartpole", easy)
    pushes = Network.of(np.zeros(4), np.ones(4), [np.zeros((4, 1))], [np.ones(1)])
    monkeypatch.setattr(Shipped, "expert", Expert("pushes", pushes))
    result = run(Cell("cartpole", "reference", 0), tmp_path)
    (warning,) = result.warnings
    assert result.below_bar
    assert "seed 0: the expert is no better than a random policy" in warning


CARTPOLE, STEPS = SPECS["cartpole"], SPECS["cartpole"].rl_steps["smoke"]
CELL = Cell("cartpole", "shaped", 1)
FORCES = (0.1, 0.9, 0.9, -0.5)
"""Pushes of the policies that solves find, in order."""
FEW = 7
"""Check steps of each."""


@dataclass(frozen=True)
class Push:
    """A policy."""

    force: float

    def __call__(self, obs: Array, /) -> Array:
        return np.full((len(obs), 1), self.force)


@dataclass(frozen=True)
class PaysForce:
    """A reward for pushes to the right, under which constant policies differ."""

    absorbing: float = 0.0

    def __call__(self, obs: Array, act: Array, next_obs: Array, /) -> Array:
        return np.asarray(act[:, 0])


class Fits:
    """A method that learns that reward, or none, and a policy that pushes by half."""

    reward: Reward | None = PaysForce()

    def fit(self, *given: object) -> Learned:
        return Learned(Push(0.5), self.reward)


@pytest.fixture
def solved(monkeypatch: pytest.MonkeyPatch) -> list[tuple[EnvSpec, Any]]:
    """The task and the first random number of each solve, none of which learns."""
    found: list[tuple[EnvSpec, Any]] = []

    class Solver:
        def __init__(self, spec: EnvSpec, protocol: str, rng: np.random.Generator, *more: object, told: Any):
            self.force, self.told = FORCES[len(found) % len(FORCES)], told
            found.append((spec, rng.bit_generator.state))

        def solve(self, reward: Reward | None, steps: int) -> Solution:
            self.told(steps, {})
            curve = [(0.0, 0.0), (float(steps), self.force)]
            return Solution(Push(self.force), curve, curve, steps, FEW, best=1)

    monkeypatch.setattr(retraining, "solver_for", Solver)
    monkeypatch.setattr(fitting, "method_for", lambda *names: Fits())
    return found


def many(solves: int) -> Conditions:
    return dataclasses.replace(SMOKE, solves=solves)


def earned(policy: Policy, seeds: range) -> tuple[float, float]:
    """Return what a policy earns under the reward, and under the true one."""
    its = evaluate(CARTPOLE, policy, seeds, PaysForce())
    return its.own_return, float(its.returns.mean())


def test_the_solve_that_earns_most_on_judging_episodes_counts(
    tmp_path: Path, solved: list[tuple[EnvSpec, Any]], monkeypatch: pytest.MonkeyPatch
) -> None:
    result = run(CELL, tmp_path, many(4))
    star, trained = result.rows
    judging, evaluation = judging_seeds(1, JUDGING_EPISODES), evaluation_seeds(1, 5)
    for force, solve in zip(FORCES, result.solves, strict=True):
        assert solve.judged == earned(Push(force), judging)[0]
        assert (solve.own_return, solve.return_mean) == earned(Push(force), evaluation)
    most = result.solves[1]
    assert most == result.solves[2]
    assert most.judged == max(solve.judged for solve in result.solves)
    assert (trained.own_return, trained.return_mean) == (most.own_return, most.return_mean)
    assert result.curves["pi_R_chosen"] == [(float(STEPS), 0.9)]
    assert (trained.solves, trained.rl_solves, trained.env_steps) == (4, 4, 4 * STEPS)
    judged_by = sum(evaluate(CARTPOLE, Push(force), judging).lengths.sum() for force in FORCES)
    assert trained.check_steps == 4 * FEW + judged_by
    assert star.own_return == earned(Push(0.5), evaluation)[0]
    rng = rng_for(1, "cartpole", REFERENCE, "random policy")
    by_chance, _ = earned(lambda obs: CARTPOLE.random_actions(len(obs), rng), evaluation)
    assert star.own_return_random == trained.own_return_random == by_chance
    assert [solve.solved for solve in result.solves] == [0, 1, 1, 0]
    assert (trained.solved, star.solves) == (1, 0)
    assert math.isnan(star.solved)
    assert decode(encode(result)).solves == result.solves
    # What earns no number is never chosen.
    monkeypatch.setattr(retraining, "judge", lambda *asked: ([math.nan, -3.0, -3.0, -2.0], 0))
    result = run(CELL, tmp_path, many(4))
    assert result.curves["pi_R_chosen"] == [(float(STEPS), -0.5)]


def test_a_solve_is_the_same_whatever_others_there_are(
    tmp_path: Path, solved: list[tuple[EnvSpec, Any]]
) -> None:
    states = []
    for count in (1, 2, 3):
        solved.clear()
        run(CELL, tmp_path, many(count))
        assert len(solved) == count
        states.append([str(state) for _, state in solved])
    assert states[0] == states[1][:1] == states[2][:1]
    assert states[1] == states[2][:2]
    assert len(set(states[2])) == 3


@pytest.mark.parametrize(
    ("method", "dynamics"), [("control_plus1", NOMINAL), ("control_true", NOMINAL), ("shaped", "flipped")]
)
def test_controls_and_variants_take_one_solve(
    tmp_path: Path, solved: list[tuple[EnvSpec, Any]], method: str, dynamics: str
) -> None:
    result = run(Cell("cartpole", method, 1, dynamics=dynamics), tmp_path, many(3))
    assert len(solved) == len(result.solves) == 1
    assert math.isnan(result.rows[-1].solved) == (dynamics == NOMINAL)  # controls have no pi_star
    assert math.isnan(result.rows[-1].own_return_random) == (dynamics == NOMINAL)


@pytest.mark.parametrize("dynamics", [NOMINAL, "flipped"])
def test_all_rl_of_a_run_is_by_its_learner(monkeypatch: pytest.MonkeyPatch, dynamics: str) -> None:
    spec = dataclasses.replace(CARTPOLE, rl=SAC(), ddpg=DDPG(batch=64), ddpg_steps=dict.fromkeys(BUDGETS, 70))
    monkeypatch.setitem(SPECS, "cartpole", spec)
    cell = dataclasses.replace(CELL, dynamics=dynamics)
    for learner, rl, steps in (("own", SAC(), STEPS), ("ddpg", DDPG(batch=64), 70)):
        conditions = dataclasses.replace(SMOKE, learner=learner, experts="trained")
        task = Inputs(cell, conditions, Shared({}))
        assert (task.spec.rl, task.place.rl, task.rl_steps) == (rl, rl, steps)
        assert (task.place is task.spec) == (dynamics == NOMINAL)
        assert task_for("cartpole", conditions).rl == rl
