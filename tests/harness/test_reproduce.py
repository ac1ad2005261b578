"""The thesis's evaluation, through the command line at the smallest budget."""

from collections.abc import Iterator
from pathlib import Path

import pandas as pd
import pytest

from harness.cli import main
from harness.experts import CACHE_VARIABLE
from harness.results import CONTROLS, PROTOCOLS
from harness.study import ARMS, DECAYS, TRAJECTORIES, arm


def test_every_arm_is_named_once() -> None:
    assert len(ARMS) == len(TRAJECTORIES) * len(DECAYS)
    assert ARMS[arm(5, 1e-3)].demonstrations == 5
    assert ARMS[arm(5, 1e-3)].settings == {"weight_decay": 1e-3}


@pytest.fixture(scope="module")
def study(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """Of cart-pole, one seed and two arms; what else is asked for within the module is no more than that."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv(CACHE_VARIABLE, str(tmp_path_factory.mktemp("cache")))
        patch.setattr("harness.reproduce.ENVS", ("cartpole",))
        patch.setattr("harness.study.ARMS", {name: ARMS[name] for name in (arm(1, 0.0), arm(100, 0.0))})
        directory = tmp_path_factory.mktemp("study")
        assert reproduce(directory) == 0
        yield directory


def reproduce(directory: Path) -> int:
    return main(["reproduce", "--seeds", "1", "--budget", "smoke", "--out", str(directory)])


def test_tables_hold_every_arm_and_control_under_both_protocols(study: Path) -> None:
    scores, table = pd.read_csv(study / "scores.csv"), pd.read_csv(study / "study.csv")
    assert set(scores["protocol"]) == set(PROTOCOLS)
    assert set(scores["method"]) == {"reference", *CONTROLS, arm(1, 0.0), arm(100, 0.0)}
    assert (scores["status"] == "ok").all()
    learned = table[table["reward"] == "R*"]
    assert len(learned) == 2 * 2 * 2  # protocols, trajectories, policies
    assert set(learned["trajectories"]) == {1, 100}
    assert len(table) == len(learned) + 2 * len(CONTROLS)
    for _, line in learned.iterrows():
        rows = scores[
            (scores["protocol"] == line["protocol"])
            & (scores["method"] == arm(int(line["trajectories"]), 0.0))
            & (scores["policy"] == line["policy"])
        ]
        assert line["return"] == pytest.approx(rows["return_mean"].mean())
    assert len((study / "study.md").read_text().splitlines()) == 2 + len(table)


def test_figures(study: Path) -> None:
    for name in ("cartpole_figure_5_3.png", "cartpole_study.png"):
        assert (study / name).read_bytes().startswith(b"\x89PNG")


def test_resumed_it_computes_nothing_again(study: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert reproduce(study) == 0
    assert capsys.readouterr().out.count("0 cells to run") == 2
