"""Episodes of a cell: what policies and methods do to arrays, and which episodes are recorded."""

from __future__ import annotations

import dataclasses
import math
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from rerun.chunk import RrdReader

from harness.cell.recording import LEAST_WEIGHT, advantages, chosen
from harness.cell.run import prepare, run_cell
from harness.records import Cell, Conditions
from harness.registry import SPECS
from harness.rl.seeds import evaluation_seeds
from harness.rl.simulator import Simulator
from harness.store.names import files_of, recording_of
from methods.base import Array
from methods.rewards import Constant

pytestmark = pytest.mark.filterwarnings("ignore:RRD file has no footer")
SMOKE = Conditions("smoke", "absorbing", "sbx", retrain=False)
SPEC = SPECS["cartpole"]


@cache
def shared() -> dict[str, bytes]:
    return prepare([Cell("cartpole", "bc", 0)], SMOKE)


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


def test_recordings_are_of_the_episodes_that_were_scored_and_may_be_of_all(tmp_path: Path) -> None:
    conditions = dataclasses.replace(SMOKE, record="all")
    result, files = run_cell(Cell("cartpole", "reference", 0), conditions, shared())
    assert files.keys() == result.files.keys() <= files_of(result.cell)
    for name, data in files.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_bytes(data)
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
