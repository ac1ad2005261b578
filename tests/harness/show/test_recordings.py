from __future__ import annotations

import os
from pathlib import Path

import mujoco
import numpy as np
import pyarrow as pa
import pytest
from gymnasium.envs.mujoco import MujocoEnv
from rerun.chunk import RrdReader

from envs.point_maze import TARGET
from envs.spec import Array
from harness.judge.results import Cell
from harness.learn.simulator import Simulator, Trajectory
from harness.registry import SPECS
from harness.show.comparison import Ghost, identity_of
from harness.show.comparison import record as record_compared
from harness.show.recordings import Advantage, Episode, record
from harness.show.scenes import LONG, Flat, Solid, scene
from harness.store.files import write_atomic

pytestmark = pytest.mark.filterwarnings("ignore:RRD file has no footer")
SPEC = SPECS["cartpole"]
CELL = Cell("cartpole", "shaped", 3)
MOST = 400 << 10
"""Bytes of a recording."""


@pytest.fixture(scope="module")
def trajectory() -> Trajectory:
    """A short episode: pushed to the right, the pole falls to the left."""
    (found,) = Simulator(SPEC, 1).run(lambda obs: np.full((len(obs), 1), 0.7), [5])
    return found


@pytest.fixture(scope="module")
def episode(trajectory: Trajectory) -> Episode:
    """With all that can be told of it."""
    steps = len(trajectory.act)
    rng = np.random.default_rng(0)
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


def read(path: Path, recording: bytes) -> dict[str, dict[str, pa.Array]]:
    """Every entity's columns by name, static ones beside the others; row ids left out."""
    write_atomic(path, recording)
    columns: dict[str, dict[str, pa.Array]] = {}
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


def test_every_number_of_the_episode_can_be_read_back(
    tmp_path: Path, trajectory: Trajectory, episode: Episode
) -> None:
    steps = len(trajectory.act)
    columns = read(tmp_path / "a.rrd", record(SPEC, CELL, "pi_R", "worst", episode))
    signal = columns["/signal"]
    assert episode.learned is not None
    expected = {
        "true": trajectory.rewards,
        "learned": episode.learned,
        "true_return": np.concatenate([[0], np.cumsum(trajectory.rewards)]),
        "learned_return": np.concatenate([[0], np.cumsum(episode.learned)]),
        "action_0": np.stack([trajectory.act[:, 0], episode.expert[:, 0], episode.f[:, 0]], 1).ravel(),  # type: ignore[index]
        "precision": episode.precision.ravel(),  # type: ignore[union-attr]
        "observation": trajectory.obs.ravel(),
    }
    for part, truth in expected.items():
        assert values(signal[f"signal:{part}"]).tobytes() == truth.tobytes(), part
    assert signal["step"].to_pylist() == list(range(steps + 1))
    assert [len(row) for row in signal["signal:true"].to_pylist()] == [1] * steps + [0]
    assert [len(row) for row in signal["signal:observation"].to_pylist()] == [4] * (steps + 1)
    assert columns["/advantage"]["step"].to_pylist() == [3, 9]
    np.testing.assert_allclose(
        values(columns["/advantage"]["Scalars:scalars"], (2, 2)), [[0.5, -1.0], [-1.0, 0.25]]
    )
    assert {name for entity in columns.values() for name in entity if ":" not in name} == {"step"}


def test_shapes_stand_upright_where_they_were_drawn(tmp_path: Path, episode: Episode) -> None:
    columns = read(tmp_path / "a.rrd", record(SPEC, CELL, "pi_R", "worst", episode))
    drawn = episode.scene
    assert isinstance(drawn, Flat)
    assert (drawn.fixed, drawn.moving) == (["track"], ["cart", "pole"])
    rows = columns["/scene/policy"]["LineStrips2D:strips"].to_pylist()
    assert len(rows) == len(drawn.frames)
    for row, frame in zip(rows, drawn.frames, strict=True):
        for strip, name in zip(row, drawn.moving, strict=True):
            assert np.array(strip) == pytest.approx(frame[name].points * [1, -1], abs=1e-6)
    assert np.array(rows[0][1])[1, 1] < 0  # the pole's tip, up in the picture, where y points down
    track = columns["/scene/fixed"]["LineStrips2D:strips"].to_pylist()[0][0]
    assert np.array(track) == pytest.approx(drawn.frames[0]["track"].points * [1, -1], abs=1e-6)


@pytest.mark.parametrize("name", ["double_pendulum", "reacher", "point_maze"])
def test_mujocos_bodies_are_where_the_simulator_has_them(tmp_path: Path, name: str) -> None:
    spec = SPECS[name]
    rng = np.random.default_rng(0)
    (played,) = Simulator(spec, 1).run(lambda obs: spec.random_actions(len(obs), rng), [0], most=30)
    seen = scene(spec, 0, played.act)
    assert isinstance(seen, Solid)
    columns = read(
        tmp_path / "a.rrd", record(spec, Cell(name, "bc", 0), "pi_R", "worst", Episode(played, seen))
    )
    if name == "point_maze":
        target = values(columns["/scene/fixed/target"]["Ellipsoids3D:centers"], (3,))
        assert target == pytest.approx([*TARGET, 0.0])

    env = spec.make()
    inner = env.unwrapped
    assert isinstance(inner, MujocoEnv)
    env.reset(seed=0)
    asked = {0, len(played.act) // 2, len(played.act)}
    checked = 0
    for step in range(len(played.act) + 1):
        if step:
            env.step(spec.native(played.act[step - 1]))
        for kind, geoms in seen.moving.items() if step in asked else ():
            entity = columns[f"/scene/policy/{kind}"]
            shape = {"capsule": "Capsules3D", "sphere": "Ellipsoids3D", "cylinder": "Cylinders3D"}[kind]
            turns = values(entity[f"{shape}:quaternions"], (-1, len(geoms), 4))[step]
            where = "translations" if kind == "capsule" else "centers"
            found = values(entity[f"{shape}:{where}"], (-1, len(geoms), 3))[step]
            for i, geom in enumerate(geoms):
                matrix = inner.data.geom_xmat[geom].reshape(3, 3)
                turned = np.empty(9)
                mujoco.mju_quat2Mat(turned, turns[i][[3, 0, 1, 2]].astype(np.float64))
                assert turned.reshape(3, 3) == pytest.approx(matrix, abs=1e-6)
                middle = found[i] + (
                    inner.model.geom_size[geom, 1] * matrix[:, 2] if kind == "capsule" else 0
                )
                assert middle == pytest.approx(inner.data.geom_xpos[geom], abs=1e-6)
                checked += 1
    assert checked == 3 * sum(map(len, seen.moving.values())) > 0


@pytest.mark.parametrize("name", ["halfcheetah", "walker2d", "hopper", "pendulum"])
def test_the_longest_episodes_with_all_that_can_be_told_are_small(tmp_path: Path, name: str) -> None:
    spec, rng = SPECS[name], np.random.default_rng(0)
    steps = spec.horizon
    model = spec.make().unwrapped.model  # type: ignore[attr-defined]
    noise = [rng.normal(size=(steps + 1, model.ngeom, size)) for size in (3, 4)]
    noise[1] /= np.linalg.norm(noise[1], axis=2, keepdims=True)
    acts = [rng.uniform(-1, 1, (steps, spec.act_size)) for _ in range(4)]
    played = Trajectory(
        rng.normal(size=(steps + 1, spec.obs_size)), acts[0], rng.normal(size=steps), False, "time limit"
    )
    told = Episode(played, Solid(model, *noise), rng.normal(size=steps), *acts[1:])
    recording = record(spec, Cell(name, "shaped", 0), "pi_R", "median", told)
    assert steps > LONG
    assert len(recording) <= MOST
    signal = read(tmp_path / "a.rrd", recording)["/signal"]
    assert values(signal["signal:true"]).tobytes() == played.rewards.tobytes()
    assert values(signal["signal:observation"]).tobytes() == played.obs.astype(np.float32).tobytes()


def test_a_task_that_draws_nothing_is_recorded_without_a_scene(
    tmp_path: Path, trajectory: Trajectory
) -> None:
    columns = read(tmp_path / "a.rrd", record(SPEC, CELL, "pi_R", "median", Episode(trajectory)))
    assert np.array_equal(values(columns["/signal"]["signal:true"]), trajectory.rewards)
    assert "signal:learned" not in columns["/signal"]
    assert not any(name.startswith("/scene") for name in columns)


def test_the_ending_and_the_facts_are_in_the_recording(
    tmp_path: Path, trajectory: Trajectory, episode: Episode
) -> None:
    length = len(trajectory.act)
    columns = read(tmp_path / "a.rrd", record(SPEC, CELL, "pi_R", "worst", episode))
    (entry,) = RrdReader(tmp_path / "a.rrd").recordings()
    assert entry.application_id == "irl-bench-cartpole"
    assert entry.recording_id == "cartpole__shaped__seed3__pi_R.worst"
    assert columns["/ending"]["step"].to_pylist() == [length]
    assert columns["/ending"]["TextLog:text"].to_pylist() == [[f"step {length}: pole fell"]]
    (text,) = columns["/episode"]["TextDocument:text"].to_pylist()[0]
    told = dict(line.strip("| ").split(" | ") for line in text.splitlines()[2:])
    assert float(told.pop("return")) == pytest.approx(trajectory.rewards.sum(), abs=1e-6)
    assert told == {
        **{"env": "cartpole", "method": "shaped", "seed": "3", "policy": "pi_R", "episode": "worst"},
        **{"length": str(length), "ending": "pole fell"},
        **{"mean return of all": "12.5", "endings of all": "5 pole fell"},
    }


def test_all_methods_on_one_episode(tmp_path: Path, trajectory: Trajectory) -> None:
    (still,) = Simulator(SPEC, 1).run(lambda obs: np.zeros((len(obs), 1)), [5])
    ghosts = [
        Ghost("", "expert", still, scene(SPEC, 5, still.act)),
        Ghost("bc", "pi_star", trajectory, scene(SPEC, 5, trajectory.act)),
    ]
    columns = read(tmp_path / "a.rrd", record_compared(SPEC, "what it is", ghosts))
    assert identity_of(tmp_path / "a.rrd") == "what it is"
    for name, played in (("expert", still), ("bc_pi_star", trajectory)):
        earned = columns[f"/earned/{name}"]
        assert values(earned["Scalars:scalars"])[-1] == played.rewards.cumsum()[-1]
        assert len(columns[f"/scene/{name}"]["LineStrips2D:strips"]) == len(played.act) + 1
        assert columns[f"/ending/{name}"]["step"].to_pylist() == [len(played.act)]


def test_any_path_will_do(tmp_path: Path, episode: Episode) -> None:
    folder = Path(os.fsdecode(os.fsencode(tmp_path) + b"/caf\xe9 \n"))
    folder.mkdir()
    recording = record(SPEC, CELL, "pi_R", "median", episode)
    write_atomic(folder / "a.rrd", recording)
    assert (folder / "a.rrd").read_bytes() == recording


def test_where_rerun_writes_nothing_there_is_no_recording(
    episode: Episode, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("RERUN", "off")
    with pytest.raises(OSError, match="rerun wrote nothing"):
        record(SPEC, CELL, "pi_R", "median", episode)


def test_equal_episodes_give_recordings_of_equal_content(tmp_path: Path, episode: Episode) -> None:
    first, second = (
        read(tmp_path / f"{i}.rrd", record(SPEC, CELL, "pi_R", "median", episode)) for i in range(2)
    )
    assert first == second


def test_what_does_not_fit_together_is_refused(trajectory: Trajectory, episode: Episode) -> None:
    drawn = episode.scene
    assert isinstance(drawn, Flat)
    with pytest.raises(ValueError, match="same names"):
        Flat([{}, *drawn.frames[1:]])
    for wrong in (
        Episode(trajectory, Flat(drawn.frames[:-1])),
        Episode(trajectory, learned=trajectory.rewards[1:]),
        Episode(trajectory, expert=trajectory.act[1:]),
    ):
        with pytest.raises(ValueError, match="steps need"):
            record(SPEC, CELL, "pi_R", "median", wrong)
