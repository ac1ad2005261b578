"""What a run does beside computing, on a system without what Windows lacks."""

import subprocess
import sys

from tests.harness.fake_runs import FAKE_ENV

LACKS = """
import os, signal, sys
import concurrent.futures.process, multiprocessing.forkserver, numpy, pebble.concurrent, psutil, filelock
kept = {"SIGINT", "SIGTERM", "SIGABRT", "SIGFPE", "SIGILL", "SIGSEGV"}
for name in [name for name in dir(signal) if name.startswith("SIG") and name[3] != "_"]:
    if name not in kept:
        delattr(signal, name)
del signal.pthread_sigmask
signal.valid_signals = lambda: {getattr(signal, name) for name in kept}
calls = "geteuid", "getuid", "setsid", "killpg", "sched_getaffinity", "set_blocking"
for name in (*calls, "O_NOFOLLOW", "O_NONBLOCK"):
    delattr(os, name)
sys.modules |= dict.fromkeys(("fcntl", "resource", "pwd", "grp", "termios"))
"""
WORKS = """
from pathlib import Path
import harness.cli, harness.cli.commands, harness.cli.exchange, harness.engines.processes
from harness.engines import scratch
from harness.process import signals, streams
from harness.store import files
harness.cli.commands.handle_signals()
assert set(signals.STOPS) == {signal.SIGINT, signal.SIGTERM}
streams.install()
with scratch.scratch_folder() as folder:
    files.write_atomic(folder / "file", "text")
    assert files.read(folder / "file") == b"text"
    scratch.remove_abandoned(folder.parent)
assert not folder.exists()
assert harness.cli.main.main(["list"]) == 0
"""


def test_commands_are_imported_and_files_written_where_posix_is_not() -> None:
    done = subprocess.run(
        [sys.executable, "-c", LACKS + WORKS], env=FAKE_ENV, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert "gridworld" in done.stdout
