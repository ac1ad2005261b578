"""The command line: what it promises, what it refuses, and that nothing finished is ever lost."""

import dataclasses
import functools
import itertools
import os
import resource
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from harness import registry
from harness.cli import main as cli
from harness.store.opening import open_for_run
from methods.settings import settings_for
from tests.harness.fake_runs import FAKE_ENV
from tests.harness.small_runs import REQUEST

HEAVY = {"torch", "numpy", "gymnasium", "pandas", "rich", "pebble", "matplotlib"}
Main = Callable[..., tuple[int, str, str]]


@pytest.mark.parametrize("command", [["list"], ["--help"], ["run", "--help"]])
def test_help_and_list_import_nothing_heavy_and_answer_in_half_a_second(command: list[str]) -> None:
    code = (
        f"import sys; from harness.cli.main import main; main({command}); print({HEAVY} & sys.modules.keys())"
    )
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    done = subprocess.run(
        [sys.executable, "-c", code], env=FAKE_ENV, capture_output=True, text=True, check=True
    )
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    assert done.stdout.splitlines()[-1] == "set()"
    # Processor time, since the machine may be busy with other things.
    assert after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime < 0.5
    names = [*registry.METHODS, *registry.VARIANTS]
    assert all(name in done.stdout for name in names) or command == ["--help"]


def test_the_registry_tells_the_truth() -> None:
    import envs

    tasks = registry.ENVS | registry.OTHER_ENVS
    assert {n: (registry.SPECS[n].summary, (*registry.SPECS[n].variants,)) for n in tasks} == {
        n: (e.summary, e.variants) for n, e in tasks.items()
    }
    assert envs.BUDGETS == registry.BUDGETS
    for name in (*registry.METHODS, *registry.VARIANTS):
        method = registry.load_method(name)
        assert dataclasses.is_dataclass(method)
        for env, budget in itertools.product(tasks, registry.BUDGETS):
            method(**settings_for(name, env, budget))
    with pytest.raises(registry.BadInput, match="did you mean 'maxmargin'"):
        registry.load_method("maxmagin")


@pytest.mark.parametrize(
    ("limit", "command", "said"),
    [
        ("-v 600000", "run --methods bc --envs gridworld --out", "`run` needs 4,500,000 KB of memory"),
        ("-v 2000000", "report", "`report` needs 4,500,000 KB of memory"),
        ("-v 300000", "compare . ", "`compare` needs 1,500,000 KB of memory"),
        ("-d 300000", "run --methods bc --envs gridworld --out", "`run` needs 500,000 KB of memory"),
    ],
)
def test_under_a_limit_of_memory_a_command_is_done_or_one_line(
    limit: str, command: str, said: str, tmp_path: Path
) -> None:
    with open_for_run(tmp_path, REQUEST):
        pass
    line = f'ulimit {limit}; exec {sys.executable} -m harness {command} "$0"'
    done = subprocess.run(
        ["bash", "-c", line, tmp_path], env=FAKE_ENV, capture_output=True, text=True, check=False
    )
    assert said in done.stdout + done.stderr
    assert (done.stdout + done.stderr).count("\n") == 1
    assert done.returncode == 2
    assert sorted(os.listdir(tmp_path)) == [".lock", "run.sqlite"]


def test_variants_run_when_named_and_not_in_all() -> None:
    choose = functools.partial(registry.choose, "method", known=registry.METHODS, variants=registry.VARIANTS)
    assert choose("all") == tuple(registry.METHODS)
    assert choose("maxent_linear, bc") == ("bc", "maxent_linear")
    assert choose("maxmargin_projection,all") == (*registry.METHODS, "maxmargin_projection")
    assert not registry.METHODS.keys() & registry.VARIANTS.keys()
    assert registry.load_method("maxmargin_projection") is registry.load_method("maxmargin")
    settings = settings_for("maxmargin_projection", "cartpole", "quick")
    assert registry.load_method("maxmargin_projection")(**settings).projection
    with pytest.raises(registry.BadInput, match="did you mean 'maxent_linear'"):
        choose("maxent_liner")


@pytest.mark.parametrize(
    ("typed", "again"),
    [
        ("/venv/bin/irl-bench", "/venv/bin/irl-bench run"),
        ("/home/me/irl-bench/harness/__main__.py", f"{sys.executable} -m harness run"),
    ],
)
def test_who_stops_a_run_is_told_how_to_go_on(
    typed: str, again: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def stopped(argv: list[str]) -> int:
        raise KeyboardInterrupt

    monkeypatch.setattr(cli, "_dispatch", stopped)
    monkeypatch.setattr(cli, "ignore_stops", lambda: None)
    monkeypatch.setattr(sys, "argv", [typed, "run"])
    assert cli.main() == 130
    report = f"{again.removesuffix(' run')} report results/latest"
    assert capsys.readouterr().err.endswith(
        f"To go on, run the same again:\n  {again}\nFor a report of what is finished:\n  {report}\n"
    )
    monkeypatch.setattr(sys, "argv", [typed, "run", "--plan"])
    assert cli.main() == 130
    assert capsys.readouterr().err.endswith("stopped; nothing is kept\n")


@pytest.mark.parametrize(
    ("argv", "message"),
    [
        ("run --methods AIRL,GAIL,DAgger", "; did you mean 'airl', 'gail', 'dagger'?\n"),
        ("run --methods maxmagin", "no method named 'maxmagin'; did you mean 'maxmargin'?"),
        ("run --methods f-irl,GIAL", "no method named 'f-irl', 'GIAL'; did you mean 'f_irl', 'gail'?"),
        ("run --methods gial,foo", "no method named 'gial', 'foo'; there are shaped, shaped_ml"),
        ("run --methods bc,,shaped", "no method named: give 'all' or some of shaped"),
        ("run --envs cart", "no env named 'cart'; did you mean 'cartpole'?"),
        ("run --envs cartpol,highway", "no env named 'cartpol'; did you mean 'cartpole'?"),
        ("run --envs zzz", "no env named 'zzz'; there are cartpole, pendulum, highway"),
        ("run --seeds 0", "argument --seeds: must lie between 1 and 1000, not 0"),
        ("run --cell-timeout 0", "argument --cell-timeout: must lie between 1 and 1000000, not 0"),
        ("run --seeds -1", "argument --seeds: must lie between 1 and 1000, not -1"),
        ("run --seeds 3-1", "argument --seeds: '3-1' ends before it begins"),
        ("run --seeds 1-1000", "argument --seeds: must lie between 0 and 999, not 1000"),
        ("run --seeds " + "9" * 5000, "argument --seeds"),
        ("run --solves 0", "argument --solves: must lie between 1 and 1000, not 0"),
        ("run --solves 2 --no-retrain", "--solves is how often RL solves R*; leave out --no-retrain\n"),
        ("run --learner sac", "invalid choice: 'sac'"),
        (
            "run --envs swingup,gridworld --learner ddpg",
            "of gridworld are choices, and DDPG has none",
        ),
        ("run --envs cartpole --encoder small", "cartpole has no images for --encoder"),
        (
            "run --envs swingup_pixels --encoder smal",
            "--encoder must be small, nature or module:Class, not 'smal'",
        ),
        ("run --envs swingup_pixels --encoder no_such:Class", "no module 'no_such' for --encoder: install"),
        ("run --envs swingup_pixels --encoder envs.encoders:No", "encoders.py has no 'No' for --encoder"),
        ("demos export --env drive --to a.npz", "drive observes features of an encoder, which no file"),
        ("run --budget huge", "invalid choice: 'huge'"),
        ("run --rl torch", "invalid choice: 'torch'"),
        ("run --envs swingup --action-bounds=-1e-320,1e-320", "is not a lower number and a higher one"),
        ("check all", "give methods and envs one by one, with spaces between, not 'all'"),
        ("check swingup,bc", "not 'swingup,bc'"),
        ("run --envs swingup --action-bounds=-2,2", "--action-bounds is for demonstrations of a file"),
        ("experts train swingup --budget quick", "leave out --budget: experts of swingup are trained as"),
        ("experts train gym:Pendulum-v1 --dir mine", "leave out --dir: gym_Pendulum-v1 is trained one"),
        ("run --plan --json-progress", "a plan is text; leave out --json-progress"),
        ("run --out mine", "mine is not empty and holds no run"),
        ("run --out mine/file", "cannot use 'mine/file'"),
        ("run --out bad\0name", "a folder is needed, not 'bad"),
        ("report", "required: DIR"),
        ("report nowhere", "nowhere holds no run"),
        ("walk", "invalid choice: 'walk'"),
        ("", "required: command"),
    ],
)
def test_bad_input_is_one_clear_line_and_writes_nothing(
    main: Main, tmp_path: Path, argv: str, message: str
) -> None:
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine/file").write_text("precious")
    code, out, err = main(*argv.split(" ") if argv else ())
    assert (code, out) == (2, "")
    assert err.startswith("irl-bench: error: ")
    assert message in err
    assert err.count("\n") == 1
    assert sorted(path.name for path in tmp_path.rglob("*")) == ["file", "mine"]
