"""Curves of running cells for TensorBoard and Weights & Biases, written on this machine as points come.

DIR/tensorboard/CELL    Events of a cell, for `tensorboard --logdir DIR/tensorboard`.
DIR/wandb/offline-*     A run for each cell, for `wandb sync`. Nothing is sent before.
"""

from __future__ import annotations

import importlib
import os
import shutil
import threading
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Protocol

from harness.cell.phases import Phase
from harness.records import Cell, CellResult
from harness.registry import BadInput
from harness.registry.packages import to_install
from harness.schedule.grid import Sink
from harness.schedule.progress import tell

NO_NUMBERS = "It shows curves."

FLUSH = 5
"""Seconds after which a point can be seen, at most."""


class Writer(Protocol):
    """The log of one cell."""

    def add(self, curve: str, value: float, step: int) -> None:
        """Add a point to a curve at an environment step."""

    def close(self) -> None:
        """Write the points that are not in files yet."""


class _TensorBoard:
    def __init__(self, directory: Path, name: str) -> None:
        from torch.utils.tensorboard import SummaryWriter

        folder = directory / "tensorboard" / name
        shutil.rmtree(folder, ignore_errors=True)  # of the cell when it was computed before
        self._writer: Any = SummaryWriter(str(folder), flush_secs=FLUSH)

    def add(self, curve: str, value: float, step: int) -> None:
        self._writer.add_scalar(curve, value, step)

    def close(self) -> None:
        self._writer.close()


class _Wandb:
    def __init__(self, directory: Path, name: str) -> None:
        os.environ["WANDB_ERROR_REPORTING"] = "false"
        import wandb

        quiet = wandb.Settings(silent=True, console="off")
        self._run: Any = wandb.init(
            project="irl-bench",
            name=name,
            dir=str(directory),
            mode="offline",
            reinit="create_new",
            settings=quiet,
        )

    def add(self, curve: str, value: float, step: int) -> None:
        self._run.log({curve: value, "step": step})

    def close(self) -> None:
        self._run.finish()


WRITERS: dict[str, Callable[[Path, str], Writer]] = {"tensorboard": _TensorBoard, "wandb": _Wandb}
"""Writers by the name of their library, which is an extra."""
MODULES = {"tensorboard": "torch.utils.tensorboard", "wandb": "wandb"}


class Logged:
    """A sink of results that logs the curves of cells, too: live points, and at the end the scores.

    `directory`: the run's. Raises BadInput where a library cannot be imported.
    """

    def __init__(self, sink: Sink, directory: Path, logs: Sequence[str]) -> None:
        for log in logs:
            try:
                importlib.import_module(MODULES[log])
            except ImportError as error:
                raise BadInput(f"{log} cannot be imported: {to_install(log)}") from error
        self._sink, self._directory, self._logs = sink, directory, logs
        self._writers: dict[str, list[Writer]] = {}
        self._live = set[tuple[str, str]]()
        """Curves of running cells that were logged already."""
        self._lock = threading.Lock()

    def heard(self, name: str, phase: Phase) -> None:
        """Log the points of a phase. Called from the threads of jobs."""
        for curve, value in phase.values.items():
            self._live.add((name, curve))
            self._add(name, f"{phase.stage}/{curve}", value, phase.step or 0)

    def save(self, result: CellResult, files: Mapping[str, bytes]) -> None:
        self._sink.save(result, files)
        name = result.cell.name
        for curve, points in result.curves.items():
            for x, y in points if (name, curve) not in self._live else []:
                self._add(name, f"curves/{curve}", y, int(x))
        for row in result.rows:
            if row.status == "ok":
                self._add(name, f"return/{row.policy}", row.return_mean, 0)
        with self._lock:
            for writer in self._writers.pop(name, []):
                writer.close()

    def _add(self, name: str, curve: str, value: float, step: int) -> None:
        """Log a point. Where that fails, which fails no cell, nothing more is logged."""
        with self._lock:
            try:
                if name not in self._writers:
                    self._writers[name] = [WRITERS[log](self._directory, name) for log in self._logs]
                for writer in self._writers[name]:
                    writer.add(curve, value, step)
            except Exception as error:  # whatever libraries raise
                tell(f"curves are logged no more: {type(error).__name__}: {error}")
                self._logs, self._writers = (), {}

    def log(self, printed: bytes) -> None:
        self._sink.log(printed)

    def handed_on(self, cell: Cell) -> Mapping[str, bytes]:
        return self._sink.handed_on(cell)
