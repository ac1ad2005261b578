"""A plan is what the scheduler itself does with what jobs took, and computes nothing."""

import dataclasses
import json
from pathlib import Path

import pytest

from harness.cell.run import prepare, run_cell
from harness.engines.inline import Inline
from harness.engines.jobs import Job, Outcome
from harness.process.environment import numeric
from harness.records import Cell, Shown
from harness.registry import METHODS, RANKED, LearnerName
from harness.schedule import plan
from harness.schedule.costs import SHIPPED, Costs
from harness.schedule.grid import Grid, Schedule
from harness.schedule.interactions import interactions
from harness.store.request import Request
from tests.harness.fake_runs import CONDITIONS

VARIABLES = numeric(True)

pytestmark = pytest.mark.usefixtures("own_cache")


def measured(tmp_path: Path, **seconds: float) -> None:
    """Have jobs take these seconds, by method, 'solve_METHOD' for an RL solve."""
    names = {name: f"cartpole {name}" for name in seconds}
    names |= {name: f"cartpole {name[6:]}, a solve" for name in seconds if name.startswith("solve_")}
    told = {"smoke, sb3, experts shipped": {names[name]: value for name, value in seconds.items()}}
    (tmp_path / "cache").mkdir()
    (tmp_path / "cache/seconds.json").write_text(json.dumps(told))


def cells(method: str, seeds: int) -> list[Cell]:
    return [Cell("cartpole", method, seed) for seed in range(seeds)]


@pytest.mark.parametrize("env", ["cartpole", "highway"])
def test_seconds_of_every_method_are_shipped(env: str) -> None:
    known = json.loads(SHIPPED.read_text())["quick, sbx, experts shipped"]
    ranked = {f"cartpole {method} ranked" for method in RANKED}
    assert {f"{env} {method}" for method in METHODS} | ranked <= known.keys()


def test_the_wall_time_is_that_of_equal_cells_done_side_by_side(tmp_path: Path) -> None:
    measured(tmp_path, expert=2.0, bc=10.0)
    found = plan.plan(cells("bc", 8), CONDITIONS, VARIABLES, cores=(1, 2, 8, 1000))
    assert found.wall == {1: 96.0, 2: 48.0, 8: 12.0, 1000: 12.0}
    assert [(line.name, line.jobs, line.seconds, line.measured) for line in found.lines] == [
        ("cartpole bc", 8, 10.0, True),
        ("cartpole expert", 8, 2.0, True),
    ]
    assert found.chain == (("cartpole__expert__seed0", 2.0), ("cartpole__bc__seed0", 10.0))
    nothing = plan.plan([], CONDITIONS, VARIABLES)
    assert (plan.as_lines(nothing), {*nothing.wall.values()}) == ([], {0.0})


def test_no_number_of_cores_makes_a_chain_shorter(tmp_path: Path) -> None:
    measured(tmp_path, expert=2.0, bc=10.0, control_clone=5.0, gail=14.0)
    several = [cell for method in ("gail", "control_clone", "bc") for cell in cells(method, 3)]
    found = plan.plan(several, CONDITIONS, VARIABLES)
    chain = [f"cartpole__{name}__seed0" for name in ("expert", "bc", "control_clone")]
    assert [name for name, _ in found.chain] == chain
    assert found.wall[1000] == sum(seconds for _, seconds in found.chain) == 17.0
    assert found.wall[2] >= (3 * 31.0) / 2
    alone = plan.plan(cells("control_clone", 1), CONDITIONS, VARIABLES)  # bc is there already
    assert alone.wall[1000] == 7.0


def test_solves_multiply_what_retraining_takes_and_nothing_else(tmp_path: Path) -> None:
    measured(tmp_path, expert=2.0, gail=10.0, control_true=5.0, solve_gail=4.0, solve_control_true=4.0)
    several = cells("gail", 2) + cells("control_true", 2)
    for asked, solves in ((0, 1), (3, 3), (5, 5)):
        found = plan.plan(several, dataclasses.replace(CONDITIONS, solves=asked), VARIABLES)
        seconds = {line.name: line.seconds for line in found.lines}
        gail = 10.0 + solves * 4.0
        assert seconds == {"cartpole expert": 2.0, "cartpole gail": gail, "cartpole control_true": 9.0}
        assert (found.solves, found.retraining) == ((solves,), 2 * solves * 4.0)
        told = f"{solves} solves of a learned reward (--solves) take 0:{2 * solves * 4:02}"
        assert told in plan.as_lines(found)
    alone = plan.plan(several, dataclasses.replace(CONDITIONS, retrain=False), VARIABLES)
    assert alone.solves == ()


@pytest.mark.parametrize(
    ("env", "method", "learner"),
    [
        *(("swingup", method, "own") for method in ("bc", "sqil", "shaped", "gail")),
        *(("swingup", method, "ddpg") for method in ("shaped", "control_plus1")),
        ("cartpole", "shaped", "own"),
        ("gridworld", "maxent", "own"),
    ],
)
def test_planned_interactions_are_those_that_rows_store(env: str, method: str, learner: LearnerName) -> None:
    cell = Cell(env, method, 100)
    conditions = dataclasses.replace(CONDITIONS, learner=learner, solves=2)
    planned = interactions(cell, conditions)
    rows = run_cell(cell, conditions, prepare([cell], conditions))[0].rows
    took = {row.policy: (row.env_steps, row.check_steps) for row in rows if row.status == "ok"}
    (fit, _), (rl, checks) = (took.get(policy, (0, 0)) for policy in ("pi_star", "pi_R"))
    assert planned.rl == rl
    assert planned.open == (method == "gail")
    assert planned.fit < fit if planned.open else planned.fit == fit
    ends_early = env == "cartpole"
    assert planned.checks > checks if ends_early else planned.checks == checks


def test_interactions_are_summed_by_task_and_in_all() -> None:
    several = [*cells("sqil", 3), *cells("control_true", 2), Cell("swingup", "gail", 100)]
    found = plan.plan(several, CONDITIONS, VARIABLES)
    lines = plan.as_lines(found)
    sqil, true = interactions(several[0], CONDITIONS), interactions(several[3], CONDITIONS)
    assert found.interactions["cartpole"].fit == 3 * sqil.fit > 0
    assert found.interactions["cartpole"].rl == 2 * true.rl > 0
    assert f"interactions of cartpole: {found.interactions['cartpole']}" in lines
    (total,) = [line for line in lines if line.startswith("interactions in all: ")]
    assert f"{sum(its.rl for its in found.interactions.values()):,} of RL" in total
    assert "at least" in total
    assert "at least" not in str(found.interactions["cartpole"])


def test_it_is_planned_in_the_order_in_which_it_would_be_computed() -> None:
    request = Request(("bc", "shaped"), ("cartpole", "pendulum"), (0, 1), CONDITIONS, (Shown(1), Shown(5)))
    silent, planned, computed = plan.Silent(), list[str](), list[str]()

    def does(job: Job) -> tuple[float, Outcome]:
        planned.append(job.name)
        return 3.0, Outcome(error="" if job.shared else "not computed")

    class Noting(Inline):
        def submit(self, job: Job) -> None:
            computed.append(job.name)
            self._ended.append((job, Outcome(error="" if job.shared else "not computed")))

    grid, costs = Grid(CONDITIONS, silent, plan.Simulated(1, does, VARIABLES)), Costs(CONDITIONS)
    Schedule(grid, grid.jobs(request.cells, costs), silent, costs).run()
    Grid(CONDITIONS, silent, Noting()).run(request.cells)
    assert planned == computed
    assert len(planned) == len(request.cells) + 4
