"""Imported once, in the process that those of cells are forked from, for all of them to share."""

import contextlib
import gc
import importlib
import os

from harness.run.environment import PRELOAD_VARIABLE

# torch would import its compiler, seconds of work and of no use here, with each cell's first optimizer.
_usual = ("harness.run.isolated", "harness.learn.world", "harness.judge.advantage", "torch._dynamo")
with contextlib.suppress(BaseException):
    # What a cell's key is of, read once, too.
    _keys = importlib.import_module("harness.registry.keys")
    _keys.sources(*_keys.RUNNING), _keys.packages.required()
for _name in (*_usual, *filter(None, os.environ.get(PRELOAD_VARIABLE, "").split(","))):
    # Whatever this raises, a cell's own import raises again, and there it is told.
    with contextlib.suppress(BaseException):
        importlib.import_module(_name)
# What is there by now stays: to look through it for garbage would take each cell time, and its own memory.
gc.freeze()
