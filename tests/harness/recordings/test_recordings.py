"""Recordings hold every number of their episodes, and map rewards where they are paid."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pyarrow as pa
import pytest
from rerun.chunk import RrdReader

from envs.spec import Array
from harness.recordings.episode import Advantage, Episode, record
from harness.recordings.pictures import pictures
from harness.recordings.scenes import Flat, Solid, scene
from harness.records import Cell
from harness.registry import SPECS
from harness.rl.simulator import Simulator, Trajectory
from harness.store.files import write_atomic

pytestmark = pytest.mark.filterwarnings("ignore:RRD file has no footer")
SPEC = SPECS["cartpole"]
CELL = Cell("cartpole", "shaped", 3)
Columns = dict[str, dict[str, pa.Array]]


def pushed(force: float) -> Trajectory:
    """A short episode: pushed to the right, the pole falls to the left."""
    (trajectory,) = Simulator(SPEC, 1).run(lambda obs: np.full((len(obs), 1), force), [5])
    return trajectory


@pytest.fixture(scope="module")
def episode() -> Episode:
    """An episode with everything that can be recorded of it."""
    trajectory, rng = pushed(0.7), np.random.default_rng(0)
    steps = len(trajectory.act)
    return Episode(
        trajectory,
        scene(SPEC, 5, trajectory.act),
        learned=np.linspace(-1, 2, steps),
        expert=rng.uniform(-1, 1, (steps, 1)),
        f=rng.uniform(-1, 1, (steps, 1)),
        precision=1 + rng.random((steps, 1)),
        advantage=Advantage(np.array([3, 9]), np.array([1.0, -2.0]), np.array([-4.0, 1.0])),
        facts={"mean return of all": 12.5, "endings of all": "5 pole fell"},
    )


@pytest.fixture(scope="module")
def file(episode: Episode, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("recorded") / "a.rrd"
    path.write_bytes(record(SPEC, CELL, "pi_R", "worst", episode))
    return path


@pytest.fixture(scope="module")
def columns(file: Path) -> Columns:
    return read(file)


def read(path: Path, recording: bytes = b"") -> Columns:
    """Every entity's columns by name, static ones beside the others, without row ids."""
    if recording:
        write_atomic(path, recording)
    columns: Columns = {}
    for chunk in RrdReader(path).stream():
        batch = chunk.to_record_batch()
        entity = columns.setdefault(chunk.entity_path, {})
        for name, column in zip(batch.schema.names, batch.columns, strict=True):
            if name != "rerun.controls.RowId":
                assert name not in entity
                entity[name] = column
    return columns


def values(column: pa.Array, shape: tuple[int, ...] = (-1,)) -> Array:
    while pa.types.is_list(column.type) or pa.types.is_fixed_size_list(column.type):
        column = column.flatten()
    return np.array(column.to_numpy(zero_copy_only=False)).reshape(shape)


def test_every_number_of_the_episode_can_be_read_back(episode: Episode, columns: Columns) -> None:
    played, steps, signal = episode.trajectory, len(episode.trajectory.act), columns["/signal"]
    assert episode.learned is not None
    assert episode.precision is not None
    expected = {
        "true": played.rewards,
        "learned": episode.learned,
        "true_return": np.concatenate([[0], np.cumsum(played.rewards)]),
        "learned_return": np.concatenate([[0], np.cumsum(episode.learned)]),
        "action_0": np.hstack([played.act, episode.expert, episode.f]).ravel(),  # type: ignore[list-item]
        "precision": episode.precision.ravel(),
        "observation": played.obs.ravel(),
    }
    for part, truth in expected.items():
        assert values(signal[f"signal:{part}"]).tobytes() == truth.tobytes(), part
    assert signal["step"].to_pylist() == list(range(steps + 1))
    assert [len(row) for row in signal["signal:true"].to_pylist()] == [1] * steps + [0]
    assert [len(row) for row in signal["signal:observation"].to_pylist()] == [4] * (steps + 1)
    assert columns["/advantage"]["step"].to_pylist() == [3, 9]
    scaled = values(columns["/advantage"]["Scalars:scalars"], (2, 2))
    np.testing.assert_allclose(scaled, [[0.5, -1.0], [-1.0, 0.25]])


def test_shapes_stand_upright_where_they_were_drawn(episode: Episode, columns: Columns) -> None:
    drawn = episode.scene
    assert isinstance(drawn, Flat)
    assert (drawn.fixed, drawn.moving) == (["track"], ["cart", "pole"])
    rows = columns["/scene/policy"]["LineStrips2D:strips"].to_pylist()
    for row, frame in zip(rows, drawn.frames, strict=True):
        for strip, name in zip(row, drawn.moving, strict=True):
            assert np.array(strip) == pytest.approx(frame[name].points * [1, -1], abs=1e-6)
    assert np.array(rows[0][1])[1, 1] < 0  # the pole's tip, up in the picture, where y points down
    track = columns["/scene/fixed"]["LineStrips2D:strips"].to_pylist()[0][0]
    assert np.array(track) == pytest.approx(drawn.frames[0]["track"].points * [1, -1], abs=1e-6)


@pytest.mark.parametrize("name", ["double_pendulum", "point_maze"])
def test_mujocos_bodies_are_where_the_simulator_has_them(tmp_path: Path, name: str) -> None:
    spec, rng = SPECS[name], np.random.default_rng(0)
    (played,) = Simulator(spec, 1).run(lambda obs: spec.random_actions(len(obs), rng), [0], most=30)
    seen = scene(spec, 0, played.act)
    assert isinstance(seen, Solid)
    assert seen.moving
    recording = record(spec, Cell(name, "bc", 0), "pi_R", "worst", Episode(played, seen))
    columns = read(tmp_path / "a.rrd", recording)

    def column(kind: str, part: str, size: int) -> Array:
        shape = {"capsule": "Capsules3D", "sphere": "Ellipsoids3D", "cylinder": "Cylinders3D"}[kind]
        return values(columns[f"/scene/policy/{kind}"][f"{shape}:{part}"], (-1, len(seen.moving[kind]), size))

    env = spec.make()
    env.reset(seed=0)
    model, data = env.unwrapped.model, env.unwrapped.data  # type: ignore[attr-defined]
    for step in range(len(played.act) + 1):
        if step:
            env.step(spec.native(played.act[step - 1]))
        for kind, geoms in seen.moving.items():
            turns = column(kind, "quaternions", 4)[step]
            places = column(kind, "translations" if kind == "capsule" else "centers", 3)[step]
            for geom, turn, place in zip(geoms, turns, places, strict=True):
                turned, matrix = np.empty(9), data.geom_xmat[geom].reshape(3, 3)
                mujoco.mju_quat2Mat(turned, turn[[3, 0, 1, 2]].astype(np.float64))
                assert turned.reshape(3, 3) == pytest.approx(matrix, abs=1e-6)
                half = model.geom_size[geom, 1] if kind == "capsule" else 0.0
                assert place + half * matrix[:, 2] == pytest.approx(data.geom_xpos[geom], abs=1e-6)


def test_the_ending_and_the_facts_are_in_the_recording(
    episode: Episode, file: Path, columns: Columns
) -> None:
    length = len(episode.trajectory.act)
    (entry,) = RrdReader(file).recordings()
    assert entry.application_id == "irl-bench-cartpole"
    assert entry.recording_id == "cartpole__shaped__seed3__pi_R.worst"
    assert columns["/ending"]["step"].to_pylist() == [length]
    assert columns["/ending"]["TextLog:text"].to_pylist() == [[f"step {length}: pole fell"]]
    (text,) = columns["/episode"]["TextDocument:text"].to_pylist()[0]
    facts = dict(line.strip("| ").split(" | ") for line in text.splitlines()[2:])
    assert float(facts["return"]) == pytest.approx(episode.trajectory.rewards.sum(), abs=1e-6)
    expected = {"method": "shaped", "length": str(length), "ending": "pole fell"}
    assert expected.items() <= facts.items()
    assert facts["mean return of all"] == "12.5"


def test_equal_episodes_give_equal_content_and_where_rerun_writes_nothing_there_is_no_recording(
    tmp_path: Path, episode: Episode, columns: Columns, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert read(tmp_path / "b.rrd", record(SPEC, CELL, "pi_R", "worst", episode)) == columns
    monkeypatch.setenv("RERUN", "off")
    with pytest.raises(OSError, match="rerun wrote nothing"):
        record(SPEC, CELL, "pi_R", "median", episode)


def test_a_height_field_and_the_edges_of_a_road_on_it_are_recorded(tmp_path: Path) -> None:
    spec = SPECS["drive_state"]
    (played,) = Simulator(spec, 1).run(lambda obs: np.zeros((len(obs), 2)), [3])
    seen = scene(spec, 3, played.act)
    assert isinstance(seen, Solid)
    cell = Cell("drive_state", "bc", 0)
    columns = read(tmp_path / "a.rrd", record(spec, cell, "pi_R", "worst", Episode(played, seen)))
    ground = columns["/scene/fixed/ground_0"]
    corners = values(ground["Mesh3D:vertex_positions"], (-1, 3))
    cells = values(ground["Mesh3D:triangle_indices"], (-1, 3))
    edges = values(columns["/scene/fixed/edges"]["LineStrips3D:strips"], (-1, 3))
    assert len(corners) == 64**2
    assert len(cells) == 2 * 63**2
    data, down, group = mujoco.MjData(seen.model), np.array([0.0, 0.0, -1.0]), np.array([0, 1, 0, 0, 0, 0])
    mujoco.mj_forward(seen.model, data)
    for x, y, z in edges[::20]:
        start, hit = np.array([x, y, z + 20.0]), np.zeros(1, np.int32)
        below = mujoco.mj_ray(seen.model, data, start, down, group.astype(np.uint8), 1, -1, hit, None)
        assert below == pytest.approx(20.2, abs=0.3)
    sides = corners[cells]
    areas = np.cross(sides[:, 1] - sides[:, 0], sides[:, 2] - sides[:, 0])[:, 2] / 2
    assert areas.sum() == pytest.approx((2 * 84.0) ** 2)
    assert areas.min() > 0
    heights = seen.model.hfield_data.reshape(64, 64) * seen.model.hfield_size[0, 2]
    np.testing.assert_allclose(corners[:, 2].reshape(64, 64), heights, rtol=1e-6)


@pytest.mark.parametrize(("name", "channels"), [("swingup_pixels", 1), ("drive", 2)])
def test_images_are_recorded_as_they_are_seen(tmp_path: Path, name: str, channels: int) -> None:
    spec = SPECS[name]
    (played,) = Simulator(spec, 1).run(lambda obs: np.zeros((len(obs), spec.act_size)), [3], most=4)
    images = pictures(spec, 3, played.act)
    assert images.shape[::3] == (5, channels)
    assert len(np.unique(images.reshape(5, -1), axis=0)) == 5
    episode = Episode(played, scene(spec, 3, played.act), pictures=images)
    seen = read(tmp_path / "a.rrd", record(spec, Cell(name, "bc", 0), "pi_R", "worst", episode))["/camera"]
    shown = values(seen["Image:buffer"], (*images.shape[:3], -1))
    assert np.array_equal(shown[..., :channels], images)
    assert not shown[..., channels:].any()
