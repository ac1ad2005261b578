"""Write rl_solves.csv: every RL solve of a run's rewards, and whether it solved its reward.

    irl-bench run --methods all --envs swingup,cartpole_swingup --seeds 100-104 --demos 5 --budget full \
        --record none --out DIR
    python results/studies/rl_solves.py DIR

Columns: env, method, seed, solve (its number), chosen (1 for pi_R), solved (by what it earns of R*,
`harness.judge.evaluation`), score (normalised), score_star (of pi*), and own_return, own_return_star,
own_return_random (what solve, pi* and the random policy earn of R*).
"""

import csv
import math
import sys
from pathlib import Path

from harness.judge.leaderboard import scored_rows
from harness.registry.bounds import usable
from harness.store.opening import open_to_verify

COLUMNS = ("env", "method", "seed", "solve", "chosen", "solved", "score", "score_star")
RETURNS = ("own_return", "own_return_star", "own_return_random")

with open_to_verify(Path(sys.argv[1])) as run:
    results, damaged = run.load()
assert not damaged
rows = {(row.env, row.method, row.seed, row.policy): row for row in scored_rows([*results.values()])}
lines = []
for cell, result in sorted(results.items()):
    place = (cell.env, cell.method, cell.seed)
    if not result.solves or (*place, "pi_star") not in rows:
        continue
    star, found = rows[*place, "pi_star"], rows[*place, "pi_R"]
    random, expert = (
        rows[cell.env, "reference", cell.seed, name].return_mean for name in ("random", "expert")
    )
    judged = [solve.judged if usable(solve.judged) else -math.inf for solve in result.solves]
    for number, solve in enumerate(result.solves):
        chosen = number == judged.index(max(judged))
        score = (solve.return_mean - random) / (expert - random)
        assert not chosen or abs(score - found.normalized_score) < 1e-9
        returns = (solve.own_return, star.own_return, star.own_return_random)
        numbers = (f"{solve.solved:g}", f"{score:.3f}", f"{star.normalized_score:.3f}")
        lines.append((*place, number, int(chosen), *numbers, *(f"{value:.4g}" for value in returns)))
with Path(__file__).with_suffix(".csv").open("w", encoding="utf-8", newline="") as file:
    csv.writer(file, lineterminator="\n").writerows([COLUMNS + RETURNS, *lines])
