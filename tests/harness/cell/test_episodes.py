from __future__ import annotations

import dataclasses
import math
import os
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from rerun.chunk import RrdReader

from harness.cell import fitting
from harness.cell.inputs import Inputs
from harness.cell.recording import LEAST_WEIGHT, advantages, chosen
from harness.cell.run import prepare, run_cell
from harness.cell.shared import Shared
from harness.judge.evaluation import evaluate
from harness.recordings.ghosts import write_compared
from harness.records import Cell, CellResult, Conditions
from harness.registry import SPECS, Record
from harness.rl.seeds import evaluation_seeds
from harness.rl.simulator import Simulator, Trajectory
from harness.store.names import compared_in, files_of, recording_of
from harness.store.opening import open_for_run
from harness.store.request import Request
from methods.base import Array, Episodes, Learned
from methods.rewards import Constant

pytestmark = pytest.mark.filterwarnings("ignore:RRD file has no footer")
SMOKE = Conditions("smoke", "absorbing", "sbx", retrain=False)
SPEC = SPECS["cartpole"]


@cache
def shared() -> dict[str, bytes]:
    return prepare([Cell("cartpole", "bc", 0)], SMOKE)


def ran(method: str, directory: Path, record: Record = "both") -> CellResult:
    conditions = dataclasses.replace(SMOKE, record=record)
    result, files = run_cell(Cell("cartpole", method, 0), conditions, shared())
    for name, data in files.items():
        (directory / name).parent.mkdir(parents=True, exist_ok=True)
        (directory / name).write_bytes(data)
    return result


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


def test_first_actions_leave_a_policys_array_as_it_is() -> None:
    constant = np.broadcast_to(np.full(SPEC.act_size, 0.1), (3, SPEC.act_size))
    first = [np.full((2, SPEC.act_size), -1.0)] * 3
    episodes = Simulator(SPEC).run(lambda obs: constant[: len(obs)], range(3), first)
    assert all((one.act[:2] == -1).all() and (one.act[2:] == 0.1).all() for one in episodes)


def test_what_a_method_does_to_its_demonstrations_stays_with_it(monkeypatch: pytest.MonkeyPatch) -> None:
    class Spoiling:
        def fit(self, demos: Episodes, world: object, rng: object) -> Learned:
            for array in (*demos.obs, *demos.act):
                assert not array.flags.writeable
                array.flags.writeable = True
                array[:] = 0
            return Learned(lambda obs: np.zeros((len(obs), SPEC.act_size)), None)

    task = Inputs(Cell("cartpole", "bc", 0), SMOKE, Shared(shared()))
    demos = fitting.demonstrations(task)
    before = [array.copy() for array in (*demos.obs, *demos.act)]
    monkeypatch.setattr(fitting, "load_method", lambda name: lambda **settings: Spoiling())
    fitting.learned_by(task, "bc", demos, task.world())
    assert all(map(np.array_equal, (*demos.obs, *demos.act), before))


@pytest.mark.parametrize(
    ("kind", "expected"),
    [
        ("median", {"median": 3}),
        ("worst", {"worst": 1}),
        ("both", {"median": 3, "worst": 1}),
        ("all", {"median": 3, "worst": 1, "episode_0": 0, "episode_2": 2}),
    ],
)
def test_the_median_is_the_lower_of_two_and_the_worst_the_first_of_equals(
    kind: Record, expected: dict[str, int]
) -> None:
    assert chosen(kind, np.array([5.0, 1.0, 9.0, 2.0])) == expected
    assert chosen("both", np.full(4, 7.0)) == {"median": 1, "worst": 0}


def test_recordings_are_of_the_episodes_that_were_scored(tmp_path: Path) -> None:
    result = ran("reference", tmp_path)
    for row in result.rows:
        median, worst = (
            facts_in(tmp_path / "recordings" / recording_of(result.cell, row.policy, which))
            for which in ("median", "worst")
        )
        assert float(worst["return"]) <= float(median["return"])
        assert float(median["mean return of all"]) == pytest.approx(row.return_mean, abs=1e-5)
        assert worst["returns of all"].startswith(f"{float(worst['return']):.6g} to ")
        endings = ", ".join(f"{count} {why}" for why, count in result.endings[row.policy].items())
        assert median["endings of all"] == endings


def test_all_episodes_may_be_recorded(tmp_path: Path) -> None:
    result = ran("bc", tmp_path, "all")
    assert len(result.recordings) == result.rows[0].episodes == 5
    assert result.files.keys() <= files_of(result.cell)
    names = {file.name.split(".")[1] for file in (tmp_path / "recordings").iterdir()}
    assert {"median", "worst"} < names
    assert all(name.startswith("episode_") for name in names - {"median", "worst"})


def test_an_experts_actions_are_worth_nothing_over_its_own_and_a_push_the_other_way_less() -> None:
    def expert(obs: Array) -> Array:
        return np.clip(obs @ [[0.3], [0.4], [6.0], [1.2]], -1, 1)

    seed, reward = evaluation_seeds(0, 1)[0], Constant(2.0, 1.0)
    (own,) = Simulator(SPEC, 1).run(expert, [seed])
    (fallen,) = Simulator(SPEC, 1).run(lambda obs: -expert(obs), [seed])
    assert fallen.terminated
    better, worse = advantages(SPEC, expert, [own, fallen], [seed, seed], reward)
    assert better is not None
    assert np.abs(better.true).max() < 0.05 * 100  # what the discount leaves of 1 / (1 - gamma)
    assert worse is not None
    assert worse.learned is not None
    assert worse.steps[-1] == len(fallen.act)
    # They sum up to the return less the expert's return from the start.
    weights = SPEC.gamma ** np.array([0, *worse.steps[:-1]])
    most = math.ceil(math.log(LEAST_WEIGHT) / math.log(SPEC.gamma))
    (best,) = Simulator(SPEC, 1).run(expert, [seed], most=most)
    gained = [one.rewards @ SPEC.gamma ** np.arange(len(one.rewards)) for one in (fallen, best)]
    assert weights @ worse.true == pytest.approx(gained[0] - gained[1])
    assert weights @ worse.true < -50
    assert weights @ worse.learned < -50


def test_a_cut_episode_that_is_too_short_has_no_advantage() -> None:
    cut = Trajectory(np.zeros((2, 4)), np.zeros((1, 1)), np.ones(1), False, "time limit")
    assert advantages(SPEC, lambda obs: np.zeros((len(obs), 1)), [cut], [0], None) == [None]


def test_all_methods_of_a_run_are_compared_on_one_episode(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    conditions, results = dataclasses.replace(SMOKE, record="both"), list[CellResult]()
    with open_for_run(tmp_path, Request(("bc",), ("cartpole",), (0,), conditions)) as run:
        for method in ("reference", "bc"):
            result, files = run_cell(Cell("cartpole", method, 0), conditions, shared())
            run.save(result, files)
            results.append(result)
        assert write_compared(run, results[:1]) == []
        (file,) = write_compared(run, results)
        assert file == tmp_path / "recordings" / compared_in("cartpole")
        learned = run.read_learned(results[1])
        before = os.stat(file).st_mtime_ns
        monkeypatch.setattr(run, "is_as_written", lambda file: True)
        assert write_compared(run, results) == [file]
        assert os.stat(file).st_mtime_ns == before
    ends = {}
    for chunk in RrdReader(file).stream():
        if chunk.entity_path.startswith("/earned/") and not chunk.is_static:
            batch = chunk.to_record_batch()
            ends[chunk.entity_path.rpartition("/")[2]] = batch.column("Scalars:scalars").to_pylist()[-1][0]
    assert ends.keys() == {"expert", "bc_pi_star"}
    first = evaluate(SPEC, learned["pi_star"], evaluation_seeds(0, 1))
    assert ends["bc_pi_star"] == pytest.approx(first.returns[0])
