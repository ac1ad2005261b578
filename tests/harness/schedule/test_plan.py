"""A plan is what the scheduler itself does with what jobs took, and computes nothing."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import pytest

from harness.engines.inline import Inline
from harness.engines.jobs import Job, Outcome
from harness.process.environment import CACHE_VARIABLE, numeric
from harness.records import Cell, Conditions, Shown
from harness.registry import METHODS, SPECS
from harness.schedule import costs, plan
from harness.schedule.costs import Costs
from harness.schedule.grid import Grid, Schedule
from harness.store.request import Request

CONDITIONS = Conditions("smoke", "absorbing", "sb3")
VARIABLES = numeric(True)


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv(CACHE_VARIABLE, str(tmp_path / "cache"))
    return tmp_path / "cache"


def measured(cache: Path, **seconds: float) -> None:
    cache.mkdir(exist_ok=True)
    told = {name.replace("__", " "): value for name, value in seconds.items()}
    (cache / "seconds.json").write_text(json.dumps({"smoke, sb3, experts shipped": told}))


def cells(method: str, seeds: int) -> list[Cell]:
    return [Cell("cartpole", method, seed) for seed in range(seeds)]


def test_the_wall_time_is_that_of_equal_cells_done_side_by_side(cache: Path) -> None:
    measured(cache, cartpole__expert=2.0, cartpole__bc=10.0)
    found = plan.plan(cells("bc", 8), CONDITIONS, VARIABLES, cores=(1, 2, 8, 1000))
    assert found.wall == {1: 96.0, 2: 48.0, 8: 12.0, 1000: 12.0}
    assert [(line.name, line.jobs, line.seconds, line.measured) for line in found.lines] == [
        ("cartpole bc", 8, 10.0, True),
        ("cartpole expert", 8, 2.0, True),
    ]
    assert found.chain == (("cartpole__expert__seed0", 2.0), ("cartpole__bc__seed0", 10.0))


def test_no_number_of_cores_makes_a_chain_shorter(cache: Path) -> None:
    measured(cache, cartpole__expert=2.0, cartpole__bc=10.0, cartpole__control_clone=5.0, cartpole__gail=14.0)
    several = [cell for method in ("gail", "control_clone", "bc") for cell in cells(method, 3)]
    found = plan.plan(several, CONDITIONS, VARIABLES)
    assert [name for name, _ in found.chain] == [
        *("cartpole__expert__seed0", "cartpole__bc__seed0", "cartpole__control_clone__seed0")
    ]
    assert found.wall[1000] == sum(seconds for _, seconds in found.chain) == 17.0
    assert found.wall[2] >= (3 * 31.0) / 2
    alone = plan.plan(cells("control_clone", 1), CONDITIONS, VARIABLES)  # bc is there already
    assert alone.wall[1000] == 7.0


def test_what_was_not_measured_is_a_guess_and_said_to_be(cache: Path) -> None:
    measured(cache, cartpole__bc=10.0, cartpole__gail=30.0)
    found = plan.plan([Cell("cartpole", m, 0) for m in ("bc", "shaped")], CONDITIONS, VARIABLES)
    known = {line.name: (line.measured, line.seconds) for line in found.lines}
    assert known["cartpole bc"] == (True, 10.0)
    assert known["cartpole shaped"] == (False, 30.0)
    assert not known["cartpole expert"][0]
    lines = plan.as_lines(found)
    assert [line.split()[1] for line in lines if line.endswith("a guess")] == ["expert", "shaped"]
    assert any("guessed" in line for line in lines)


def test_solves_multiply_what_retraining_takes_and_nothing_else(cache: Path) -> None:
    measured(cache, cartpole__expert=2.0, cartpole__gail=10.0, cartpole__control_true=5.0)
    stored = json.loads((cache / "seconds.json").read_text())
    stored["smoke, sb3, experts shipped"] |= {f"cartpole {m}, a solve": 4.0 for m in ("gail", "control_true")}
    (cache / "seconds.json").write_text(json.dumps(stored))
    several = cells("gail", 2) + cells("control_true", 2)
    for asked, solves in ((0, 1), (3, 3), (5, 5)):
        conditions = dataclasses.replace(CONDITIONS, solves=asked)
        found = plan.plan(several, conditions, VARIABLES)
        seconds = {line.name: line.seconds for line in found.lines}
        gail = 10.0 + solves * 4.0
        assert seconds == {"cartpole expert": 2.0, "cartpole gail": gail, "cartpole control_true": 9.0}
        assert (found.solves, found.retraining) == ((solves,), 2 * solves * 4.0)
        told = f"{solves} solves of a learned reward (--solves) take 0:{2 * solves * 4:02}"
        assert told in plan.as_lines(found)
    alone = plan.plan(several, dataclasses.replace(CONDITIONS, retrain=False), VARIABLES)
    assert alone.solves == ()
    assert not any("solves of" in line for line in plan.as_lines(alone))


def test_what_a_solve_took_is_known_for_any_number_of_them() -> None:
    job = Job(tuple(cells("gail", 1)), False, CONDITIONS, "")
    three, five = (Costs(dataclasses.replace(CONDITIONS, solves=solves)) for solves in (3, 5))
    one_more = (five.of(job) - three.of(job)) / 2
    assert one_more == pytest.approx(SPECS["cartpole"].rl_steps["smoke"] / costs.PPO_RATE)
    three.note(job, 30.0, 12.0)
    three.keep()
    known = Costs(dataclasses.replace(CONDITIONS, solves=5))
    assert (known.of(job), known.retraining(job)) == (18.0 + 5 * 4.0, 5 * 4.0)
    other = Job((Cell("cartpole", "airl", 0),), False, CONDITIONS, "")
    assert (known.of(other), known.known(other)) == (known.of(job), False)
    by_ddpg = Costs(dataclasses.replace(CONDITIONS, learner="ddpg"))
    assert not by_ddpg.known(job)


def test_what_nobody_measured_here_is_what_another_machine_took() -> None:
    quick = Conditions("quick", "absorbing", "sbx")
    shipped = json.loads(costs.SHIPPED.read_text())["quick, sbx, experts shipped"]
    for env in ("cartpole", "highway"):
        for method in METHODS:
            job = Job((Cell(env, method, 0),), False, quick, "")
            its, solve = (shipped.get(f"{env} {method}{end}", 0.0) for end in ("", costs.SOLVE))
            assert its > 0
            assert Costs(quick).of(job) == its + SPECS[env].solves["quick"] * solve
            assert not Costs(quick).known(job)
    quick_costs = Costs(quick)
    quick_costs.note(job, 7.0)
    quick_costs.keep()
    assert Costs(quick).of(job) == 7.0


def test_a_plan_of_nothing_says_nothing() -> None:
    found = plan.plan([], CONDITIONS, VARIABLES)
    assert plan.as_lines(found) == []
    assert set(found.wall.values()) == {0.0}


class Noting(Inline):
    """Notes what it is given, and fails it."""

    def __init__(self) -> None:
        super().__init__()
        self.given: list[str] = []

    def submit(self, job: Job) -> None:
        self.given.append(job.name)
        self._ended.append((job, outcome_of(job)))


def outcome_of(job: Job) -> Outcome:
    return Outcome(error="" if job.shared else "not computed")


def test_it_is_planned_in_the_order_in_which_it_would_be_computed() -> None:
    request = Request(("bc", "shaped"), ("cartpole", "pendulum"), (0, 1), CONDITIONS, (Shown(1), Shown(5)))
    silent, engine, given = plan.Silent(), Noting(), []

    def does(job: Job) -> tuple[float, Outcome]:
        given.append(job.name)
        return 3.0, outcome_of(job)

    grid, costs = Grid(CONDITIONS, silent, plan.Simulated(1, does, VARIABLES)), Costs(CONDITIONS)
    Schedule(grid, grid.jobs(request.cells, costs), silent, costs).run()
    Grid(CONDITIONS, silent, engine).run(request.cells)
    assert given == engine.given
    assert len(given) == len(request.cells) + 4
