"""Methods with settings of the user's: named, checked before anything runs, and rows of their own."""

from pathlib import Path

import pytest

from harness.api.request import RunRequest, resolve
from harness.cli.main import main
from harness.engines.jobs import Job
from harness.judge.rows import is_rival, role_of
from harness.process.environment import of_this_process
from harness.records import Cell, Conditions
from harness.registry import KNOWN, METHODS, VARIANTS, BadInput, keys, plugins
from harness.registry.configured import name_of, names_in, searched, settings_in, typed, value_in
from harness.schedule.costs import Costs
from harness.store.request import command_of
from tests.harness.plugged import MINE
from tests.harness.registry.conftest import CONDITIONS

WIDE = "gail+layers-128x128"


@pytest.mark.parametrize(
    ("text", "name", "settings"),
    [
        ("gail(layers=(128, 128,))", WIDE, {"layers": (128, 128)}),
        ("gail( layers = [128, 128] )", WIDE, {"layers": (128, 128)}),
        ("gail(mean=True,layers=(8,))", "gail+layers-8x+mean-True", {"layers": (8,), "mean": True}),
        ("gail(layers=())", "gail+layers-x", {"layers": ()}),
        ("csil(floor=-0.5)", "csil+floor--0.5", {"floor": -0.5}),
        ("bc(learning_rate=1e-5, batch=64)", "bc+batch-64+learning_rate-1e-05", None),
        ("gail(learning_rate=2.0)", "gail+learning_rate-2", {"learning_rate": 2.0}),
        ("gail()", "gail", {}),
        (WIDE, WIDE, {"layers": (128, 128)}),
    ],
)
def test_a_name_says_what_differs_and_holds_the_settings(
    text: str, name: str, settings: dict[str, object] | None
) -> None:
    assert names_in(f"bc, {text} ,all") == ["bc", name, "all"]
    assert settings is None or settings_in(name) == settings
    assert name_of(name.partition("+")[0], settings_in(name)) == name


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("gail(laers=(8,))", "no setting 'laers'; did you mean 'layers'"),
        ("gail(zzz=1)", "no setting 'zzz'; there are layers,"),
        ("gail(layers=8)", "gail.layers cannot be 8: Expected `array`"),
        ("gail(layers=(0,))", "Expected `int` >= 1"),
        ("gail(mean=1)", "Expected `bool`"),
        ("gail(learning_rate=-1)", "Expected `float` > 0"),
        ("gail(layers=(8,)", "cannot be read"),
        ("gail(8)", "cannot be read"),
        ("gail(**{})", "cannot be read"),
        ("gail(mean=open('x'))", "cannot be read"),
        ("gail(mean='a/b')", "cannot be part of a row's name; name an instance"),
        ("gail(layers=((1, 2), 3))", "cannot be part of a row's name"),
        ("gail(layers=(10000, " + "10000, " * 20 + "))", "longer than 120 characters"),
        ("gial(mean=True)", "no method named 'gial'; did you mean 'gail'"),
    ],
)
def test_what_a_method_cannot_have_is_refused_in_a_line(text: str, why: str) -> None:
    with pytest.raises(BadInput) as refused:
        KNOWN.chosen_methods(text)
    assert why in str(refused.value)
    assert "\n" not in str(refused.value)


def test_each_combination_is_a_row_of_its_own_beside_the_plain_method() -> None:
    chosen = KNOWN.chosen_methods("all,gail(layers=(128,128)),gail(layers=(8,)),gail")
    assert chosen == (*METHODS, WIDE, "gail+layers-8x")
    cells = [Cell("swingup", name, 0) for name in ("gail", *chosen[-2:])]
    found = keys.cell_keys(cells, CONDITIONS, of_this_process())
    assert len({*found.values()}) == 3
    assert len({keys.task_of(key) for key in found.values()}) == 1
    wide, plain = (plugins.method_for(name, "swingup", "quick") for name in (WIDE, "gail"))
    assert vars(wide) == vars(plain) | {"layers": (128, 128)}
    assert KNOWN.entries["method"][WIDE].summary == "gail with layers=(128, 128)"
    assert not KNOWN.of_plugins("method")
    assert plugins.like(WIDE) == ("gail",)


def test_a_variant_with_settings_keeps_its_own_and_its_budget() -> None:
    KNOWN.chosen_methods("gail_mean(layers=(8,)), gail_mean(iterations=7)")
    smoke = plugins.method_for("gail_mean+layers-8x", "swingup", "smoke")
    assert vars(smoke) == vars(plugins.method_for("gail_mean", "swingup", "smoke")) | {"layers": (8,)}
    assert vars(plugins.method_for("gail_mean+iterations-7", "swingup", "smoke"))["iterations"] == 7


def test_settings_of_a_request_hold_for_all_rows_of_their_method() -> None:
    asked = RunRequest(
        methods=["gail", "gail(layers=(8,))", "bc"], settings={"gail": {"batch": 64}}, envs=["swingup"]
    )
    request, _ = resolve(asked, False)
    assert request.methods == ("bc", "gail+batch-64", "gail+batch-64+layers-8x")
    again, _ = resolve(RunRequest(methods=request.methods, envs=["swingup"]), False)
    assert again == request
    assert "--methods bc,gail+batch-64,gail+batch-64+layers-8x --envs" in command_of(request)
    assert "--plugin" not in command_of(request)


@pytest.mark.parametrize(
    ("words", "why"),
    [
        (["--set", "gail.batch=64", "--set", "gail.batch=32"], "--set gail.batch is given twice"),
        (["--set", "batch=64"], "is given as METHOD.FIELD=VALUE"),
        (["--set", "gail.batch"], "is given as METHOD.FIELD=VALUE"),
        (["--set", "bc.batch=64"], "settings are given of bc, which is not among the methods"),
        (["--set", "gail.batch=many"], "gail.batch cannot be 'many': Expected `int`"),
    ],
)
def test_set_is_refused_in_a_line(words: list[str], why: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["run", "--methods", "gail", "--envs", "swingup", "--plan", *words]) == 2
    error = capsys.readouterr().err
    assert why in error
    assert error.count("\n") == 1


@pytest.mark.parametrize("method", ["dagger", "trex", "gail"])
def test_a_method_with_settings_has_the_role_of_its_method(method: str) -> None:
    name = f"{method}+rollouts-3"
    assert role_of(name, "absorbing") == role_of(method, "absorbing")
    assert is_rival(name) is is_rival(method) is (method == "gail")


def test_a_setting_given_twice_is_refused() -> None:
    asked = RunRequest(methods=["gail(batch=8)"], settings={"gail": {"batch": 64}}, envs=["swingup"])
    with pytest.raises(BadInput, match="gail: batch is given twice"):
        resolve(asked, False)


@pytest.mark.parametrize(
    ("text", "value"), [("128,128", (128, 128)), ("1e-3", 1e-3), ("False", False), ("soft", "soft")]
)
def test_values_of_set_are_numbers_tuples_or_texts(text: str, value: object) -> None:
    assert value_in(text) == value


def test_seconds_are_expected_as_of_the_plain_method() -> None:
    KNOWN.chosen_methods("gail(layers=(128,128))")
    costs = Costs(conditions := Conditions("quick", "absorbing", "sbx"))
    wide, plain, other = (
        costs.of(Job((Cell("cartpole", name, 0),), False, conditions, "")) for name in (WIDE, "gail", "bc")
    )
    assert wide == plain != other


def test_a_plugins_method_has_its_settings_checked_in_its_own_process(tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text(MINE)
    asked = RunRequest(
        methods=["mine(layers=(8,))"], settings={"mine": {"steps": 9}}, envs=["swingup"],
        plugins=[tmp_path / "mine.py"],
    )  # fmt: skip
    request, _ = resolve(asked, False)
    assert request.methods == ("mine+layers-8x+steps-9",)
    assert [one.name for one in plugins.needed(request.methods, [])] == [str(tmp_path / "mine.py")]
    for settings, why in (({"step": 9}, "did you mean 'steps'"), ({"steps": "a"}, "Expected `int`")):
        with pytest.raises(BadInput, match=why):
            resolve(RunRequest(**(vars(asked) | {"settings": {"mine": settings}})), False)


@pytest.mark.usefixtures("here")
def test_an_instance_is_a_method_with_the_budget_of_its_class(tmp_path: Path) -> None:
    more = 'METHODS |= {"deep": Mine(layers=(9, 9)), "own": BehaviourCloning(steps=7)}\n'
    (tmp_path / "mine.py").write_text(MINE + more)
    plugins.add([str(tmp_path / "mine.py")])
    smoke = plugins.method_for("deep", "swingup", "smoke")
    assert (vars(smoke)["layers"], vars(smoke)["steps"]) == ((9, 9), 30)
    assert vars(plugins.method_for("own", "swingup", "smoke"))["steps"] == 7
    assert plugins.like("own") == ("bc",)
    KNOWN.chosen_methods("own(batch=8)")
    assert vars(plugins.method_for("own+batch-8", "swingup", "smoke")) == vars(
        plugins.method_for("own", "swingup", "smoke")
    ) | {"batch": 8}


@pytest.mark.parametrize("method", [*METHODS, *VARIANTS])
def test_what_is_searched_can_be_set(method: str) -> None:
    thing = KNOWN.thing("method", method)
    for field, search in searched(thing).items():
        for end in search.values:
            name = f"{method}+{field}-{end}" if search.kind == "choice" else name_of(method, {field: end})
            assert typed(method, thing, settings_in(name)).keys() == {field}
    assert "layers" not in searched(KNOWN.thing("method", "csil"))  # its clone has the actor's shape
