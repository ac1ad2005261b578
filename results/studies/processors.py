"""Compute cells as another processor would, on one machine: same bits, or by how far scores differ.

cc -O2 -shared -fPIC -o cpuid.so results/studies/cpuid.c
python results/studies/processors.py cpuid.so FILE BUDGET TASKS METHODS SEED [CONDITION ...]: a line for each
condition, task, method and policy, appended to a CSV file. Columns: condition, task, method, policy, budget,
seed, return_mean, score, learned (a digest of what the cell learned), seconds (processor time of the cell;
programs of JAX may compile in it).

`fixed` is how the program computes cells, `free` is with `--fast`. `epyc` answers CPUID as an EPYC does
(`cpuid.c`). `no NAME` leaves one variable out, and NAME=VALUE sets one.
"""

import csv
import itertools
import os
import subprocess
import sys
import time
from pathlib import Path

from harness.cell.run import prepare, run_cell
from harness.process.environment import SAME_INSTRUCTIONS, of_cells
from harness.records import Cell, Conditions

CONDITIONS = ("fixed", "fixed epyc", "free", "free epyc")


def variables(condition: str, library: str) -> dict[str, str]:
    """Return the environment of a condition such as 'fixed epyc', 'fixed epyc no MKL_CBWR'."""
    words = condition.split()
    result = of_cells(words[0] == "fixed")
    for before, word in itertools.pairwise(words):
        if before == "no":
            assert word in SAME_INSTRUCTIONS
            del result[word]
            if word == "XLA_FLAGS":
                result[word] = of_cells(False)[word]
        elif word == "epyc":
            result["LD_PRELOAD"] = str(Path(library).absolute())
        elif "=" in word:
            name, _, value = word.partition("=")
            result[name] = value
    place = Path(os.environ.get("TMPDIR", "/tmp")) / "compiled" / condition.replace(" ", "_")
    return result | {
        "JAX_COMPILATION_CACHE_DIR": str(place),
        "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0",
    }


def lines(condition: str, budget: str, task: str, method: str, seed: int) -> list[list[str]]:
    """Return the lines of one cell."""
    cell, conditions = Cell(task, method, seed), Conditions(budget, "absorbing", "sbx", record="none")
    shared = prepare([Cell(task, "reference", seed), cell], conditions)
    reference, _ = run_cell(Cell(task, "reference", seed), conditions, shared)
    most, least = (
        next(row.return_mean for row in reference.rows if row.policy == name) for name in ("expert", "random")
    )
    started = time.process_time()
    result, _ = run_cell(cell, conditions, shared)
    took = time.process_time() - started
    return [
        [
            *(condition, task, method, row.policy, budget, str(seed), repr(row.return_mean)),
            *(f"{(row.return_mean - least) / (most - least):.4f}", result.learned[:12], f"{took:.1f}"),
        ]
        for row in result.rows
        if row.status == "ok"
    ]


if __name__ == "__main__":
    library, path, budget, tasks, methods, seed, *asked = sys.argv[1:]
    if library == "cell":
        for task in tasks.split(","):
            for method in methods.split(","):
                with open(path, "a", newline="", encoding="utf-8") as file:
                    its = lines(asked[0], budget, task, method, int(seed))
                    csv.writer(file, lineterminator="\n").writerows(its)
    else:
        for condition in asked or CONDITIONS:
            arguments = [path, budget, tasks, methods, seed, condition]
            its = variables(condition, library)
            subprocess.run([sys.executable, __file__, "cell", *arguments], check=True, env=its)
