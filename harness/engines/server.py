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
from types import FrameType
from typing import Self

import psutil

from harness.engines.containment import adopt_orphans, kill_children_but, kill_descendants
from harness.registry import BadInput

SIZE = 8
"""Bytes of a request, and of an answer."""
UNKNOWN = 1 << 32
"""The answer where no exit code is known, of a worker of a server that was killed."""
_running: set[Server] = set()


class Server:
    """The run's side of the server, for any of its threads. A server that was killed is started again.

    variables: the environment of the server and its workers. modules: modules that it imports.
    Elsewhere than on Linux it imports none: a process that has imported libraries cannot be forked safely
    there. Raises BadInput where no process can be started.
    """

    def __init__(self, variables: Mapping[str, str], modules: Sequence[str]) -> None:
        if not hasattr(os, "fork"):
            raise BadInput("this system cannot fork processes; add --engine inline")
        self._variables, self._modules = variables, modules if sys.platform == "linux" else ()
        self._lock, self._closed = threading.Lock(), False
        try:
            self._start()
        except OSError as error:
            self._socket.close()
            raise BadInput(f"no process can be started: {error.strerror}") from error

    def _start(self) -> None:
        self._socket, theirs = socket.socketpair()
        path = [folder or os.getcwd() for folder in sys.path]
        request = json.dumps([theirs.fileno(), path, list(self._modules)])
        with theirs:
            self._process = subprocess.Popen(
                [sys.executable, "-P", "-m", "harness.engines.server", request],
                env=self._variables,
                stdin=subprocess.DEVNULL,
                pass_fds=[theirs.fileno()],
                start_new_session=True,
            )

    def __enter__(self) -> Self:
        _running.add(self)
        return self

    def __exit__(self, *error: object) -> None:
        _running.discard(self)
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
        with self._lock, theirs:
            if self._process.poll() is not None and not self._closed:
                self._socket.close()
                self._start()
            pid = self._ask(0, [theirs.fileno()])
        if pid < 0:
            raise OSError(-pid, os.strerror(-pid))
        return pid, ours

    def exit_code(self, pid: int) -> int | None:
        """Return the exit code of a worker, once it has ended; None where that is not known."""
        with self._lock, contextlib.suppress(OSError, EOFError):
            if (code := self._ask(pid)) != UNKNOWN:
                return code
        return None

    def _ask(self, number: int, files: Sequence[int] = ()) -> int:
        if self._closed:
            raise EOFError
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

    def signal_workers(self, number: int) -> None:
        """Send a signal to all workers and to what they started."""
        with contextlib.suppress(psutil.Error):
            for process in psutil.Process(self._process.pid).children(recursive=True):
                with contextlib.suppress(psutil.Error):
                    process.send_signal(number)


def suspend_workers_too() -> None:
    """Make Ctrl-Z suspend workers, which are in sessions of their own, until this process goes on."""
    if not hasattr(signal, "SIGTSTP") or signal.getsignal(signal.SIGTSTP) != signal.SIG_DFL:
        return

    def suspend(number: int, frame: FrameType | None) -> None:
        for server in _running:
            server.signal_workers(signal.SIGSTOP)
        signal.signal(number, signal.SIG_DFL)
        os.kill(os.getpid(), number)
        signal.signal(number, suspend)
        for server in _running:
            server.signal_workers(signal.SIGCONT)

    signal.signal(signal.SIGTSTP, suspend)


class _Forks:
    """The server's own side. codes: the exit codes of its workers, None while they run."""

    def __init__(self, control: socket.socket) -> None:
        self.control = control
        self.codes: dict[int, int | None] = {}

    def serve(self) -> None:
        """Answer requests until the run has ended."""
        signal.signal(signal.SIGCHLD, self._reap)
        signal.pthread_sigmask(signal.SIG_SETMASK, [])
        with contextlib.suppress(ConnectionError):
            while True:
                request, files, _, _ = socket.recv_fds(self.control, SIZE, 1)
                if not request:
                    return
                number = int.from_bytes(request, "little")
                answer = self._exit_code(number) if number else self._fork(*files)
                self.control.sendall(answer.to_bytes(SIZE, "little", signed=True))

    def _reap(self, number: int, frame: FrameType | None) -> None:
        """Keep the exit codes of workers that ended, and end what they left behind."""
        with contextlib.suppress(ChildProcessError):
            while (ended := os.waitpid(-1, os.WNOHANG))[0]:
                self._note(*ended)
                kill_children_but([pid for pid, code in self.codes.items() if code is None])

    def _note(self, pid: int, status: int) -> None:
        if pid in self.codes:
            self.codes[pid] = os.waitstatus_to_exitcode(status)

    def _exit_code(self, pid: int) -> int:
        with contextlib.suppress(ChildProcessError):  # where the end was noted already
            self._note(*os.waitpid(pid, 0))
        code = self.codes.pop(pid, None)
        return UNKNOWN if code is None else code

    def _fork(self, file: int) -> int:
        signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGCHLD})  # until the worker is known
        try:
            pid = os.fork()
            if not pid:
                self._become_worker(file)
            self.codes[pid] = None
        except OSError as error:
            return -(error.errno or 1)
        finally:
            os.close(file)
            signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGCHLD})
        return pid

    def _become_worker(self, file: int) -> None:
        code = 1
        try:
            signal.signal(signal.SIGCHLD, signal.SIG_DFL)
            signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGCHLD})
            self.control.close()
            importlib.import_module("harness.engines.worker").serve(Connection(file))
            code = 0
        finally:
            os._exit(code)


def main(file: int, path: list[str], modules: Sequence[str]) -> None:
    """Be the server on the socket of this file until the run has ended."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    adopt_orphans()
    sys.path += [folder for folder in path if folder not in sys.path]
    for name in modules:
        # Whatever this raises, a cell's own import raises again, and the cell says so.
        with contextlib.suppress(BaseException):
            importlib.import_module(name)
    # To look through what is there by now for garbage would take each cell time, and its own memory.
    gc.freeze()
    try:
        _Forks(socket.socket(fileno=file)).serve()
    finally:
        kill_descendants()
        os._exit(0)


if __name__ == "__main__":
    main(*json.loads(sys.argv[1]))
