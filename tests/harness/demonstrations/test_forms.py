"""Files of every form, laid out as their owners write them, are read in the units of the task: the actions,
played back in it, lead to the observations of the file."""

from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest
from pyarrow import parquet

from envs import from_gymnasium
from harness.api.request import RunRequest, resolve
from harness.cli.arguments import parser
from harness.cli.main import main
from harness.cli.runs import request_of
from harness.demonstrations import apart
from harness.demonstrations.reading import read, read_all, write
from harness.demonstrations.recording import Reading
from harness.demonstrations.units import SCALED
from harness.registry import BadInput
from methods.base import Episodes
from tests.harness.demonstrations.made_demonstrations import CHOICES, SWINGUP, made, refused
from tests.harness.demonstrations.owners import (
    LENGTHS,
    PENDULUM,
    STATE_KEYS,
    WITH_LAST,
    WITHOUT_LAST,
    Played,
    d4rl,
    dictionary,
    lerobot,
    play,
    stacked,
)

pytestmark = pytest.mark.usefixtures("read_here", "own_cache")

WRITTEN_BY_LEROBOT = Path(__file__).parent / "lerobot_0_4_4"


@pytest.fixture(scope="module")
def played() -> list[Played]:
    return play()


def assert_played_back(episodes: Episodes) -> None:
    """Assert that the actions lead to the observations in the task, but for a repeated last one."""
    env = PENDULUM.make()
    for seed, (obs, act) in enumerate(zip(episodes.obs, episodes.act, strict=True)):
        seen = [env.reset(seed=seed)[0], *(env.step(one)[0] for one in act)]
        known = len(obs) - np.array_equal(obs[-1], obs[-2])
        np.testing.assert_allclose(obs[:known], seen[:known], atol=1e-4)


@pytest.mark.parametrize("form", WITH_LAST)
def test_files_with_the_observation_after_each_step_are_read_whole(
    tmp_path: Path, played: list[Played], form: str
) -> None:
    writer, keys = WITH_LAST[form]
    result = read(writer(tmp_path / "d", played), PENDULUM, how=Reading(None, keys))
    assert result.form == form
    assert_played_back(result.episodes)
    assert result.episodes.lengths.tolist() == [*LENGTHS]
    np.testing.assert_array_equal(np.concatenate(result.rewards or ()), stacked(played)["rewards"])
    assert result.episodes.terminated == ((form == "robomimic"),) * 3


@pytest.mark.parametrize("form", WITHOUT_LAST)
def test_files_without_an_episodes_last_observation_are_refused_until_the_user_says_what_to_do(
    tmp_path: Path, played: list[Played], form: str
) -> None:
    writer, keys = WITHOUT_LAST[form]
    path = writer(tmp_path / "d", played)
    with pytest.raises(Exception, match="without it, give --last-observation repeat or drop"):
        read(path, PENDULUM, how=Reading(None, keys))
    repeated, dropped = (read(path, PENDULUM, how=Reading(how, keys)) for how in ("repeat", "drop"))
    assert_played_back(repeated.episodes)
    assert_played_back(dropped.episodes)
    assert form.startswith(repeated.form)
    assert repeated.episodes.lengths.tolist() == [*LENGTHS]
    assert dropped.episodes.lengths.tolist() == [length - 1 for length in LENGTHS]
    assert dropped.episodes.terminated == (False,) * 3
    assert repeated.episodes.terminated == (not form.startswith("D4RL"),) * 3
    for result, cut in ((repeated, 0), (dropped, 1)):
        paid = [one.rewards[: len(one.rewards) - cut] for one in played]
        np.testing.assert_allclose(np.concatenate(result.rewards or ()), np.concatenate(paid), rtol=1e-6)


def test_a_folder_that_lerobot_wrote_is_played_back() -> None:
    """It is of LeRobotDataset 0.4.4: two episodes of 20 random torques."""
    assert read(WRITTEN_BY_LEROBOT, PENDULUM, how=Reading("repeat")).episodes.lengths.tolist() == [20, 20]
    result = read(WRITTEN_BY_LEROBOT, PENDULUM, how=Reading("drop"))
    assert result.form == "LeRobot"
    assert result.episodes.lengths.tolist() == [19, 19]
    assert np.abs(np.concatenate(result.episodes.act)).max() > 0.9
    assert_played_back(result.episodes)


@pytest.mark.parametrize("form", ["D4RL", "LeRobot 3.0", "robomimic"])
def test_observations_are_chosen_by_key(tmp_path: Path, played: list[Played], form: str) -> None:
    writer, keys = WITHOUT_LAST[form]
    path = writer(tmp_path / "d", played)
    if not keys:
        refused(
            path,
            "observations of D4RL have no keys; leave out --obs-keys",
            PENDULUM,
            how=Reading("drop", ("a",)),
        )
        return
    listed = "observation.state (2), observation.rate (1)" if "LeRobot" in form else "direction (2), rate (1)"
    refused(path, f"its observations are {listed}; give those of the task", PENDULUM, how=Reading("drop"))
    refused(path, "it has no observations image, but", PENDULUM, how=Reading("drop", ("image",)))
    refused(path, "as obs 0, which lies in [-1, 1]", PENDULUM, how=Reading("drop", keys[::-1]))
    swapped = apart.recording_in(path, Reading("drop", keys[::-1])).arrays["obs"]
    right = np.concatenate(read(path, PENDULUM, how=Reading("drop", keys)).episodes.obs)
    np.testing.assert_array_equal(swapped, np.roll(right, 1, axis=1))


def test_actions_of_several_components_are_flat_in_il_datasets(tmp_path: Path) -> None:
    """Its `baseline_collate` reshapes them so, and the starts of episodes like them."""
    spec = from_gymnasium("Reacher-v5", "reacher_of_gymnasium")
    rng = np.random.default_rng(0)
    act = rng.uniform(-1, 1, (9, 2))
    starts = np.zeros((9, 2))
    starts[[0, 4]] = 1
    np.savez(
        tmp_path / "d.npz",
        obs=rng.uniform(-1, 1, (9, 10)),
        actions=act.ravel(),
        episode_starts=starts.ravel(),
    )
    result = read(tmp_path / "d.npz", spec, how=Reading("repeat"))
    assert result.episodes.lengths.tolist() == [4, 5]
    np.testing.assert_array_equal(np.concatenate(result.episodes.act), act)


def test_choices_of_steps_are_read(tmp_path: Path) -> None:
    episodes, _ = made((5, 4), (True, False), CHOICES)
    columns = {"observations": np.concatenate([obs[:-1] for obs in episodes.obs])}
    columns["actions"] = np.concatenate(episodes.act).argmax(axis=1)
    np.savez(tmp_path / "d.npz", **columns, terminals=np.arange(9) == 4)
    result = read(tmp_path / "d.npz", CHOICES, how=Reading("repeat"))
    assert result.episodes.terminated == (True, False)
    assert all(map(np.array_equal, result.episodes.act, episodes.act))


STEPS = {"observations": np.zeros((4, 3)), "actions": np.zeros((4, 1)), "terminals": np.zeros(4)}
ODD_STEPS: dict[str, tuple[dict[str, Any], str]] = {
    "other flags": ({"terminals": np.full(4, 2)}, "its terminals must be true or false, one for each of 4"),
    "fewer flags": ({"timeouts": np.zeros(3)}, "its timeouts must be true or false, one for each of 4"),
    "fewer actions": ({"actions": np.zeros((3, 1))}, "it has actions float64 (3, 1) for 4 steps"),
    "other observations": ({"next_observations": np.zeros((4, 2))}, "(4, 3) before and (4, 2) after steps"),
    "an episode of one step": (
        {"terminals": np.array([0, 1, 1, 0])},
        "episode 1 has one step, which is its last; leave it out of the file, or give --last-observation rep",
    ),
    "no episode": ({name: column[:0] for name, column in STEPS.items()}, "it holds no episode"),
}


@pytest.mark.parametrize("name", ODD_STEPS)
def test_steps_that_do_not_fit_are_refused(tmp_path: Path, name: str) -> None:
    change, why = ODD_STEPS[name]
    np.savez(tmp_path / "d.npz", **STEPS | change)
    refused(tmp_path / "d.npz", why, how=Reading("drop"))


def test_arrays_that_each_form_lacks_are_named(tmp_path: Path) -> None:
    np.savez(tmp_path / "d.npz", obs=np.zeros((3, 2)), lengths=[2])
    refused(tmp_path / "d.npz", "; terminated for this project's form; ")


def test_a_dataset_of_lerobot_that_lacks_steps_is_refused(tmp_path: Path, played: list[Played]) -> None:
    how = Reading("drop", STATE_KEYS)
    lacks_file = lerobot(tmp_path / "a", played, "v2.1")
    (lacks_file / "data/chunk-000/episode_000001.parquet").unlink()
    refused(lacks_file, "its meta/info.json tells of 57 steps, and its files have 50", PENDULUM, how=how)
    lacks_start = lerobot(tmp_path / "b", played, "v3.0")
    file = lacks_start / "data/chunk-000/file-000.parquet"
    table = parquet.read_table(file)
    frames = pa.array(np.array(table["frame_index"]) + 1)
    parquet.write_table(
        table.set_column(table.schema.get_field_index("frame_index"), "frame_index", frames), file
    )
    refused(lacks_start, "its steps are not numbered from 0 on in each episode", PENDULUM, how=how)


def test_own_files_and_imitations_may_lack_last_observations(tmp_path: Path) -> None:
    episodes, rewards = made((5, 4), (True, True))
    lacking = [obs[:-1] for obs in episodes.obs]
    steps = {"obs": np.concatenate(lacking), "rewards": np.concatenate(rewards)}
    ends = {"lengths": episodes.lengths, "terminated": np.array([True, True])}
    np.savez(tmp_path / "own.npz", act=np.concatenate(episodes.act), **steps, **ends)
    ends = {"indices": episodes.lengths[:1], "terminal": np.array([True, True])}
    np.savez(tmp_path / "old.npz", acts=2 * np.concatenate(episodes.act), **steps, **ends)
    for name, bounds in (("own", None), ("old", 2 * SCALED)):
        refused(tmp_path / f"{name}.npz", "it has 9 observations for 9 actions", SWINGUP, bounds)
        repeated, dropped = (
            read(tmp_path / f"{name}.npz", SWINGUP, bounds, Reading(how)).episodes
            for how in ("repeat", "drop")
        )
        assert (repeated.terminated, dropped.terminated) == ((True, True), (False, False))
        for i, obs in enumerate(lacking):
            np.testing.assert_array_equal(repeated.obs[i], [*obs, obs[-1]])
            np.testing.assert_array_equal(dropped.obs[i], obs)
            np.testing.assert_allclose(dropped.act[i], episodes.act[i][:-1])


def test_several_files_are_one_with_their_names(tmp_path: Path, played: list[Played]) -> None:
    paths = [dictionary(tmp_path / "a", played[:1]), d4rl(tmp_path / "b", played[1:])]
    how = Reading("repeat")
    merged, first, second = (
        read_all(paths, PENDULUM, how=how),
        *(read(path, PENDULUM, how=how) for path in paths),
    )
    assert merged.episodes.lengths.tolist() == [*LENGTHS]
    assert merged.digest == read(d4rl(tmp_path / "c", played), PENDULUM, how=how).digest
    assert first.returns is not None
    assert second.returns is not None
    np.testing.assert_array_equal(merged.returns, [*first.returns, *second.returns])
    assert str(merged).endswith(" of a.npz, b.hdf5")
    bare = tmp_path / "bare.npz"
    write(bare, second.episodes)
    assert read_all([paths[0], bare], PENDULUM, how=how).rewards is None


def test_a_run_takes_several_files_and_says_which(tmp_path: Path) -> None:
    files = [tmp_path / name for name in ("one.npz", "two.npz")]
    for file in files:
        write(file, *made())
    words = ["--demos-from", str(files[0]), "--demos-from", str(files[1])]
    asked = request_of(parser().parse_args(["run", "--methods", "bc", "--envs", "swingup", *words]))
    assert asked.files == (*files,)
    request, demonstrations = resolve(asked, True)
    assert demonstrations is not None
    assert len(demonstrations.episodes) == 6
    assert request.conditions.demonstrations.endswith(" of one.npz, two.npz")


def test_a_file_that_is_named_twice_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    write(Path("d.npz"), *made())
    (tmp_path / "link.npz").symlink_to("d.npz")
    for other in ("d.npz", "./d.npz", "link.npz"):
        with pytest.raises(BadInput, match="--demos-from names a file twice"):
            resolve(RunRequest(methods=["bc"], envs=["swingup"], demos_from=["d.npz", other]), True)


@pytest.mark.parametrize("option", [{"last_observation": "drop"}, {"obs_keys": ["a"]}])
def test_options_of_files_need_a_file(option: dict[str, Any]) -> None:
    with pytest.raises(BadInput, match="is for demonstrations of a file: --demos-from"):
        resolve(RunRequest(methods=["bc"], envs=["swingup"], **option), True)


def test_a_file_is_described_without_a_task(
    tmp_path: Path, played: list[Played], capsys: pytest.CaptureFixture[str]
) -> None:
    path = str(d4rl(tmp_path / "d", played, after=True))
    assert main(["demos", "inspect", path]) == 0
    lines = capsys.readouterr().out.splitlines()
    obs, act = np.concatenate([one.obs for one in played]), stacked(played)["act"]
    assert lines[:3] == [
        "form        D4RL",
        "episodes    3, of which 0 terminated",
        "steps       57; 7 to 30 an episode",
    ]
    assert f"observed    2    {obs[:, 2].min():.3g} to {obs[:, 2].max():.3g}" in lines[5]
    assert f"actions     0    {act.min():.3g} to {act.max():.3g}" in lines[6]
    assert lines[7].startswith("returns ")
    assert main(["demos", "inspect", str(tmp_path / "absent.npz")]) == 2
    assert "absent.npz: no demonstrations: " in capsys.readouterr().err
