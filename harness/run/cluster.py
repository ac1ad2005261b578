"""The engine of runs on many machines: cells are tasks of a Ray cluster, computed there in processes
as `harness.run.isolated` starts them here.

Only the driver, this process, reads or writes the run's directory. The program, plug-ins and shipped experts
travel as the tasks' working directory, what cells share travels through Ray's object store, and results and
recordings come back as bytes. No other file system is shared.

Ray itself repeats no task. The driver repeats those whose node was lost. Where the cluster's head is lost, or
the Ray process of this machine, Ray would end the driver, so the driver looks after both and ends the run.
"""

from __future__ import annotations

import contextlib
import os
import socket
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from types import TracebackType
from typing import Any, Self

from harness.judge.results import LEARNED
from harness.registry import BadInput, Unfinished, plugins
from harness.run import given, node, orphans
from harness.run.engines import WORK, Job, Outcome, describe
from harness.run.environment import CHOSEN, numeric, of_user
from harness.run.processes import write_program
from harness.run.progress import tell
from harness.run.scratch import scratch_folder
from harness.run.signals import STOPS, handlers_kept

LOOK_EVERY = 1.0
"""Seconds between looks for tasks that ended."""
TRIES = 3
"""Times that a cell is begun whose node is lost again and again."""
ANSWERS = 10.0
"""Seconds that a cluster's head has for an answer."""
STALLED = 600.0
"""Seconds without any result after which the user is told."""
ENDING = 20.0
"""Seconds that Ray has to leave the cluster, for which it waits without an end where the head is silent."""
SILENCE = 5.0, 60.0
"""Seconds without an answer after which the head is lost: where nothing listens there, and where something
does."""
DRIVERS = {"RAY_USAGE_STATS_ENABLED": "0", "RAY_gcs_rpc_server_reconnect_timeout_s": str(10**6)}
"""Ray sends nothing home, and does not end this process where the head is lost."""
LOOPBACK = {"RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER": "0"}
"""A cluster that is started here listens on 127.0.0.1 alone."""


@dataclass
class _Task:
    """A job that a node computes: how often it was begun."""

    job: Job
    tries: int = 1


class Ray:
    """Cells on a Ray cluster, or on one that is started on this machine and ends with the run.

    address: of the cluster's head, or 'auto'; '' starts one. workers: tasks at a time; None for as many as
    the cluster has CPUs, looked at anew while the run goes on. The others: as of `Isolated`. Raises BadInput
    where Ray is not installed, or no cluster can be reached.
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
        if not (not address or address == "auto" or (host and port.isdecimal())):
            raise BadInput(
                f"--address is HOST:PORT of the head of a Ray cluster, or auto, not {address!r:.80}",
                page="cluster",
            )
        local = not address or host in ("127.0.0.1", "localhost")
        os.environ |= DRIVERS | (LOOPBACK if local else {})  # which Ray reads as it is imported
        self._ray = _imported()
        if host:
            _check_reachable(host, port)
        self.variables = numeric(deterministic)
        self._address, self._workers = address, workers
        self._how = node.How(timeout, deterministic, tuple(modules), work)
        self._running: dict[Any, _Task] = {}
        self._shared: dict[tuple[str, int], dict[str, Any]] = {}
        """References to what cells of an environment and a seed share."""
        self._refused: list[tuple[Job, Outcome]] = []
        """Jobs that could not be begun."""
        self._left, self._lost = threading.Event(), False

    @property
    def workers(self) -> int:
        return self._workers or self._cpus

    def _count(self) -> None:
        """Count the CPUs that there are now, which the head tells."""
        self._cpus = max(1, int(self._ray.cluster_resources().get("CPU", 1)))
        self._answered = time.monotonic()

    def _keep_counting(self) -> None:
        # In a thread of its own, for Ray waits without an end for a head that is lost.
        while not self._left.wait(LOOK_EVERY):
            with contextlib.suppress(Exception):
                self._count()

    def _check_there(self) -> None:
        """Raise Unfinished where the cluster's head, or the Ray process of this machine, is lost."""
        # Of the latter Ray's next `put` would end this process.
        silent = time.monotonic() - self._answered
        refused, none = SILENCE
        if not _answers(self._node):
            lost = f"Ray's process of this machine, at {self._node}, is gone"
        elif silent > none or (silent > refused and not _answers(self._head)):
            lost = f"the head of the Ray cluster at {self._head} is lost"
        else:
            return
        self._lost = True
        raise Unfinished(f"{lost}; cells that were being computed: {len(self._running)}")

    def __enter__(self) -> Self:
        with contextlib.ExitStack() as stack:
            folder = stack.enter_context(scratch_folder()) / "program"
            write_program(folder)
            self._packed = plugins.packed(folder)
            variables = {name: os.environ[name] for name in CHOSEN if name in os.environ} | of_user()
            options: dict[str, Any] = {
                "runtime_env": {"working_dir": str(folder), "env_vars": variables},
                "log_to_driver": False,
                "logging_level": "error",
            }
            if self._address:
                options["address"] = self._address
            else:
                options |= {"address": "local", "include_dashboard": False, "num_cpus": self._workers}
                # What is started here ends with the run, though its parents may have ended before.
                stack.enter_context(orphans.taken_in())
                stack.callback(orphans.end_all)
            try:
                with handlers_kept(*STOPS):
                    self._ray.init(**options)
            except (self._ray.exceptions.RayError, RuntimeError, ValueError, OSError) as error:
                why = " ".join(str(error).split())
                raise BadInput(f"no Ray cluster {self._address}: {why}", page="cluster") from error
            stack.callback(self._shut_down)
            remote = self._ray.remote(num_cpus=1, max_retries=0)
            self._begin: Callable[..., Any] = remote(node.compute_there).remote
            self._last = time.monotonic()
            self._count()
            here = self._ray.get_runtime_context()
            own = next(one for one in self._ray.nodes() if one["NodeID"] == here.get_node_id())
            self._node = f"{own['NodeManagerAddress']}:{own['NodeManagerPort']}"
            self._head = here.gcs_address
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

    def _shut_down(self) -> None:
        """Leave the cluster, and end one that was started here."""
        if self._lost:  # Ray would wait for those that are silent, but not for the dead.
            orphans.end_all()
        leaving = threading.Thread(target=self._ray.shutdown, daemon=True)
        leaving.start()
        leaving.join(ENDING)

    def start(self, job: Job) -> None:
        self._check_there()
        self._launch(_Task(job))

    def doing(self, name: str) -> str:
        return ""

    def finished(self) -> list[tuple[Job, Outcome]]:
        if self._refused:
            ended, self._refused = self._refused, []
            return ended
        done, _ = self._ray.wait([*self._running], num_returns=1, timeout=LOOK_EVERY, fetch_local=False)
        if done:
            done, _ = self._ray.wait([*self._running], num_returns=len(self._running), timeout=0)
            self._last = time.monotonic()
        elif time.monotonic() - self._last > STALLED:
            self._last = time.monotonic()
            tell(
                f"nothing has come back from the cluster for {STALLED / 60:.0f} minutes; "
                f"{len(self._running)} cells are there, and `ray status` says what it does"
            )
        self._check_there()
        ended = []
        for reference in done:
            task = self._running.pop(reference)
            outcome = self._outcome(reference)
            if outcome.lost and task.tries < TRIES:
                tell(f"its node was lost, begun again: {task.job.name}")
                self._launch(replace(task, tries=task.tries + 1))
            else:
                ended.append((task.job, replace(outcome, lost=False)))
        return ended

    def _launch(self, task: _Task) -> None:
        try:
            self._send(task)
        except self._ray.exceptions.RayError as error:  # such as of an object store that is full
            self._refused.append((task.job, Outcome(error=describe(error))))

    def _send(self, task: _Task) -> None:
        job = task.job
        shared = {name: data for name, data in job.inputs.items() if name != LEARNED}
        alone = {name: data for name, data in job.inputs.items() if name == LEARNED}
        if job.shared and job.conditions.demonstrations:
            shared = {node.GIVEN: given.file_of(job.conditions.demonstrations).read_bytes()}
        references = self._references(job, shared)
        sent = replace(job, inputs=alone, plugins=tuple(self._packed[one] for one in job.plugins))
        self._running[self._begin(sent, self._how, tuple(references), *references.values())] = task

    def _references(self, job: Job, shared: Mapping[str, bytes]) -> dict[str, Any]:
        """To what is in the object store by then; what no job needs any more leaves it."""
        group = job.cells[0].env, job.cells[0].seed
        needed = {(task.job.cells[0].env, task.job.cells[0].seed) for task in self._running.values()}
        for other in self._shared.keys() - needed - {group}:
            del self._shared[other]
        known = self._shared.setdefault(group, {})
        for name, data in shared.items():
            if name not in known:
                known[name] = self._ray.put(data)
        return {name: known[name] for name in shared}

    def _outcome(self, reference: Any) -> Outcome:
        errors = self._ray.exceptions
        try:
            outcome: Outcome = self._ray.get(reference)
        except errors.OutOfMemoryError:
            return Outcome(error="its node ran out of memory, and Ray ended it")
        except (errors.NodeDiedError, errors.WorkerCrashedError, errors.ObjectLostError) as error:
            return Outcome(error=f"its node was lost {TRIES} times: {type(error).__name__}", lost=True)
        except errors.RayError as error:
            return Outcome(error=describe(error))
        return outcome


def _answers(address: str) -> bool:
    """Return whether somebody listens at this address, 'HOST:PORT'."""
    host, _, port = address.rpartition(":")
    with contextlib.suppress(OSError):
        socket.create_connection((host, int(port)), ANSWERS).close()
        return True
    return False


def _check_reachable(host: str, port: str) -> None:
    """Raises BadInput where nothing answers there, for which Ray itself would wait for minutes."""
    try:
        socket.create_connection((host, int(port)), ANSWERS).close()
    except (OSError, ValueError) as error:
        raise BadInput(f"no Ray cluster answers at {host}:{port}: {error}", page="cluster") from error


def _imported() -> Any:
    try:
        import ray
    except ImportError as error:
        raise BadInput("Ray is not installed: pip install 'irl-bench[ray]'", page="cluster") from error
    return ray
