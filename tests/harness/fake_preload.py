"""Imported once, in the process that those of fake cells are forked from: what all of them would import."""

import gc

import harness.engines.processes  # noqa: F401
from harness.records import Cell, Conditions
from harness.registry.keys import cell_keys

cell_keys([Cell("cartpole", "bc", 0)], Conditions("smoke", "absorbing", "sb3"), {})
gc.freeze()
