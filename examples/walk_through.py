"""A walk from a method to the board and to another library, cell by cell as in a notebook.

python examples/walk_through.py [BUDGET] [FOLDER]    # smoke, the default: a minute, and no result; quick: one
"""

# %% What is run, and where what it finds is kept
import sys
import tempfile
from pathlib import Path

from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.monitor import Monitor

import irl_bench

budget = sys.argv[1] if len(sys.argv) > 1 else "smoke"
folder = Path(sys.argv[2] if len(sys.argv) > 2 else tempfile.mkdtemp(prefix="walk_through_"))
plugin = str(Path(__file__).with_name("my_method.py"))

# %% The method beside a built-in one, on two tasks: a frame with a row for each policy of each cell
request = irl_bench.RunRequest(
    methods=["ridge", "bc"],
    envs=["cartpole", "swingup"],
    seeds=2,
    budget=budget,
    plugins=[plugin],
    retrain=False,
    demos=[5],
)
results = irl_bench.run(request, store=folder / "run")
learned = results.scores[results.scores.policy == "pi_star"]
print(learned.pivot_table(index="method", columns="env", values="normalized_score").round(2))

# %% Over seeds, with intervals
columns = ["env", "method", "score_mean", "score_low", "score_high"]
print(results.leaderboard.query("policy == 'pi_star'")[columns].round(2).to_string(index=False))

# %% What it learned, in Stable-Baselines3's own evaluation: the task's true reward, in its own environment
exported = irl_bench.load_learned(
    irl_bench.export(folder / "run", "cartpole", "ridge", to=folder / "exported")
)
mean, spread = evaluate_policy(exported.policy, Monitor(irl_bench.make("cartpole")), n_eval_episodes=5)
print(f"ridge on cartpole returns {mean:.1f} +- {spread:.1f}")
