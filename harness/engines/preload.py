"""Imported once, in the server that workers are forked from, for all of them to share."""

import contextlib
import importlib

# torch would import its compiler, seconds of work and of no use here, with each cell's first optimizer.
for _name in ("harness.engines.worker", "harness.rl.world", "harness.judge.advantage", "torch._dynamo"):
    # Whatever this raises, a cell's own import raises again, and the cell says so.
    with contextlib.suppress(BaseException):
        importlib.import_module(_name)
with contextlib.suppress(BaseException):
    # What a cell's key is of, read once, too.
    _keys = importlib.import_module("harness.registry.keys")
    _keys.sources(*_keys.RUNNING), _keys.packages.required()
