"""The processes that cells run in."""

import json
import os
import signal
import threading
import time
from collections.abc import Iterator
from multiprocessing import reduction, resource_tracker
from multiprocessing.process import BaseProcess
from pathlib import Path

import psutil
import pytest
from harness.run.engines import Inline
from harness.run.processes import NAME, fresh_processes

from harness.run.cache import COMPILED_VARIABLE, compiled_once
from harness.run.environment import CACHE_VARIABLE, FIXED, SAME_INSTRUCTIONS
from harness.run.signals import STOPS, stop_cleanly, stops_wait

WATCHERS = 8


def test_whoever_asks_is_told_how_a_process_ended() -> None:
    with fresh_processes("harness.judge.results") as context:
        for _ in range(5):
            process = context.Process(name=NAME, target=signal.raise_signal, args=(signal.SIGKILL,))  # type: ignore[attr-defined]
            process.start()
            assert _exit_codes(process) == {-signal.SIGKILL}


def test_nothing_of_them_is_left(tmp_path: Path) -> None:
    before = os.environ.copy()
    folders = set()
    for deterministic in (True, False):
        with fresh_processes("harness.judge.results", deterministic) as context:
            process = context.Process(name=NAME, target=_tell, args=(tmp_path / "told",))  # type: ignore[attr-defined]
            process.start()
            process.join()
            told = json.loads((tmp_path / "told").read_text())
            assert told["XLA_FLAGS"] == (SAME_INSTRUCTIONS if deterministic else FIXED)["XLA_FLAGS"]
            folders.add(told["TMPDIR"])
        assert psutil.Process().children(recursive=True) == [_resource_tracker()]
        assert os.environ == before
    assert len(folders) == 2
    assert not any(map(os.path.exists, folders))


def test_what_one_process_compiles_the_next_run_loads(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv(COMPILED_VARIABLE, raising=False)
    monkeypatch.setenv(CACHE_VARIABLE, str(tmp_path / "cache"))
    before = {*os.environ}
    loaded = []
    for _ in range(2):
        with fresh_processes("harness.judge.results") as context:
            process = context.Process(name=NAME, target=_compile, args=(tmp_path / "told",))  # type: ignore[attr-defined]
            process.start()
            process.join()
        loaded.append((tmp_path / "told").read_text())
    assert loaded == ["False", "True"]
    with Inline():
        assert os.environ[COMPILED_VARIABLE] == str(*(tmp_path / "cache").iterdir())
    assert {*os.environ} == before
    monkeypatch.setenv(COMPILED_VARIABLE, "mine")
    assert compiled_once()[COMPILED_VARIABLE] == "mine"


def test_where_the_cache_cannot_be_written_to_a_run_compiles_for_itself(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv(COMPILED_VARIABLE, raising=False)
    (tmp_path / "cache").write_text("a file")
    monkeypatch.setenv(CACHE_VARIABLE, str(tmp_path / "cache"))
    assert compiled_once(tmp_path / "spare")[COMPILED_VARIABLE] == str(tmp_path / "spare")
    assert compiled_once() == {}


@pytest.fixture
def interruptible() -> Iterator[None]:
    """Every stop interrupts, also where the tests themselves run in the background, deaf to them."""
    before = {number: signal.signal(number, signal.default_int_handler) for number in STOPS}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


@pytest.mark.usefixtures("interruptible")
def test_whatever_would_end_a_run_stops_it_cleanly_once() -> None:
    ending = {signal.SIGHUP, signal.SIGQUIT, signal.SIGUSR1, signal.SIGUSR2, signal.SIGALRM, signal.SIGXCPU}
    assert ending <= {*STOPS}
    for number in STOPS:
        for other in STOPS:
            signal.signal(other, signal.SIG_DFL)
        stop_cleanly()
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(number)
        signal.raise_signal(number)


@pytest.mark.usefixtures("interruptible")
def test_a_handler_of_another_program_stays() -> None:
    came: list[int] = []
    signal.signal(signal.SIGUSR2, lambda number, frame: came.append(number))
    stop_cleanly()
    signal.raise_signal(signal.SIGUSR2)
    assert came == [signal.SIGUSR2]


@pytest.mark.usefixtures("interruptible")
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGUSR1])
def test_a_stop_amid_the_start_of_a_process_is_no_traceback(
    number: signal.Signals, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    send = reduction.sendfds

    def stopped_amid(*arguments: object) -> None:
        signal.raise_signal(number)
        send(*arguments)

    monkeypatch.setattr(reduction, "sendfds", stopped_amid)
    stop_cleanly()
    with fresh_processes("harness.judge.results") as context:
        with pytest.raises(KeyboardInterrupt):
            context.Process(name=NAME, target=print).start()  # type: ignore[attr-defined]
        time.sleep(0.5)  # for whatever its server would say
    assert capfd.readouterr().err == ""


@pytest.mark.usefixtures("interruptible")
def test_what_is_ignored_stays_so_while_stops_wait() -> None:
    signal.signal(signal.SIGHUP, signal.SIG_IGN)
    with stops_wait():
        signal.raise_signal(signal.SIGHUP)
    assert signal.getsignal(signal.SIGHUP) == signal.SIG_IGN
    assert signal.getsignal(signal.SIGINT) == signal.default_int_handler
    came = []
    with pytest.raises(KeyboardInterrupt), stops_wait():
        came += [signal.raise_signal(signal.SIGINT) for _ in range(2)]
    assert len(came) == 2


def _compile(file: Path) -> None:
    """Tell whether a program was loaded that an earlier process had compiled."""
    import jax

    loaded = list[str]()
    jax.monitoring.register_event_listener(lambda event, **_: loaded.append(event))
    jax.jit(lambda x: x * 3 + 1)(2.0)
    file.write_text(str("/jax/compilation_cache/cache_hits" in loaded))


def _tell(file: Path) -> None:
    file.write_text(json.dumps(dict(os.environ)))


def _resource_tracker() -> psutil.Process:
    """Python's own; one for the whole life of a process."""
    return psutil.Process(resource_tracker._resource_tracker._pid)  # type: ignore[attr-defined]


def _exit_codes(process: BaseProcess) -> set[int | None]:
    found: set[int | None] = set()
    together = threading.Barrier(WATCHERS)

    def watch() -> None:
        together.wait()
        while (code := process.exitcode) is None:
            pass
        found.add(code)

    watchers = [threading.Thread(target=watch) for _ in range(WATCHERS)]
    for watcher in watchers:
        watcher.start()
    for watcher in watchers:
        watcher.join()
    return found
