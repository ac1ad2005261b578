"""Files that a run did not write: none is deleted, written over, followed or called damaged."""

import os
import pickle
import subprocess
import sys
from pathlib import Path

import pytest

from harness.benchmarks.reproduce import open_study
from harness.cli.main import main
from harness.registry import BadInput
from harness.store.files import SUMS, write_atomic
from harness.store.opening import open_for_report, open_for_run
from tests.harness.small_runs import REQUEST, execute, run, snapshot, store, stored, strange

__all__ = ["run"]

ROOT = Path(__file__).parents[3]


def test_a_users_own_files_in_a_runs_directory_are_nobodys_damage(run: Path) -> None:
    mine = ["notes.txt", "leaderboard.xlsx", ".notes.tmp", "recordings/mine.rrd", ".report.html.swp"]
    for name in mine:
        (run / name).write_text("mine")
    for command in ("verify", "report", "verify"):
        assert main([command, str(run)]) == 0
    with open_for_run(run, REQUEST):
        pass
    assert [(run / name).read_text() for name in mine] == ["mine"] * len(mine)
    assert "mine.rrd" not in (run / "report.html").read_text()


@pytest.mark.parametrize("name", [SUMS, "run.log", "scores.csv", "recordings/x", ".lock"])
@pytest.mark.parametrize("command", ["run", "reproduce"])
def test_a_directory_of_somebody_elses_is_refused_and_left_as_it_was(
    tmp_path: Path, name: str, command: str, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "mine" / name).parent.mkdir(parents=True)
    (tmp_path / "mine" / name).write_text("another program's")
    before = snapshot(tmp_path)
    assert main([command, "--out", str(tmp_path / "mine")]) == 2
    assert "is not empty and holds no" in capsys.readouterr().err
    assert snapshot(tmp_path) == before


def test_reproduce_and_run_leave_each_others_directories_alone(run: Path) -> None:
    before = snapshot(run)
    assert main(["reproduce", "--out", str(run)]) == 2
    assert snapshot(run) == before
    study = run.parent / "study"
    write_atomic(study / "study.json", b'{"study": "thesis", "format": 1}\n')
    assert main(["run", "--out", str(study)]) == 2
    assert os.listdir(study) == ["study.json"]


def test_a_study_deletes_what_a_killed_one_left_and_goes_on(tmp_path: Path) -> None:
    (tmp_path / ".lock").write_text("irl-bench 123456")
    (tmp_path / ".study.json.0123456789abcdef.tmp").write_text("{")
    for _ in range(2):
        with open_study(tmp_path):
            assert {file.name for file in tmp_path.iterdir()} == {".lock", "study.json"}
        (tmp_path / ".scores.csv.0123456789abcdef.tmp").write_text("half")


def test_a_study_of_a_link_or_of_a_strangers_run_is_refused_before_anything_is_computed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with open_study(tmp_path):
        pass
    (tmp_path / "native").mkdir()
    (tmp_path / "native/mine").write_text("mine")
    assert main(["reproduce", "--out", str(tmp_path)]) == 2
    (tmp_path / "native").rename(tmp_path / "elsewhere")
    (tmp_path / "native").symlink_to(tmp_path / "elsewhere")
    assert main(["reproduce", "--out", str(tmp_path)]) == 2
    assert "it is a link" in capsys.readouterr().err
    assert not (tmp_path / "absorbing").exists()


@pytest.mark.parametrize("name", ["scores.csv", "report.html", SUMS])
def test_a_file_that_leads_elsewhere_is_replaced_and_not_followed(run: Path, name: str) -> None:
    elsewhere = run.parents[1] / "mine"
    elsewhere.write_text("mine")
    (run / name).unlink()
    (run / name).symlink_to(elsewhere)
    assert main(["verify", str(run)]) == 1
    assert main(["report", str(run)]) == 0
    assert elsewhere.read_text() == "mine"
    assert not (run / name).is_symlink()


@pytest.mark.parametrize("name", [".lock", "run.log"])
def test_what_is_written_to_leads_nowhere_else(run: Path, name: str) -> None:
    mine = run.parents[1] / "mine"
    mine.write_text("mine")
    (run / name).unlink(missing_ok=True)
    (run / name).symlink_to(mine)
    with pytest.raises((BadInput, OSError), match="link"), open_for_run(run, REQUEST) as directory:
        directory.log(b"more")
    assert mine.read_text() == "mine"


@pytest.mark.parametrize("changes", [{"env": "../../x"}, {"method": "../x"}, {"seed": 1}])
def test_rows_of_another_cell_are_refused_and_nothing_outside_is_written(
    run: Path, changes: dict[str, object], capsys: pytest.CaptureFixture[str]
) -> None:
    strange(run, **changes)
    before = set(run.parents[1].rglob("*"))
    assert main(["report", str(run)]) == 2
    assert "holds no finished cell" in capsys.readouterr().err
    assert main(["verify", str(run)]) == 1
    assert set(run.parents[1].rglob("*")) == before


def test_a_method_has_no_policy_of_the_reference(run: Path) -> None:
    strange(run, policy="expert")
    with open_for_report(run) as directory:
        (reason,) = directory.load()[1].values()
    assert reason == "it holds 'expert' where a policy of bc should be, once"


def test_verify_writes_nothing(run: Path) -> None:
    (run / ".lock").unlink()
    (run / ".report.html.0123456789abcdef.tmp").write_text("left by a killed run")
    before = snapshot(run)
    assert main(["verify", str(run)]) == 0
    assert snapshot(run) == before


def test_a_run_deletes_what_a_killed_run_left_half_written(run: Path) -> None:
    half = [".scores.csv.0123456789abcdef.tmp", "recordings/.a.rrd.0123456789abcdef.tmp"]
    for name in half:
        (run / name).write_text("{")
    (run / "recordings/.b.rrd.0123456789abcdef.tmp").mkdir()
    with open_for_run(run, REQUEST):
        assert not any((run / name).exists() for name in half)
    assert (run / "recordings/.b.rrd.0123456789abcdef.tmp").is_dir()


def test_folders_are_not_made_for_what_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine").write_text("mine")
    for out in ("new/sub/../../mine", "/".join("a" * 1500)):
        assert main(["run", "--out", out]) == 2
    assert not (tmp_path / "new").exists()


# A stranger's run: nothing in it is executed, nothing outside it is written.

OUTSIDE = ("../outside", "/tmp/irl-bench-outside", "..")


class Payload:
    """Whoever unpickles it makes a file."""

    def __init__(self, marker: Path) -> None:
        self.marker = marker

    def __reduce__(self) -> tuple[object, tuple[Path]]:
        return Path.touch, (self.marker,)


def test_a_strangers_run_is_read_and_never_executed(run: Path, tmp_path: Path) -> None:
    payload = pickle.dumps(Payload(tmp_path / "executed"))
    pickle.loads(payload)
    (tmp_path / "executed").unlink()  # raises if it had done nothing
    for number, name in enumerate(OUTSIDE):
        store(run, payload, name)
        store(run, payload, name, "learned")
        for kind in ("env", "method"):
            cell = stored(run)
            cell["cell"][kind] = cell["rows"][0][kind] = name
            store(run, cell, f"cartpole__{kind}{number}__seed0")
    execute(run, "UPDATE cells SET data = ? WHERE name = '..'", "[" * 100_000)
    for name in ("cell.pkl", "recordings/a.rrd", "run.log", "model.pt"):
        (run / name).write_bytes(payload)
    before = snapshot(tmp_path).keys()
    command = [sys.executable, "-m", "harness"]
    for words, code in ((["report"], 1), (["verify"], 1), (["compare", str(run)], 0)):
        done = subprocess.run(
            [*command, *words, str(run)], cwd=ROOT, capture_output=True, text=True, check=False
        )
        assert done.returncode == code
        assert all(name in done.stderr + done.stdout for name in ("a plain name", "no JSON of a run"))
    assert (run / "leaderboard.md").read_text().count("| bc |") == 2  # scores, and costs
    assert snapshot(tmp_path).keys() == before
    assert not Path(OUTSIDE[1]).exists()
