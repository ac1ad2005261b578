"""Imported once, in the process that those of cells are forked from, for all of them to share."""

import contextlib
import importlib

# torch would import its compiler, seconds of work and of no use here, with each cell's first optimizer.
for _name in ("harness.run.isolated", "harness.learn.world", "harness.judge.advantage", "torch._dynamo"):
    # Whatever this raises, a cell's own import raises again, and there it is told.
    with contextlib.suppress(BaseException):
        importlib.import_module(_name)
