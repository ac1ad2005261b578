"""Files that a run did not write: none is deleted, written over, followed or called damaged."""

import dataclasses
import json
import os
import resource
import stat
import subprocess
import sys
from pathlib import Path

import pytest

from harness.cli import main
from harness.codec import checksum, encode
from harness.files import append, appending, read, sha256, write_atomic
from harness.registry import BadInput
from harness.reproduce import open_study
from harness.request import Request, write_request
from harness.results import Cell, CellResult, Conditions, Row
from harness.store import SUMS, open_for_report, open_for_run, open_to_verify

ROOT = Path(__file__).parents[2]
CONDITIONS = Conditions("smoke", "absorbing", "sbx")
REQUEST = Request(("bc",), ("cartpole",), 1, CONDITIONS)
RECORDING = "cartpole__bc__seed0__pi_star.rrd"


def result(method: str = "bc") -> CellResult:
    row = Row("cartpole", method, 0, "pi_star", "absorbing", episodes=1, return_mean=1.0, length_mean=1.0)
    return CellResult(Cell("cartpole", method, 0), [row], {"loss": [(0.0, 1.0), (1.0, 0.5)]})


@pytest.fixture
def run(tmp_path: Path) -> Path:
    """A finished run of a real report."""
    path = tmp_path / "deep/run"
    with open_for_run(path, REQUEST) as directory:
        write_atomic(path / "recordings" / RECORDING, b"a recording")
        recordings = {RECORDING: sha256(path / "recordings" / RECORDING)}
        directory.save(dataclasses.replace(result(), recordings=recordings))
    assert main(["report", str(path)]) == 0
    assert main(["verify", str(path)]) == 0
    return path


def snapshot(path: Path) -> dict[str, bytes | None]:
    return {str(file): file.read_bytes() if file.is_file() else None for file in path.rglob("*")}


# The directory of a run.


def test_a_users_own_files_in_a_runs_directory_are_nobodys_damage(run: Path) -> None:
    mine = [
        "notes.txt",
        "leaderboard.xlsx",
        "figures/mine.png",
        "recordings/mine.rrd",
        ".notes.tmp",
        "cells/a.txt",
        "cells/notes.json",
    ]
    mine += ["figures/.draft.tmp", "scores.csv.bak", ".report.html.swp", "cells/.#a.json"]
    for name in mine:
        (run / name).write_text("mine")
    for command in ("verify", "report", "verify"):
        assert main([command, str(run)]) == 0
    with open_for_run(run, REQUEST):
        pass
    assert [(run / name).read_text() for name in mine] == ["mine"] * len(mine)
    assert "mine.rrd" not in (run / "report.html").read_text()


@pytest.mark.parametrize(
    "content", [{"SHA256SUMS": ""}, {"run.log": ""}, {"scores.csv": "a"}, {"cells/x": "a"}]
)
@pytest.mark.parametrize("command", ["run", "reproduce"])
def test_a_directory_of_somebody_elses_is_refused_and_left_as_it_was(
    tmp_path: Path, content: dict[str, str], command: str, capsys: pytest.CaptureFixture[str]
) -> None:
    for name, text in content.items():
        (tmp_path / "mine" / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / "mine" / name).write_text(text)
    before = snapshot(tmp_path)
    assert main([command, "--out", str(tmp_path / "mine")]) == 2
    assert "is not empty and holds no" in capsys.readouterr().err
    assert snapshot(tmp_path) == before


def test_reproduce_and_run_leave_each_others_directories_alone(
    run: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before = snapshot(run)
    assert main(["reproduce", "--out", str(run)]) == 2
    assert snapshot(run) == before
    study = run.parent / "study"
    write_atomic(study / "study.json", b'{"study": "thesis", "format": 1}\n')
    assert main(["run", "--out", str(study)]) == 2
    assert os.listdir(study) == ["study.json"]


def test_a_study_that_was_killed_at_once_can_be_started_again(tmp_path: Path) -> None:
    (tmp_path / ".lock").write_text("irl-bench 123456")
    (tmp_path / ".study.json.0123456789abcdef.tmp").write_text("{")
    with open_study(tmp_path):
        assert (tmp_path / "study.json").exists()


def test_reproduce_writes_to_no_committed_results_unless_told() -> None:
    from harness.cli import _parser

    assert _parser().parse_args(["reproduce"]).out == Path("results/reproduce")


@pytest.mark.parametrize("folder", ["cells", "recordings", "figures"])
@pytest.mark.parametrize("command", ["run", "report", "verify"])
def test_a_folder_that_leads_elsewhere_is_refused(run: Path, folder: str, command: str) -> None:
    elsewhere = run.parents[1] / "elsewhere"
    (run / folder).rename(elsewhere)
    (elsewhere / ".notes.tmp").write_text("mine")
    (elsewhere / ".a.png.0123456789abcdef.tmp").write_text("mine")
    (run / folder).symlink_to(elsewhere)
    before = snapshot(elsewhere)
    options = (
        ["--methods", "bc", "--envs", "cartpole", "--budget", "smoke", "--out"] if command == "run" else []
    )
    assert main([command, *options, str(run)]) == 2
    assert snapshot(elsewhere) == before


@pytest.mark.parametrize(
    "name", ["scores.csv", "leaderboard.md", "report.html", "figures/cartpole_scores.png"]
)
def test_a_file_that_leads_elsewhere_is_replaced_and_not_followed(run: Path, name: str) -> None:
    elsewhere = run.parents[1] / "mine"
    elsewhere.write_text("mine")
    (run / name).unlink()
    (run / name).symlink_to(elsewhere)
    assert main(["verify", str(run)]) == 1
    assert main(["report", str(run)]) == 0
    assert elsewhere.read_text() == "mine"
    assert not (run / name).is_symlink()


@pytest.mark.parametrize("name", ["run.log", SUMS])
def test_what_is_appended_to_leads_nowhere_else(run: Path, name: str) -> None:
    elsewhere = run.parents[1] / "mine"
    elsewhere.write_text("mine")
    (run / name).unlink(missing_ok=True)
    (run / name).symlink_to(elsewhere)
    with pytest.raises(BadInput, match="it is a link"), open_for_run(run, REQUEST):
        pass
    assert elsewhere.read_text() == "mine"


def strange(run: Path, **changes: object) -> None:
    """The stored cell with other values in its row, and a right checksum."""
    file = run / "cells/cartpole__bc__seed0.json"
    stored = json.loads(file.read_text())
    stored["result"]["rows"][0] |= changes
    stored["sha256"] = checksum(stored["result"])
    file.write_text(json.dumps(stored))


@pytest.mark.parametrize(
    "changes",
    [
        {"env": "../../x"},
        {"method": "../x"},
        {"env": "/tmp/x"},
        {"env": "pendulum"},
        {"seed": 1},
        {"env": "a/b"},
    ],
)
def test_rows_of_another_cell_are_refused_and_nothing_outside_is_written(
    run: Path, changes: dict[str, object], capsys: pytest.CaptureFixture[str]
) -> None:
    strange(run, **changes)
    before = set(run.parents[1].rglob("*"))
    assert main(["report", str(run)]) == 2
    assert "holds no finished cell" in capsys.readouterr().err
    assert main(["verify", str(run)]) == 1
    assert set(run.parents[1].rglob("*")) == before
    assert not Path("/tmp/x_scores.png").exists()


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
    assert main(["report", str(run)]) == 0
    assert snapshot(run).keys() - before.keys() == {str(run / ".lock")}


def test_a_run_deletes_what_a_killed_run_left_half_written(run: Path) -> None:
    half = [".run.json.0123456789abcdef.tmp", "cells/.cartpole__bc__seed0.json.0123456789abcdef.tmp"]
    mine = [".notes.0123456789abcdef.tmp", "figures/.a.svg.0123456789abcdef.tmp"]
    for name in half + mine:
        (run / name).write_text("{")
    (run / "figures/.a.png.0123456789abcdef.tmp").mkdir()
    with open_for_run(run, REQUEST):
        assert not any((run / name).exists() for name in half)
    assert all((run / name).exists() for name in mine)
    assert (run / "figures/.a.png.0123456789abcdef.tmp").is_dir()


@pytest.mark.parametrize("name", [".lock", SUMS, "run.log"])
def test_what_has_other_names_besides_is_not_written_to(run: Path, name: str) -> None:
    mine = run.parents[1] / "mine"
    mine.write_text("mine")
    (run / name).unlink(missing_ok=True)
    (run / name).hardlink_to(mine)
    with pytest.raises(BadInput, match="other names"), open_for_run(run, REQUEST):
        pass
    assert mine.read_text() == "mine"


@pytest.mark.parametrize("text", ["another program's", "4242", "irl-bench 1\n"])
@pytest.mark.parametrize("command", ["run", "reproduce"])
def test_a_lock_of_another_program_marks_no_new_directory(tmp_path: Path, text: str, command: str) -> None:
    (tmp_path / ".lock").write_text(text)
    assert main([command, "--out", str(tmp_path)]) == 2
    assert snapshot(tmp_path) == {str(tmp_path / ".lock"): text.encode()}


@pytest.mark.parametrize("protocol", ["native", "absorbing"])
def test_a_studys_run_is_no_link(tmp_path: Path, protocol: str, capsys: pytest.CaptureFixture[str]) -> None:
    with open_study(tmp_path / "study"):
        pass
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "study" / protocol).symlink_to(tmp_path / "elsewhere")
    assert main(["reproduce", "--out", str(tmp_path / "study")]) == 2
    assert "it is a link" in capsys.readouterr().err
    assert list((tmp_path / "elsewhere").iterdir()) == []


def test_a_study_deletes_what_a_killed_one_left(tmp_path: Path) -> None:
    with open_study(tmp_path):
        pass
    (tmp_path / ".scores.csv.0123456789abcdef.tmp").write_text("half")
    (tmp_path / ".mine.csv.0123456789abcdef.tmp").write_text("mine")
    with open_study(tmp_path):
        left = {path.name for path in tmp_path.glob(".*.tmp")}
    assert left == {".mine.csv.0123456789abcdef.tmp"}


def test_folders_are_not_made_for_what_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine").write_text("mine")
    deep = "/".join("a" * 1500)
    for out in ("new/sub/../../mine", f"new/../{deep}", deep):
        assert main(["run", "--out", out]) == 2
    assert not (tmp_path / "new").exists()


# What a run had.


@pytest.mark.parametrize(
    "gone", ["cells/*", "recordings/*", "figures/*", "cells", "scores.csv", SUMS, "[!r]*"]
)
def test_whatever_a_run_had_and_has_no_more_is_damage(
    run: Path, gone: str, capsys: pytest.CaptureFixture[str]
) -> None:
    for path in run.glob(gone):
        if path.is_dir():
            path.rename(run.parent / path.name)
        else:
            path.unlink()
    assert main(["verify", str(run)]) == 1
    assert "every file is as it was written" not in capsys.readouterr().out


def test_cells_that_were_stored_before_the_first_report_are_listed_too(tmp_path: Path) -> None:
    with open_for_run(tmp_path, REQUEST) as directory:
        directory.save(result())
    assert main(["verify", str(tmp_path)]) == 0
    (tmp_path / "cells/cartpole__bc__seed0.json").unlink()
    assert main(["verify", str(tmp_path)]) == 1


@pytest.mark.parametrize("what", ["scores.csv", "figures/cartpole_scores.png", "report.key", "cells/*"])
def test_a_list_of_checksums_that_was_shortened_is_damage_and_mended_by_report(
    run: Path, what: str, capsys: pytest.CaptureFixture[str]
) -> None:
    (file,) = run.glob(what)
    name = file.relative_to(run).as_posix()
    lines = (run / SUMS).read_text().splitlines(keepends=True)
    (run / SUMS).write_text("".join(line for line in lines if not line.endswith(f"  {name}\n")))
    before = file.read_bytes()
    if what != "cells/*":
        file.write_text("something else")
    assert main(["verify", str(run)]) == 1
    assert "SHA256SUMS" in capsys.readouterr().out
    with open_for_run(run, REQUEST) as directory:
        assert not directory.is_sealed(list(directory.load()[0].values()))
    assert main(["report", str(run)]) == 0
    assert main(["verify", str(run)]) == 0
    assert file.name == "report.key" or file.read_bytes() == before


def test_a_cell_that_was_deleted_with_its_line_is_damage(run: Path) -> None:
    lines = (run / SUMS).read_text().splitlines(keepends=True)
    (run / SUMS).write_text("".join(line for line in lines if "  cells/" not in line))
    (run / "cells/cartpole__bc__seed0.json").unlink()
    assert main(["verify", str(run)]) == 1


def test_a_changed_request_is_damage_though_it_says_the_same(run: Path) -> None:
    (run / "run.json").write_text((run / "run.json").read_text().replace(",", " ,"))
    assert main(["verify", str(run)]) == 1


@pytest.mark.parametrize("gone", ["deleted", "damaged"])
def test_a_report_without_a_cell_that_was_stored_says_so_and_remembers_it(
    tmp_path: Path, gone: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with open_for_run(tmp_path, dataclasses.replace(REQUEST, seeds=2)) as directory:
        directory.save(result())
        second = dataclasses.replace(result().rows[0], seed=1)
        directory.save(CellResult(Cell("cartpole", "bc", 1), [second]))
    lost = tmp_path / "cells/cartpole__bc__seed1.json"
    lost.write_text("{") if gone == "damaged" else lost.unlink()
    for _ in range(2):
        assert main(["report", str(tmp_path)]) == 1
        assert "cartpole__bc__seed1" in capsys.readouterr().err
        assert main(["verify", str(tmp_path)]) == 1
        assert lost.name in capsys.readouterr().out


@pytest.mark.parametrize("gone", ["deleted", "damaged"])
def test_a_report_without_a_recording_says_so(
    run: Path, gone: str, capsys: pytest.CaptureFixture[str]
) -> None:
    recording = run / "recordings" / RECORDING
    recording.write_text("{") if gone == "damaged" else recording.unlink()
    assert main(["report", str(run)]) == 1
    assert f"{RECORDING} is missing or damaged" in capsys.readouterr().err
    assert main(["verify", str(run)]) == 1


@pytest.mark.parametrize("kind", ["deleted", "pipe", "link", "binary"])
def test_a_leaderboard_that_is_none_is_built_again(
    run: Path, kind: str, capsys: pytest.CaptureFixture[str]
) -> None:
    table = run / "leaderboard.md"
    before = table.read_bytes()
    table.unlink()
    if kind == "pipe":
        os.mkfifo(table)
    elif kind == "link":
        table.symlink_to("/etc/hostname")
    elif kind == "binary":
        table.write_bytes(b"\xff\x1b[2J")
    lines = (run / SUMS).read_text().splitlines(keepends=True)
    (run / SUMS).write_text("".join(line for line in lines if not line.endswith("  leaderboard.md\n")))
    capsys.readouterr()
    assert main(["report", str(run)]) == 0
    assert capsys.readouterr().out.startswith(f"\n{before.decode()}")
    assert table.read_bytes() == before


def test_rows_of_another_protocol_are_refused(run: Path) -> None:
    strange(run, protocol="native")
    with open_for_report(run) as directory:
        assert list(directory.load()[1].values()) == ["it was computed under another protocol"]


def test_a_short_write_to_the_list_of_checksums_is_an_error(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    resource.setrlimit(resource.RLIMIT_FSIZE, (100, resource.getrlimit(resource.RLIMIT_FSIZE)[1]))
    try:
        with pytest.raises(OSError, match=r"No space left|File too large"):
            append(tmp_path / "list", b"x" * 101)
    finally:
        most = resource.getrlimit(resource.RLIMIT_FSIZE)[1]
        resource.setrlimit(resource.RLIMIT_FSIZE, (most, most))


def test_names_that_no_file_can_have_are_damage(run: Path) -> None:
    with (run / SUMS).open("a") as sums:
        sums.write("0" * 64 + "  a\0b\n")
    assert main(["verify", str(run)]) == 1
    assert main(["report", str(run)]) == 0


def test_another_runs_cell_is_damage(run: Path, tmp_path: Path) -> None:
    with open_for_run(tmp_path / "other", REQUEST) as directory:
        better = dataclasses.replace(result().rows[0], return_mean=9.0)
        directory.save(dataclasses.replace(result(), rows=[better]))
    name = "cells/cartpole__bc__seed0.json"
    (run / name).write_bytes((tmp_path / "other" / name).read_bytes())
    assert main(["verify", str(run)]) == 1


def test_cells_that_a_run_was_not_asked_for_are_left_out(run: Path) -> None:
    (run / "cells/cartpole__shaped__seed0.json").write_text(encode(result("shaped")))
    with open_for_report(run) as directory:
        found, unusable = directory.load()
    assert list(found) == [Cell("cartpole", "bc", 0)]
    assert list(unusable.values()) == ["this run was not asked for it"]


def test_folders_that_cannot_be_read_are_told(run: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    listdir = os.listdir

    def refuse(folder: Path) -> list[str]:
        if folder.name == "cells":
            raise PermissionError(13, "Permission denied")
        return listdir(folder)

    monkeypatch.setattr("harness.store.os.listdir", refuse)
    with (
        pytest.raises(BadInput, match=r"cannot read .*cells: Permission denied"),
        open_to_verify(run) as opened,
    ):
        opened.damaged()


def test_a_moved_or_deleted_directory_ends_a_run_in_a_line(tmp_path: Path) -> None:
    with open_for_run(tmp_path / "run", REQUEST) as directory:
        (tmp_path / "run").rename(tmp_path / "moved")
        with pytest.raises(OSError, match="moved, deleted or changed while the run goes on"):
            directory.save(result())
    assert not (tmp_path / "run/cells").exists()


def test_a_run_does_not_write_into_another_one_that_took_its_place(tmp_path: Path) -> None:
    other = dataclasses.replace(REQUEST, conditions=dataclasses.replace(CONDITIONS, budget="quick"))
    for request in (other, REQUEST):  # of other conditions, and of the same
        with open_for_run(tmp_path / "run", REQUEST) as directory:
            (tmp_path / "run").rename(tmp_path / f"moved {request.conditions.budget}")
            with open_for_run(tmp_path / "run", request):
                before = snapshot(tmp_path / "run")
                for write in (lambda: directory.save(result()), lambda: directory.seal([], [])):
                    with pytest.raises(OSError, match="changed while the run goes on"):
                        write()
                assert snapshot(tmp_path / "run") == before
        (tmp_path / "run").rename(tmp_path / f"second {request.conditions.budget}")


def test_a_request_that_changes_while_the_run_goes_on_ends_it(tmp_path: Path) -> None:
    with open_for_run(tmp_path, REQUEST) as directory:
        directory.save(result())
        (tmp_path / "run.json").write_text((tmp_path / "run.json").read_text().replace("smoke", "quick"))
        for write in (lambda: directory.save(result()), lambda: directory.seal([result()], [])):
            with pytest.raises(OSError, match="changed while the run goes on"):
                write()


def test_a_run_that_would_grow_beyond_what_can_be_read_is_refused(tmp_path: Path) -> None:
    write_request(tmp_path, dataclasses.replace(REQUEST, methods=tuple(f"m{i}" for i in range(200))))
    before = snapshot(tmp_path)
    with pytest.raises(BadInput, match="cannot hold so much"), open_for_run(tmp_path, REQUEST):
        pass
    assert snapshot(tmp_path) == before


def test_a_torn_last_line_of_the_list_is_mended_by_the_next_writer(run: Path) -> None:
    whole = (run / SUMS).read_bytes()
    for command in ("run", "report"):
        (run / SUMS).write_bytes(whole + whole[:90])
        (run / "report.key").unlink()
        assert main(["verify", str(run)]) == 1
        if command == "run":
            with open_for_run(run, REQUEST):
                assert (run / SUMS).read_bytes() == whole
        assert main(["report", str(run)]) == 0
        assert main(["verify", str(run)]) == 0


def test_a_swapped_cell_is_told_by_report(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    strange(run, return_mean=999.0)
    assert main(["report", str(run)]) == 1
    assert "cartpole__bc__seed0.json: its checksum does not match" in capsys.readouterr().err


def test_two_may_verify_at_once(run: Path) -> None:
    with open_to_verify(run):
        assert main(["verify", str(run)]) == 0
        with pytest.raises(BadInput, match="in use"), open_for_report(run):
            pass


def test_a_file_system_that_cannot_sync_folders_will_do(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    fsync = os.fsync

    def refuse(handle: int) -> None:
        if stat.S_ISDIR(os.fstat(handle).st_mode):
            raise OSError(22, "Invalid argument")
        fsync(handle)

    monkeypatch.setattr("harness.files.os.fsync", refuse)
    write_atomic(tmp_path / "file", "text")
    assert (tmp_path / "file").read_text() == "text"


def test_a_users_cells_of_other_names_are_nobodys_damage(run: Path) -> None:
    (run / "cells/old_cartpole__bc__seed0.json").write_text("mine")
    assert main(["verify", str(run)]) == 0


def test_a_study_with_a_strangers_run_is_refused_before_anything_is_computed(tmp_path: Path) -> None:
    with open_study(tmp_path):
        pass
    (tmp_path / "native").mkdir()
    (tmp_path / "native/mine").write_text("mine")
    assert main(["reproduce", "--out", str(tmp_path)]) == 2
    assert not (tmp_path / "absorbing").exists()


# Special files, and what may not be read.


@pytest.mark.parametrize(
    "name", ["cells/cartpole__bc__seed0.json", "scores.csv", SUMS, f"recordings/{RECORDING}"]
)
@pytest.mark.parametrize("kind", ["pipe", "folder", "device", "link", "huge", "binary"])
def test_special_files_block_nobody(run: Path, name: str, kind: str) -> None:
    file = run / name
    file.unlink()
    if kind == "pipe":
        os.mkfifo(file)
    elif kind == "folder":
        file.mkdir()
    elif kind == "device":
        file.symlink_to("/dev/zero")
    elif kind == "link":
        file.symlink_to("/etc/hostname")
    elif kind == "huge":
        with file.open("wb") as handle:
            handle.truncate(1 << 34)
    else:
        file.write_bytes(bytes(range(256)))
    assert main(["verify", str(run)]) == 1
    # Of the one cell there is no report, and what is a folder cannot be replaced.
    refused = name.startswith("cells") or (kind == "folder" and "/" not in name)
    assert main(["report", str(run)]) == (2 if refused else 1 if name.startswith("recordings") else 0)


@pytest.mark.parametrize("kind", ["pipe", "folder", "link", "unreadable"])
def test_a_lock_that_is_none_stops_no_verification(run: Path, kind: str) -> None:
    (run / ".lock").unlink()
    if kind == "pipe":
        os.mkfifo(run / ".lock")
    elif kind == "folder":
        (run / ".lock").mkdir()
    elif kind == "link":
        (run / ".lock").symlink_to("nowhere")
    else:
        (run / ".lock").write_bytes(b"\xff")
    assert main(["verify", str(run)]) == 0


@pytest.mark.parametrize("locale", ["C", "POSIX"])
def test_a_report_says_the_same_in_any_locale(run: Path, locale: str) -> None:
    before = snapshot(run)
    (run / "report.html").unlink()
    env = {**os.environ, "LC_ALL": locale, "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}
    command = [sys.executable, "-m", "harness", "report", str(run)]
    done = subprocess.run(command, cwd=ROOT, env=env, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    page = str(run / "report.html")
    assert snapshot(run)[page] == before[page]
    assert "π" in (run / "report.html").read_text(encoding="utf-8")


def test_files_obey_the_umask(tmp_path: Path) -> None:
    before = os.umask(0o027)
    try:
        write_atomic(tmp_path / "new/file", "text")
        with appending(tmp_path / "log"):
            pass
    finally:
        os.umask(before)
    assert stat.S_IMODE((tmp_path / "new/file").stat().st_mode) == 0o640
    assert stat.S_IMODE((tmp_path / "log").stat().st_mode) == 0o640
    assert read(tmp_path / "new/file") == b"text"
