"""The processes that cells run in."""

import signal
import threading
from multiprocessing.process import BaseProcess

from harness.processes import NAME, fresh_processes

WATCHERS = 8


def test_whoever_asks_is_told_how_a_process_ended() -> None:
    with fresh_processes(()) as context:
        for _ in range(5):
            process = context.Process(name=NAME, target=signal.raise_signal, args=(signal.SIGKILL,))  # type: ignore[attr-defined]
            process.start()
            assert _exit_codes(process) == {-signal.SIGKILL}


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
