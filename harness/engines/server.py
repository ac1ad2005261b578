"""The server that workers are forked from, a process that has imported what all of them need.

Run and server share a Unix socket. A request is a number: 0 with the file of a connection for a new worker,
or the process number of a worker that has ended. The answer is the new worker's process number, an error of
the system as a number below 0, or the exit code. The socket closes when the run ends, in whatever way. Then
the server ends all workers, what they started, and itself.
"""

from __future__ import annotations

import contextlib
import gc
import importlib
import json
import multiprocessing
import os
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Mapping, Sequence
from multiprocessing.connection import Connection
from typing import Self

import psutil

from harness.engines.containment import adopt_orphans, kill_descendants
from harness.registry import BadInput

SIZE = 8
"""Bytes of a request, and of an answer."""
UNKNOWN = 1 << 32
"""The answer where no exit code is known, of a worker of a server that was killed."""


class Server:
    """The run's side of the server, for any of its threads. A server that was killed is started again.

    variables: the environment of the server and its workers. modules: modules that it imports.
    Raises BadInput where no process can be started.
    """

    def __init__(self, variables: Mapping[str, str], modules: Sequence[str]) -> None:
        self._variables, self._modules = variables, modules
        self._lock, self._closed = threading.Lock(), False
        try:
            self._start()
        except OSError as error:
            raise BadInput(f"no process can be started: {error.strerror}") from error

    def _start(self) -> None:
        ours, theirs = socket.socketpair()
        path = [folder or os.getcwd() for folder in sys.path]
        request = json.dumps([theirs.fileno(), path, list(self._modules)])
        with theirs, contextlib.ExitStack() as stack:
            stack.callback(ours.close)
            self._process = subprocess.Popen(
                [sys.executable, "-P", "-m", "harness.engines.server", request],
                env=self._variables,
                stdin=subprocess.DEVNULL,
                pass_fds=[theirs.fileno()],
                start_new_session=True,
            )
            stack.pop_all()
        self._socket = ours

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self._closed = True
        self._process.send_signal(signal.SIGSTOP)  # It forks no more, and still adopts orphans.
        kill_descendants(self._process.pid)
        self._process.kill()
        self._process.wait()
        with self._lock:
            self._socket.close()

    def fork(self) -> tuple[int, Connection]:
        """Return the number of a new worker and the connection to it. Raises OSError where the system allows
        none, and EOFError where the server was killed."""
        ours, theirs = multiprocessing.Pipe()
        with theirs:
            pid = self._ask(0, [theirs.fileno()])
        if pid < 0:
            raise OSError(-pid, os.strerror(-pid))
        return pid, ours

    def exit_code(self, pid: int) -> int | None:
        """Return the exit code of a worker that has ended, once; None where that is not known. Processes that
        it left behind are killed."""
        with contextlib.suppress(OSError, EOFError):
            if (code := self._ask(pid)) != UNKNOWN:
                return code
        return None

    def _ask(self, number: int, files: Sequence[int] = ()) -> int:
        with self._lock:
            if self._closed:
                raise EOFError
            if not number and self._process.poll() is not None:
                self._socket.close()
                self._start()
            self.wake()
            try:
                socket.send_fds(self._socket, [number.to_bytes(SIZE, "little")], files)
                answer = self._socket.recv(SIZE, socket.MSG_WAITALL)
            except ConnectionError as error:
                raise EOFError from error
        if not answer:
            raise EOFError
        return int.from_bytes(answer, "little", signed=True)

    def wake(self) -> None:
        """Let the server go on, which a cell may have suspended."""
        self._process.send_signal(signal.SIGCONT)


def main(file: int, path: list[str], modules: Sequence[str]) -> None:
    """Be the server on the socket of this file until the run has ended."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGCHLD, signal.SIG_DFL)  # Ignored, it hides how processes end.
    signal.pthread_sigmask(signal.SIG_SETMASK, [])
    adopt_orphans()
    sys.path += [folder for folder in path if folder not in sys.path]
    for name in modules:
        # Whatever this raises, a cell's own import raises again, and the cell says so.
        with contextlib.suppress(BaseException):
            importlib.import_module(name)
    # To look through what is there by now for garbage would take each cell time, and its own memory.
    gc.freeze()
    try:
        _serve(socket.socket(fileno=file))
    finally:
        kill_descendants()
        os._exit(0)


def _serve(control: socket.socket) -> None:
    """Answer requests until the run has ended."""
    workers = set[int]()
    with contextlib.suppress(ConnectionError):
        while True:
            request, files, _, _ = socket.recv_fds(control, SIZE, 1)
            if not request:
                return
            if number := int.from_bytes(request, "little"):
                workers.discard(number)
                answer = _exit_code(number)
                _kill_children_but(workers)
            else:
                answer = _fork(files[0], control)
                workers.add(answer)
            control.sendall(answer.to_bytes(SIZE, "little", signed=True))


def _exit_code(pid: int) -> int:
    """Return the exit code of a worker, which has ended, or is about to."""
    with contextlib.suppress(ChildProcessError):
        return os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])
    return UNKNOWN


def _kill_children_but(workers: set[int]) -> None:
    """Kill what workers that ended have left: the other children of this process, whose own children become
    this process's."""
    while strangers := [child for child in psutil.Process().children() if child.pid not in workers]:
        for child in strangers:
            with contextlib.suppress(psutil.Error):
                child.kill()
            _exit_code(child.pid)


def _fork(file: int, control: socket.socket) -> int:
    """Return the number of a new worker at the connection of this file, or an error below 0."""
    with Connection(file) as connection:
        try:
            pid = os.fork()
        except OSError as error:
            return -(error.errno or 1)
        if pid:
            return pid
        code = 1
        try:
            control.close()
            importlib.import_module("harness.engines.worker").serve(connection)
            code = 0
        finally:
            os._exit(code)


if __name__ == "__main__":
    main(*json.loads(sys.argv[1]))
