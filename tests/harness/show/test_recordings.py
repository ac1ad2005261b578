from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest
import rerun as rr
from rerun.chunk import RrdReader

from envs.spec import Array, Shape
from harness.judge.results import Cell
from harness.learn.simulator import Simulator, Trajectory, drawings
from harness.registry import SPECS
from harness.run.files import write_atomic
from harness.show.recordings import record

SPEC = SPECS["cartpole"]
CELL = Cell("cartpole", "shaped", 3)


@pytest.fixture(scope="module")
def episode() -> tuple[Trajectory, list[dict[str, Shape]]]:
    """A short episode: pushed to the right, the pole falls to the left."""
    (trajectory,) = Simulator(SPEC).run(lambda obs: np.full((len(obs), 1), 0.7), [5])
    return trajectory, drawings(SPEC, 5, trajectory.act)


def read(path: Path) -> dict[str, dict[str, pa.Array]]:
    """Every entity's columns by name, static ones beside the others; row ids left out."""
    columns: dict[str, dict[str, pa.Array]] = {}
    for chunk in RrdReader(path).stream():
        batch = chunk.to_record_batch()
        entity = columns.setdefault(chunk.entity_path, {})
        for name, column in zip(batch.schema.names, batch.columns, strict=True):
            if name != "rerun.controls.RowId":
                assert name not in entity
                entity[name] = column
    return columns


def values(column: pa.Array) -> Array:
    return np.array(column.flatten().to_numpy(zero_copy_only=False))


def test_every_number_of_the_episode_can_be_read_back(tmp_path: Path, episode: Any) -> None:
    trajectory, frames = episode
    length = len(trajectory.act)
    learned = np.linspace(-1, 2, length)
    write_atomic(tmp_path / "a.rrd", record(SPEC, CELL, "pi_R", trajectory, frames, learned))
    columns = read(tmp_path / "a.rrd")

    expected = {"/reward/true": trajectory.rewards, "/reward/learned": learned}
    expected["/action/0"] = trajectory.act[:, 0]
    expected |= {f"/observation/{i}": trajectory.obs[:, i] for i in range(4)}
    expected["/return/true"] = np.concatenate([[0], np.cumsum(trajectory.rewards)])
    for entity, truth in expected.items():
        column = columns[entity]
        assert np.array_equal(values(column["Scalars:scalars"]), truth)
        assert column["step"].to_pylist() == list(range(len(truth)))
        seconds = column["sim_time"].cast(pa.int64()).to_numpy() / 1e9
        assert seconds == pytest.approx(SPEC.time_step * np.arange(len(truth)))
        assert values(column["SeriesLines:aggregation_policy"]) == [rr.components.AggregationPolicy.Off.value]
    told = {
        entity: column["SeriesLines:names"].to_pylist()[0]
        for entity, column in columns.items()
        if entity in expected
    }
    assert told["/observation/2"] == ["pole angle [rad]"]
    assert told["/action/0"] == ["motor [10 N]"]


def test_shapes_stand_upright_where_they_were_drawn(tmp_path: Path, episode: Any) -> None:
    trajectory, frames = episode
    write_atomic(tmp_path / "a.rrd", record(SPEC, CELL, "pi_R", trajectory, frames, None))
    columns = read(tmp_path / "a.rrd")
    for name in ("track", "cart", "pole"):
        strips = columns[f"/scene/{name}"]["LineStrips2D:strips"].to_pylist()
        drawn = [frame[name].points * [1, -1] for frame in frames]
        assert len(strips) == len(drawn) == len(trajectory.act) + 1
        for strip, points in zip(strips, drawn, strict=True):
            assert np.array(strip[0]) == pytest.approx(points, abs=1e-6)
    tip = np.array(columns["/scene/pole"]["LineStrips2D:strips"].to_pylist()[0][0])[1]
    assert tip[1] < 0  # up in the picture, where y points down


def test_a_task_that_draws_nothing_is_recorded_without_a_scene(tmp_path: Path, episode: Any) -> None:
    trajectory, frames = episode
    write_atomic(tmp_path / "a.rrd", record(SPEC, CELL, "pi_R", trajectory, [{}] * len(frames), None))
    columns = read(tmp_path / "a.rrd")
    assert np.array_equal(values(columns["/reward/true"]["Scalars:scalars"]), trajectory.rewards)
    assert not any(name.startswith("/scene") for name in columns)


def test_the_ending_and_the_facts_are_in_the_recording(tmp_path: Path, episode: Any) -> None:
    trajectory, frames = episode
    length = len(trajectory.act)
    write_atomic(tmp_path / "a.rrd", record(SPEC, CELL, "pi_R", trajectory, frames, None))
    (entry,) = RrdReader(tmp_path / "a.rrd").recordings()
    assert entry.application_id == "irl-bench-cartpole"
    assert entry.recording_id == "cartpole__shaped__seed3__pi_R"

    columns = read(tmp_path / "a.rrd")
    assert "/reward/learned" not in columns
    assert columns["/ending"]["step"].to_pylist() == [length]
    assert columns["/ending"]["TextLog:text"].to_pylist() == [[f"step {length}: pole fell"]]
    facts = {name: column.to_pylist()[0][0] for name, column in columns["/__properties/episode"].items()}
    assert facts.pop("return") == pytest.approx(trajectory.rewards.sum(), abs=1e-6)
    assert facts == {
        "env": "cartpole",
        "method": "shaped",
        "seed": 3,
        "policy": "pi_R",
        "length": length,
        "ending": "pole fell",
    }


def test_any_path_will_do(tmp_path: Path, episode: Any) -> None:
    trajectory, frames = episode
    folder = Path(os.fsdecode(os.fsencode(tmp_path) + b"/caf\xe9 \n"))
    folder.mkdir()
    write_atomic(folder / "a.rrd", record(SPEC, CELL, "pi_R", trajectory, frames, None))
    (tmp_path / "b.rrd").write_bytes((folder / "a.rrd").read_bytes())
    assert len(values(read(tmp_path / "b.rrd")["/reward/true"]["Scalars:scalars"])) == len(trajectory.act)


def test_where_rerun_writes_nothing_there_is_no_recording(
    episode: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    trajectory, frames = episode
    monkeypatch.setenv("RERUN", "off")
    with pytest.raises(OSError, match="rerun wrote nothing"):
        record(SPEC, CELL, "pi_R", trajectory, frames, None)


def test_equal_episodes_give_recordings_of_equal_content(tmp_path: Path, episode: Any) -> None:
    trajectory, frames = episode
    for name in ("a.rrd", "b.rrd"):
        write_atomic(tmp_path / name, record(SPEC, CELL, "pi_R", trajectory, frames, trajectory.rewards))
    assert read(tmp_path / "a.rrd") == read(tmp_path / "b.rrd")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.rrd", "b.rrd"]


def test_what_does_not_fit_together_is_refused(episode: Any) -> None:
    trajectory, frames = episode
    with pytest.raises(ValueError, match="drawings"):
        record(SPEC, CELL, "pi_R", trajectory, frames[:-1], None)
    with pytest.raises(ValueError, match="same names"):
        record(SPEC, CELL, "pi_R", trajectory, [{}, *frames[1:]], None)
    with pytest.raises(ValueError, match="learned rewards"):
        record(SPEC, CELL, "pi_R", trajectory, frames, trajectory.rewards[1:])
