"""The engine of runs on many machines: cells are tasks of a Ray cluster, computed there in processes.

Only the driver, this process, reads or writes the run's directory. The program, plug-ins and shipped experts
travel as the tasks' working directory, what cells share travels through Ray's object store, and results and
recordings come back as bytes. No other file system is shared.

Ray would wait for ever for a head that is lost, or end this process. So the driver looks after the head, and
ends the run.
"""

from __future__ import annotations

import contextlib
import functools
import os
import signal
import socket
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import psutil

from harness.cell import given
from harness.cell.phases import Phase
from harness.engines.cell_environment import write_program
from harness.engines.compute import describe
from harness.engines.containment import descendants
from harness.engines.jobs import WORK, Job, Outcome
from harness.engines.processes import Processes
from harness.engines.scratch import scratch_folder
from harness.process.environment import CHOSEN, numeric, of_user
from harness.records import LEARNED, RESULT
from harness.registry import BadInput, Unfinished, packing
from harness.registry.packages import to_install
from harness.store.files import write_atomic

LOOK_EVERY = 1.0
"""Seconds between looks for tasks that ended."""
SILENCE = 20.0
"""Seconds without an answer after which the cluster's head is lost."""
PATIENCE = 10.0
"""Seconds that the head has for its first answer, and Ray to leave the cluster."""
DRIVERS = {"RAY_USAGE_STATS_ENABLED": "0", "RAY_gcs_rpc_server_reconnect_timeout_s": str(10**6)}
"""Variables with which Ray sends nothing home, and does not end this process where the head is lost."""
LOOPBACK = {"RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER": "0"}
"""The variable with which a cluster that is started here listens on 127.0.0.1 alone."""
DEMONSTRATIONS = "demonstrations of a file"
"""The name of those among the inputs of a job."""


class Ray:
    """Cells on a Ray cluster, or on one that is started on this machine and ends with the run.

    `address`: the address of the cluster's head, or 'auto'; '' starts a cluster.
    `workers`: tasks at a time. None stands for the CPUs of the cluster, counted anew while the run goes on.
    The others: as of `Processes`.
    Raises BadInput where Ray is not installed, or no cluster can be reached.
    """

    def __init__(
        self,
        address: str,
        workers: int | None,
        timeout: float | None = None,
        deterministic: bool = True,
        modules: Sequence[str] = (),
        work: str = WORK,
    ) -> None:
        host, _, port = address.rpartition(":")
        if not (address in ("", "auto") or (host and port.isdecimal())):
            message = f"--address is HOST:PORT of the head of a Ray cluster, or auto, not {address!r:.80}"
            raise BadInput(message, page="cluster")
        local = not address or host in ("127.0.0.1", "localhost")
        os.environ |= DRIVERS | (LOOPBACK if local else {})  # which Ray reads as it is imported
        try:
            import ray
        except ImportError as error:
            raise BadInput(f"Ray is not installed: {to_install('ray')}", page="cluster") from error
        if host:  # Ray would wait for minutes for one that does not answer.
            try:
                socket.create_connection((host, int(port)), PATIENCE).close()
            except (OSError, OverflowError) as error:
                message = f"no Ray cluster answers at {address}: {error}"
                raise BadInput(message, page="cluster") from error
        self._ray: Any = ray
        self.variables = numeric(deterministic)
        self._address, self._workers = address, workers
        self._settings = timeout, deterministic, tuple(modules), work
        self._running: dict[Any, Job] = {}
        self._shared: dict[tuple[str, int], dict[str, Any]] = {}
        """References to what cells of an environment and a seed share."""

    @property
    def workers(self) -> int:
        return self._workers or self._cpus

    def __enter__(self) -> Self:
        with ExitStack() as stack:
            folder = stack.enter_context(scratch_folder()) / "program"
            write_program(folder)
            self._packed = packing.packed(folder)
            stack.enter_context(self._connected(folder))
            remote = self._ray.remote(num_cpus=1, max_retries=0)
            self._begin: Callable[..., Any] = remote(compute_there).remote
            self._left = threading.Event()
            self._count()
            # In a thread, for Ray waits without an end for a head that is lost.
            threading.Thread(target=self._keep_counting, daemon=True).start()
            stack.callback(self._left.set)
            self._stack = stack.pop_all()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for reference in self._running:
            with contextlib.suppress(Exception):
                self._ray.cancel(reference, force=True)
        self._running.clear()
        self._shared.clear()
        self._stack.__exit__(kind, error, trace)

    @contextmanager
    def _connected(self, program: Path) -> Iterator[None]:
        """Be part of the cluster, or of one that is started here, until the context ends."""
        variables = {name: os.environ[name] for name in CHOSEN if name in os.environ} | of_user()
        options: dict[str, Any] = {"log_to_driver": False, "logging_level": "error"}
        options["runtime_env"] = {"working_dir": str(program), "env_vars": variables}
        options["address"] = self._address or "local"
        if not self._address:
            options |= {"include_dashboard": False, "num_cpus": self._workers}
        before, terminated = descendants(), signal.getsignal(signal.SIGTERM)
        try:
            self._ray.init(**options)
        except (self._ray.exceptions.RayError, RuntimeError, ValueError, OSError) as error:
            reason = " ".join(str(error).split())
            raise BadInput(f"no Ray cluster {self._address}: {reason}", page="cluster") from error
        if threading.current_thread() is threading.main_thread():
            signal.signal(signal.SIGTERM, terminated)  # which Ray has replaced
        own = [] if self._address else [one for one in descendants() if one not in before]
        try:
            yield
        finally:
            started = [*own, *(other for one in own for other in descendants(one.pid))]
            leaving = threading.Thread(target=self._ray.shutdown, daemon=True)
            leaving.start()
            leaving.join(PATIENCE)  # for Ray waits without an end where the head is silent
            for process in started:
                with contextlib.suppress(psutil.Error):
                    process.kill()
            psutil.wait_procs(started, timeout=PATIENCE)

    def _count(self) -> None:
        """Count the CPUs that there are now, by the head's answer."""
        self._cpus = max(1, int(self._ray.cluster_resources().get("CPU", 1)))
        self._answered = time.monotonic()

    def _keep_counting(self) -> None:
        while not self._left.wait(LOOK_EVERY):
            with contextlib.suppress(Exception):
                self._count()

    def _check_head(self) -> None:
        if time.monotonic() - self._answered > SILENCE:
            address = self._ray.get_runtime_context().gcs_address
            message = f"the head of the Ray cluster at {address} is lost"
            raise Unfinished(f"{message}; cells that were being computed: {len(self._running)}")

    def submit(self, job: Job) -> None:
        self._check_head()
        own = {name: data for name, data in job.inputs.items() if name in (LEARNED, RESULT)}
        shared = {name: data for name, data in job.inputs.items() if name not in own}
        if job.shared and job.conditions.demonstrations:
            shared = {DEMONSTRATIONS: given.file_of(job.conditions.demonstrations).read_bytes()}
        # References leave the object store with the last job of their group.
        groups = {one.group for one in (job, *self._running.values())}
        self._shared = {group: self._shared.get(group, {}) for group in groups}
        known = self._shared[job.group]
        for name in shared.keys() - known.keys():
            known[name] = self._ray.put(shared[name])
        plain = replace(job, inputs=own, plugins=tuple(self._packed[one] for one in job.plugins))
        references = [known[name] for name in shared]
        self._running[self._begin(plain, self._settings, [*shared], *references)] = job

    def completed(self) -> list[tuple[Job, Outcome]]:
        done, _ = self._ray.wait([*self._running], num_returns=1, timeout=LOOK_EVERY, fetch_local=False)
        if done:
            done, _ = self._ray.wait([*self._running], num_returns=len(self._running), timeout=0)
        self._check_head()
        return [(self._running.pop(reference), self._outcome(reference)) for reference in done]

    def doing(self, name: str) -> Phase:
        return Phase()

    def _outcome(self, reference: Any) -> Outcome:
        errors = self._ray.exceptions
        try:
            outcome: Outcome = self._ray.get(reference)
        except errors.OutOfMemoryError:
            return Outcome(error="its node ran out of memory, and Ray ended it")
        except (errors.NodeDiedError, errors.WorkerCrashedError, errors.ObjectLostError) as error:
            return Outcome(error=f"its node was lost: {type(error).__name__}", lost=True)
        except errors.RayError as error:
            return Outcome(error=describe(error))
        return outcome


@functools.cache
def _engine(timeout: float | None, deterministic: bool, modules: tuple[str, ...], work: str) -> Processes:
    """Return the engine of this process of a node, which does all its jobs and ends with it."""
    return Processes(1, timeout, deterministic, modules, work).__enter__()


def compute_there(job: Job, settings: tuple[Any, ...], names: Sequence[str], *inputs: bytes) -> Outcome:
    """Return the outcome of a job, on a node. `names`: of the inputs that it shares with others."""
    shared = dict(zip(names, inputs, strict=True))
    if demonstrations := shared.pop(DEMONSTRATIONS, b""):
        file = given.file_of(job.conditions.demonstrations)
        file.parent.mkdir(parents=True, exist_ok=True)
        write_atomic(file, demonstrations)
    engine, here = _engine(*settings), packing.unpacked(job.plugins)
    engine.submit(replace(job, inputs={**shared, **job.inputs}, plugins=here))
    while not (ended := engine.completed()):
        pass
    return ended[0][1]
