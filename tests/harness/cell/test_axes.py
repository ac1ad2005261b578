"""What is shown, and the dynamics in which what was learned is used: from the command line to the
leaderboard."""

from __future__ import annotations

import dataclasses
import itertools
import json
import shlex
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from harness.cell.experts import source_for
from harness.cell.run import prepare, run_cell
from harness.cell.settings import settings_of
from harness.cli.arguments import parser
from harness.cli.main import main
from harness.judge.leaderboard import leaderboard, scored_rows
from harness.records import (
    CONTROLS,
    LEARNED,
    NOMINAL,
    REFERENCE,
    RESULT,
    UNSHOWN,
    Cell,
    CellResult,
    Conditions,
    Shown,
    row_of,
)
from harness.registry import ENVS, METHODS, SPECS, load_method
from harness.rl.seeds import rng_for
from harness.store.codec import decode, encode
from harness.store.names import files_of
from harness.store.opening import open_to_verify
from harness.store.request import Request, command_of
from methods.base import Episodes
from methods.gail import GAIL
from methods.parts import BEGINS_WITH
from methods.settings import settings_for
from methods.shaped import Shaped

SMOKE = Conditions("smoke", "absorbing", "sbx")
MANY = Request(
    ("shaped", "bc"),
    ("swingup", "cartpole"),
    (0, 3),
    SMOKE,
    (Shown(), Shown(5), Shown(1, 20), Shown(0, 1, "noisy")),
    ("swingup.flipped", "swingup.heavy", "cartpole.flipped"),
)


def test_cells_are_a_product_but_for_what_nothing_is_shown_to_and_a_run_asks_for_no_others() -> None:
    cells = {*MANY.cells}
    assert len({cell.name for cell in cells}) == len(cells) == len(MANY.cells)
    methods = len(UNSHOWN) + 4 * (1 + len(CONTROLS) + 2 - len(UNSHOWN))
    assert len(cells) == (3 + 2) * methods * 2  # tasks, seeds
    assert {cell.task for cell in cells} == {"swingup", "cartpole", *MANY.variants}
    names = [name for cell in cells for name in files_of(cell) - {LEARNED}]
    assert len({*names}) == len(names)
    envs, asked = ("swingup", "cartpole", "pendulum"), (REFERENCE, *CONTROLS, "shaped", "bc", "maxent")
    shown = (*MANY.shown, Shown(5, 20), Shown(2))
    for one in itertools.product(envs, asked, (0, 1, 3), shown, (NOMINAL, "flipped", "heavy")):
        assert MANY.asks_for(Cell(*one)) == (Cell(*one) in cells)


def test_the_command_says_it_all() -> None:
    asked = []
    for command in command_of(MANY).split(" && "):
        args = parser().parse_args(shlex.split(command)[1:])
        assert {*args.transfer.split(",")} == {variant.split(".")[1] for variant in MANY.variants}
        asked += [Shown(demos, args.subsample, args.demonstrator) for demos in args.demos]
    assert sorted(asked) == sorted(MANY.shown)
    assert "--plugin FILE" in command_of(Request(("mine",), ("swingup",), (0,), SMOKE))
    unusual = dataclasses.replace(SMOKE, learner="ddpg", solves=3)
    command = command_of(Request(("bc",), ("swingup",), (0,), unusual))
    args = parser().parse_args(shlex.split(command)[1:])
    assert (args.learner, args.solves) == ("ddpg", 3)


def whole(count: int = 3, steps: int = 45) -> Episodes:
    obs = [np.arange(steps + 1.0)[:, None] + 100 * i for i in range(count)]
    act = [np.linspace(-1, 1, steps)[:, None] for _ in range(count)]
    return Episodes(tuple(obs), tuple(act), (False,) * count)


def test_of_steps_that_are_not_shown_nothing_is_left() -> None:
    few = whole().every(20, np.random.default_rng(0))
    assert not few.whole
    assert few.times is not None
    assert few.lengths.tolist() == [45, 45, 45]
    for i, (obs, act, times) in enumerate(zip(few.obs, few.act, few.times, strict=True)):
        assert len(obs) == len(act) == len(times) in (2, 3)
        assert np.diff(times).tolist() == [20] * (len(times) - 1)
        assert np.array_equal(obs[:, 0], times + 100 * i)
        assert np.array_equal(act, whole().act[0][times])
        for shown, all_of_it in ((obs, whole().obs[i]), (act, whole().act[i])):
            assert shown.base is None or shown.base.size < all_of_it.size, "a view would show the rest"
    begun = {int(times[0]) for times in whole(200).every(20, np.random.default_rng(1)).times or ()}
    assert begun == {*range(20)}


def made(cell: Cell, **returns: float) -> CellResult:
    return CellResult(cell, [row_of(cell, p, "absorbing", return_mean=v) for p, v in returns.items()])  # type: ignore[arg-type]


def test_each_board_has_its_own_scale() -> None:
    results = []
    for dynamics, expert, true in ((NOMINAL, 100.0, 90.0), ("flipped", -50.0, 60.0)):
        results += [made(Cell("swingup", REFERENCE, 0, dynamics=dynamics), expert=expert, random=0.0)]
        results += [made(Cell("swingup", "control_true", 0, dynamics=dynamics), pi_R=true)]
        for demos in (0, 5):
            cell = Cell("swingup", "shaped", 0, Shown(demos), dynamics)
            results += [made(cell, pi_star=30.0 + demos, pi_R=45.0)]
    found = {(e.board, e.method, e.policy): e for e in leaderboard(scored_rows(results))}
    scores = {board: found[board, "shaped", "pi_star"].score_mean for board, _, _ in found}
    expected = {"swingup": 0.30, "swingup, 5 demonstrations": 0.35, "swingup.flipped": 30 / 60}
    assert scores == pytest.approx(expected | {"swingup.flipped, 5 demonstrations": 35 / 60})
    assert found["swingup.flipped", "shaped", "pi_R"].share_of_true == pytest.approx(0.75)
    assert all(found[board, "control_true", "pi_R"].seeds == 1 for board in scores)


@pytest.mark.usefixtures("own_cache")
def test_demonstrators_show_what_they_are_called() -> None:
    def shown(*asked: object) -> Episodes:
        return source_for("cartpole", 1, SMOKE).demonstrations(Shown(*asked))  # type: ignore[arg-type]

    expert, medium, noisy = (shown(6, 1, who) for who in ("expert", "medium", "noisy"))
    assert medium.lengths.mean() < 0.8 * expert.lengths.mean()
    for one in (medium, noisy):
        for obs, other in zip(one.obs, expert.obs, strict=True):
            assert np.array_equal(obs[0], other[0]), "the same episodes"
    first = np.array([n[0] - e[0] for n, e in zip(shown(40, 1, "noisy").act, shown(40).act, strict=True)])
    assert first.std() == pytest.approx(0.3, rel=0.3)
    ranked = shown(6, 1, "ranked")
    thirds = [shown(2, 1, who).obs for who in ("expert", "noisy", "medium")]
    assert all(map(np.array_equal, ranked.obs, [obs for third in thirds for obs in third]))
    assert ranked.preferences is not None
    worse, better = ranked.lengths[ranked.preferences.T]
    assert (worse <= better).all()
    assert (worse < better).any()
    few = shown(6, 20)
    for obs, times, all_of_it in zip(few.obs, few.times or (), expert.obs, strict=True):
        assert np.array_equal(obs, all_of_it[times])


@pytest.mark.usefixtures("own_cache")
def test_what_was_learned_is_carried_over_and_trained_on_elsewhere(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "run"
    words = "run --methods shaped,bc --envs swingup --budget smoke --rl sb3 --demos 2 --subsample 7"
    words += " --transfer flipped --engine inline --out"
    assert main([*words.split(), str(out)]) == 0, capsys.readouterr().err
    rows = pd.read_csv(out / "scores.csv")
    assert (rows["status"] == "skipped").sum() == 2  # bc learns no reward
    shaped = rows[(rows["method"] == "shaped") & (rows["demos"] == 2)].set_index(["dynamics", "policy"])
    assert 2 * 28 <= shaped.loc[(NOMINAL, "pi_star"), "pairs"] <= 2 * 29  # of 200 steps
    assert shaped["return_mean"][NOMINAL, "pi_star"] != shaped["return_mean"]["flipped", "pi_star"]
    assert shaped["reward_distance"].notna()[NOMINAL, "pi_R"]
    assert shaped["reward_distance"].isna()["flipped", "pi_R"]
    flipped = rows[rows["dynamics"] == "flipped"].set_index(["method", "policy"])
    for method in ("shaped", "bc"):  # which fit nothing there
        assert np.isnan(flipped.loc[(method, "pi_star"), "fit_seconds"])
    with open_to_verify(out) as run:
        results, _ = run.load()
        shown = [cell for cell in results if (cell.method, cell.shown.demos) == ("shaped", 2)]
        both = [run.read_learned(results[cell]) for cell in shown]
    obs = rng_for(0, "any").normal(size=(20, 3))
    one, other = (its["pi_star"](obs) for its in both)
    assert np.array_equal(one, other)
    assert np.array_equal(*(its["reward"](obs, one, obs) for its in both))
    assert main(["verify", str(out)]) == 0


@pytest.mark.usefixtures("own_cache")
@pytest.mark.parametrize(
    ("learned_in", "cell"),
    [
        (Cell("cartpole", "bc", 0), Cell("cartpole", "control_clone", 0)),
        (Cell("swingup", "shaped", 0), Cell("swingup", "shaped", 0, dynamics="flipped")),
        *[(Cell("swingup", first, 0), Cell("swingup", method, 0)) for method, first in BEGINS_WITH.items()],
    ],
)
def test_what_another_cell_learned_and_what_is_fitted_again_are_the_same(
    learned_in: Cell, cell: Cell, monkeypatch: pytest.MonkeyPatch
) -> None:
    conditions = Conditions("smoke", "absorbing", "sbx")
    inputs = prepare([cell], conditions)
    again, _ = run_cell(cell, conditions, inputs)
    before, files = run_cell(learned_in, conditions, prepare([learned_in], conditions))
    for kind in (GAIL, Shaped):
        monkeypatch.delattr(kind, "first")
    handed = {LEARNED: files[LEARNED], RESULT: encode(before).encode()}
    result, _ = run_cell(cell, conditions, inputs | handed)

    def all_but_times(result: CellResult) -> str:
        rows = [dataclasses.replace(row, fit_seconds=0.0) for row in result.rows]
        return repr((rows, result.curves, result.details, result.warnings))

    assert all_but_times(result) == all_but_times(again)


@pytest.mark.parametrize(("method", "first"), BEGINS_WITH.items())
@pytest.mark.parametrize("budget", ["smoke", "quick", "full"])
def test_methods_that_share_the_first_part_of_a_fit_have_its_settings(
    method: str, first: str, budget: str
) -> None:
    for env in ENVS:
        its, firsts = (vars(load_method(name)(**settings_for(name, env, budget))) for name in (method, first))
        assert its | firsts | {"mean": None} == its | {"mean": None}


@pytest.mark.parametrize("method", METHODS)
def test_a_result_has_every_setting_that_its_cell_has(method: str) -> None:
    conditions = Conditions("quick", "absorbing", "sbx", learner="ddpg", solves=3)
    settings = settings_of(method, "hopper", conditions)
    its = load_method(method)(**settings_for(method, "hopper", "quick"))
    assert settings["method"].keys() == {field.name for field in dataclasses.fields(its)}  # type: ignore[arg-type]
    assert (settings["learner"]["name"], settings["budget"]["solves"]) == ("DDPG", 3)
    assert settings["budget"]["rl_steps"] == SPECS["hopper"].ddpg_steps["quick"]
    there = dataclasses.replace(made(Cell("hopper", method, 0), pi_star=1.0), settings=settings)
    (row,) = scored_rows([decode(encode(there))])
    assert json.loads(row.settings) == json.loads(json.dumps(settings))
    assert "\n" not in row.settings


def test_list_prints_the_settings_of_one_method_in_one_task(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["list", "gail", "--env", "hopper", "--budget", "smoke"]) == 0
    assert "  iterations    1\n" in capsys.readouterr().out
    for words, why in (("gail", "list METHOD --env ENV"), ("gial --env hopper", "did you mean 'gail'")):
        assert main(["list", *words.split()]) == 2
        err = capsys.readouterr().err
        assert why in err
        assert err.count("\n") == 1
