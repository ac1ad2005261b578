"""Runs are compared side by side, where they can be."""

import dataclasses
from pathlib import Path

import pytest

from harness.cli import files
from harness.cli.main import main
from harness.report import compare
from tests.harness.made_results import REQUEST, make_results
from tests.harness.store.test_baseline import computed, edited, made, of_another_method


def test_runs_are_compared_over_the_seeds_that_both_have(tmp_path: Path) -> None:
    results = make_results(("cartpole",))
    request = dataclasses.replace(REQUEST, methods=("bc", "shaped", "maxmargin", "gail"), envs=("cartpole",))
    one = made(tmp_path / "one", [*results, *computed((0, 1, 2), 470)], request)
    other = made(tmp_path / "other", [*results, *computed((1, 2), 480)], request)
    stored = [(path, *files._read(path)) for path in (one, other)]
    runs = [compare.Run(str(path), request.conditions, results) for path, request, results in stored]
    found = {line[1:3]: line[3:] for line in compare.differences(*runs).items}
    seeds, _, _, difference, p, better = found["gail", "pi_star"]
    assert (seeds.number, better.number, p.number) == (2, 1.0, 1.0)
    assert difference.number == pytest.approx(10 / 480)
    assert str(difference) == "+0.02 ns (none)"
    assert [value.number for value in found["shaped", "pi_R"][3:]] == [0.0, 1.0, 0.5]
    assert compare.differing(*runs) == []
    assert compare.other_versions(*runs) == []
    fewer = dataclasses.replace(
        runs[1], results=[result for result in runs[1].results if result.cell.method != "gail"]
    )
    assert "methods only here: gail" in compare.differing(runs[0], fewer)
    assert "methods only there: gail" in compare.differing(fewer, runs[0])


def test_what_cannot_be_compared_is_left_out_and_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    one, other = made(tmp_path / "a/one"), made(tmp_path / "b/other")
    edited(tmp_path / "b", lambda result: result.update(task_version="2", key="2:2"), "cartpole")
    edited(tmp_path / "b", lambda result: result["origin"].update(processor="another"))
    edited(tmp_path / "b", of_another_method, "pendulum")
    assert main(["compare", str(one), str(other)]) == 0
    out = capsys.readouterr().out
    assert "- bc in pendulum: the source or the settings of the method\n" in out
    assert "- cartpole: not compared; of another version of the task" in out
    assert "- processor: " in out
    assert "| pendulum | shaped | pi_R |" in out
    assert "| cartpole |" not in out
    assert main(["compare", str(one), str(tmp_path / "nowhere")]) == 2


def test_scores_of_other_scales_are_not_compared() -> None:
    """1 is what the demonstrations return without an expert."""
    without = dataclasses.replace(REQUEST.conditions, experts="none", demonstrations="abc: 3 episodes")
    results = [dataclasses.replace(result, task_version="a") for result in make_results()]
    one, other = (compare.Run("it", conditions, results) for conditions in (REQUEST.conditions, without))
    assert compare.differences(one, one).items
    assert not compare.differences(one, other).items
    assert compare.is_other_scale(one, other)
    assert "demonstrations: none, there abc: 3 episodes" in compare.differing(one, other)
