"""`figure` and `table`: files for a paper, or one line that says why not."""

from __future__ import annotations

from pathlib import Path

import pytest

from harness.cli.main import main
from tests.harness.small_runs import run

__all__ = ["run"]


@pytest.mark.parametrize(
    ("command", "name", "begins"),
    [
        ("figure", "a.pdf", b"%PDF"),
        ("figure", "a.svg", b"<?xml"),
        ("table", "a.tex", b"% \\usepackage{booktabs}"),
        ("table", "a.md", b"## cartpole"),
        ("table", "a.csv", b"env,dynamics"),
    ],
)
def test_a_file_for_a_paper_is_written(
    run: Path, tmp_path: Path, command: str, name: str, begins: bytes
) -> None:
    assert main([command, str(run), "--to", str(tmp_path / name), "--env", "cartpole"]) == 0
    assert (tmp_path / name).read_bytes().startswith(begins)


@pytest.mark.parametrize(
    ("more", "why"),
    [
        (["--to", "a.docx"], "--to must end in .pdf, .svg, .png, not 'a.docx'"),
        (["--to", "{run}/report.svg"], "lies in the run"),
        (["--to", "a.svg", "--env", "pendulm"], "no env of this run named 'pendulm'"),
    ],
)
def test_bad_input_is_a_line_and_writes_nothing(
    run: Path,
    tmp_path: Path,
    more: list[str],
    why: str,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    before = {*tmp_path.rglob("*")}
    assert main(["figure", str(run), *(word.format(run=run) for word in more)]) == 2
    err = capsys.readouterr().err
    assert why in err
    assert err.count("\n") == 1
    assert {*tmp_path.rglob("*")} == before
