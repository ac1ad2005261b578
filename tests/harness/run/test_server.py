"""The process that those of cells are forked from ends them all when the run is gone."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import psutil

ROOT = Path(__file__).parents[3]
SERVER = """
import os, signal, sys, time
import psutil
from harness.run import orphans, server

if os.fork() == 0:  # a cell
    os.setsid()
    started = os.fork()
    if started:
        print(started, flush=True)
    time.sleep(60)
    os._exit(0)

kill = psutil.Process.kill

def killed(process):
    kill(process)
    if process.ppid() == os.getpid():
        os.waitpid(process.pid, 0)
    os.kill(os.getpid(), signal.SIGUSR1)  # as another thread of the run ends

psutil.Process.kill = killed
time.sleep(60)
"""


def test_of_a_run_whose_threads_end_one_by_one_no_process_is_left() -> None:
    process = subprocess.Popen(
        [sys.executable, "-c", SERVER],
        cwd=ROOT,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        stdout=subprocess.PIPE,
        text=True,
    )
    assert process.stdout
    left = psutil.Process(int(process.stdout.readline()))
    process.stdout.close()
    try:
        process.send_signal(signal.SIGUSR1)
        assert process.wait(20) == 1
        deadline = time.monotonic() + 5
        while left.is_running() and left.status() != psutil.STATUS_ZOMBIE:
            assert time.monotonic() < deadline
            time.sleep(0.02)
    finally:
        process.kill()
        if left.is_running():
            left.kill()
