"""Set parts of methods beside closed forms, and beside `imitation` and scikit-learn.

python results/studies/against_known.py ours FOLDER: write ours.npz, what `against_known.py theirs` reads.
python results/studies/against_known.py theirs FOLDER, in the environment of `against_imitation.py`: write
theirs.npz. python results/studies/against_known.py both FOLDER: print a line for each comparison, as in
against_others.csv: method, theirs, ours, n.
"""

import importlib
import sys
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

SEED, ACTIONS = 100, 5
Arrays = dict[str, Any]


def ours() -> Arrays:
    """Return models, demonstrations and rollouts, and what our methods make of them."""
    from harness.cell.experts import source_for
    from harness.records import Conditions, Shown
    from harness.registry import SPECS
    from harness.rl.seeds import evaluation_seeds, rng_for
    from harness.rl.simulator import Simulator
    from harness.rl.world import TaskWorld
    from methods.base import Episodes, Policy, Rng
    from methods.csil import GaussianProcess
    from methods.shaped_ranked import ShapedRanked
    from methods.stochastic import roughened
    from methods.tabular.model import demonstrated, finite_soft_value_iteration, state_visitations

    found: Arrays = {}
    spec = SPECS["gridworld"]
    model: Any = spec.tabular
    demos = source_for("gridworld", SEED, Conditions("full", "absorbing", "sbx")).demonstrations(Shown())
    r = np.random.default_rng(0).normal(size=len(model.start))
    _, pi = finite_soft_value_iteration(model.P, r, spec.horizon)
    mu = demonstrated(demos, model).sum(axis=2)
    last = np.mean([np.eye(len(r))[model.states(obs[-1:])[0]] for obs in demos.obs], axis=0)
    found |= {"P": model.P, "start": model.start, "obs": model.obs, "features": model.features, "r": r}
    found |= {"pi": pi, "visits": state_visitations(model.P, pi, model.start, spec.horizon)}
    found |= {"shown": mu.sum(axis=0) + last, "horizon": spec.horizon}

    swing = SPECS["swingup"]
    source = source_for("swingup", SEED, Conditions("full", "absorbing", "sbx"))
    shown = source.demonstrations(Shown(demos=5))
    obs, act = shown.pairs()
    standard = obs.mean(axis=0), obs.std(axis=0)
    q = GaussianProcess.fitted(obs, act, standard, len(obs), 0.03, np.random.default_rng(0))
    near = obs[::7] + 0.1 * standard[1] * np.random.default_rng(1).normal(size=obs[::7].shape)
    mean, variance = q(near)
    found |= {"x": (obs - standard[0]) / standard[1], "act": act, "z": (near - standard[0]) / standard[1]}
    found |= {"q_mean": mean, "q_variance": variance, "width": q.width, "noise": q.noise}

    class Kept(TaskWorld):
        ladder: ClassVar[list[Episodes]] = []

        def rollout(self, policy: Policy, episodes: int, rng: Rng) -> Episodes:
            self.ladder.append(super().rollout(policy, episodes, rng))
            return self.ladder[-1]

    world = Kept(swing, "absorbing", "sbx", solve_steps=1)
    learned: Any = ShapedRanked().fit(shown, world, rng_for(SEED, "swingup", "shaped", "fit"))
    rng = np.random.default_rng(2)
    held = [
        episode
        for i, share in enumerate(np.linspace(0, 1, 11))
        for episode in Simulator(swing).run(
            roughened(learned.policy, share, world.random_actions, rng), evaluation_seeds(SEED + i, 5)
        )
    ]
    found["ladder"] = np.stack([np.stack(one.obs) for one in world.ladder])
    found["held"] = np.stack([one.obs[:-1] for one in held])
    found["returns"] = [one.rewards.sum() for one in held]
    found["ranked"] = [learned.reward(one.obs[:-1], one.act, one.obs[1:]).sum() for one in held]
    return found


def theirs(a: Arrays) -> Arrays:
    """Return what other code makes of the same."""
    mce, nets, gp, kernels, bases, preference, torch, logger = map(
        importlib.import_module,
        (
            *("imitation.algorithms.mce_irl", "imitation.rewards.reward_nets", "sklearn.gaussian_process"),
            *("sklearn.gaussian_process.kernels", "seals.base_envs"),
            *("imitation.algorithms.preference_comparisons", "torch", "imitation.util.logger"),
        ),
    )
    found: Arrays = {}
    env = bases.TabularModelPOMDP(
        transition_matrix=a["P"],
        observation_matrix=a["obs"].astype(np.float32),
        reward_matrix=a["r"],
        horizon=int(a["horizon"]),
        initial_state_dist=a["start"],
    )
    found["pi"] = mce.mce_partition_fh(env)[2]
    found["visits"] = mce.mce_occupancy_measures(env)[0][:-1]
    quiet = logger.configure(None, [])
    for name in ("obs", "features"):
        env.observation_matrix = a[name].astype(np.float32)
        torch.manual_seed(0)
        size = a[name].shape[1]
        space = importlib.import_module("gymnasium").spaces
        network = nets.BasicRewardNet(
            space.Box(-np.inf, np.inf, (size,), np.float32),
            space.Discrete(ACTIONS),
            use_action=False,
            hid_sizes=[64, 64] if name == "obs" else [],
        )
        learner = mce.MCEIRL(a["shown"], env, network, np.random.default_rng(0), custom_logger=quiet)
        learner.train(1000)
        rows = torch.as_tensor(env.observation_matrix)
        found[f"r_{name}"] = network(rows, None, None, None).detach().numpy()

    prior = 1 / 3 - float(a["noise"]) ** 2
    size = float(a["width"]) * np.sqrt(a["x"].shape[1])
    kernel = kernels.ConstantKernel(prior, "fixed") * kernels.RBF(size, "fixed")
    process = gp.GaussianProcessRegressor(kernel, alpha=float(a["noise"]) ** 2, optimizer=None)
    mean, std = process.fit(a["x"], a["act"]).predict(a["z"], return_std=True)
    found |= {"q_mean": mean.reshape(len(a["z"]), -1), "q_std": std.reshape(len(a["z"]), -1)}

    space = importlib.import_module("gymnasium").spaces.Box(-np.inf, np.inf, (3,), np.float32)
    network = nets.BasicRewardNet(space, space, use_action=False, hid_sizes=[64, 64])
    model = preference.PreferenceModel(network)
    adam, rng = torch.optim.Adam(network.parameters(), 1e-3), np.random.default_rng(0)
    ladder = torch.as_tensor(a["ladder"][:, :, :-1], dtype=torch.float32)
    for _ in range(500):
        loss = 0.0
        for _ in range(32):
            i, j = np.sort(rng.choice(len(ladder), 2, replace=False))
            parts = []
            for level in (i, j):
                episode, first = rng.integers(ladder.shape[1]), rng.integers(ladder.shape[2] - 50)
                parts.append(network(ladder[level, episode, first : first + 50], None, None, None))
            loss = loss - torch.log(model.probability(*parts)) / 32
        adam.zero_grad()
        loss.backward()
        adam.step()
    held = torch.as_tensor(a["held"], dtype=torch.float32)
    found["ranked"] = (
        network(held.flatten(0, 1), None, None, None).detach().numpy().reshape(held.shape[:2]).sum(1)
    )
    return found


def both(a: Arrays, b: Arrays) -> list[tuple[str, str, str, int]]:
    """Return method, theirs, ours and the number of what was compared."""
    from scipy.linalg import solve_discrete_are
    from scipy.optimize import nnls
    from scipy.stats import spearmanr

    from harness.cell.experts import source_for
    from harness.records import Conditions, Shown
    from harness.registry import SPECS, load_method
    from harness.rl.seeds import rng_for
    from harness.rl.world import TaskWorld
    from methods.maxmargin import max_margin, projection
    from methods.settings import settings_for
    from methods.shaped_ml import inverse_lqr
    from methods.tabular.f_irl import forward_divergence
    from methods.tabular.model import greedy, policy_value, value_iteration

    spec, lines = SPECS["gridworld"], []
    model: Any = spec.tabular

    def largest(x: Any, y: Any) -> str:
        return f"{np.abs(x - y).max():.1g}"

    def value(r: Any) -> float:
        """Return the share of the expert's gain over uniform actions that the best policy of r has."""
        best, found = (greedy(value_iteration(model.P, one, spec.gamma)[1]) for one in (model.reward, r))
        uniform = np.full(best.shape, 1 / best.shape[1])
        most, least, its = (
            model.start @ policy_value(model.P, model.reward, one, spec.gamma)
            for one in (best, uniform, found)
        )
        return float((its - least) / (most - least))

    lines.append(("soft policies", "0", largest(a["pi"], b["pi"]), a["pi"].size))
    lines.append(("visitations", "0", largest(a["visits"], b["visits"]), a["visits"].size))
    source = source_for("gridworld", SEED, Conditions("full", "absorbing", "sbx"))
    demos, world = source.demonstrations(Shown()), TaskWorld(spec, "absorbing", "sbx", solve_steps=1)
    every = np.repeat(model.obs, ACTIONS, axis=0), np.tile(np.eye(ACTIONS), (len(model.obs), 1))
    for method, name in (("maxent", "obs"), ("maxent_state", "obs"), ("maxent_linear", "features")):
        fitted = load_method(method)(**settings_for(method, "gridworld", "full"))
        reward = fitted.fit(demos, world, rng_for(SEED, "gridworld", method, "fit")).reward
        mine = reward(*every, every[0]).reshape(len(model.obs), ACTIONS)
        lines.append((method, f"{value(b[f'r_{name}']):.3f}", f"{value(mine):.3f}", len(demos)))

    errors = [np.abs(a["q_mean"] - b["q_mean"]).max()]
    errors.append(np.abs(a["q_variance"] - b["q_std"] ** 2 - float(a["noise"]) ** 2).max())
    lines.append(("csil", "0", f"{max(errors):.1g}", len(a["z"])))
    ranks = (spearmanr(one["ranked"], a["returns"]).statistic for one in (b, a))
    lines.append(("shaped_ranked", *(f"{rank:.2f}" for rank in ranks), len(a["returns"])))  # type: ignore[arg-type]

    rng, gaps = np.random.default_rng(0), {"maxmargin": [0.0], "maxmargin_projection": [0.0]}
    for _ in range(20):
        expert, *learned = rng.normal(size=(6, 8))
        hull = np.vstack([np.array(learned).T, np.full(5, 1e4)])
        shares, _ = nnls(hull, np.append(expert, 1e4))
        true = np.linalg.norm(expert - shares / shares.sum() @ np.array(learned))
        gaps["maxmargin"].append(abs(max_margin(expert, learned)[1] - true))
        gaps["maxmargin_projection"].append(projection(expert, learned * 2000)[1] - true)
    lines += [(name, "0", f"{max(its):.1g}", 20) for name, its in gaps.items()]

    errors = []
    for _ in range(20):
        A, B, cost = rng.normal(size=(3, 3)) / 2, rng.normal(size=(3, 2)), np.exp(rng.normal(size=5))
        Q, R = np.diag(cost[:3]), np.diag(cost[3:])
        riccati = solve_discrete_are(A, B, Q, R)
        M = R + B.T @ riccati @ B
        found = inverse_lqr(A, B, np.linalg.solve(M, B.T @ riccati @ A), rng.normal(size=(50, 3)), 1.0, 1e-10)
        errors.append(np.abs(found / np.trace(found) - M / np.trace(M)).max())
    lines.append(("shaped_ml", "0", f"{max(errors):.1g}", 20))

    shown, r = rng.dirichlet(np.ones(len(a["r"]))), a["r"]
    gradient = forward_divergence(model, r, shown, 20, spec.gamma)[1]
    differences = [
        (forward_divergence(model, r + h, shown, 20, spec.gamma)[0]
        - forward_divergence(model, r - h, shown, 20, spec.gamma)[0]) / 2e-5
        for h in 1e-5 * np.eye(len(r))
    ]  # fmt: skip
    lines.append(("f_irl", "0", largest(gradient, differences), len(r)))
    return lines


if __name__ == "__main__":
    job, folder = sys.argv[1], Path(sys.argv[2])
    if job == "ours":
        np.savez(folder / "ours.npz", **ours())
    elif job == "theirs":
        np.savez(folder / "theirs.npz", **theirs(dict(np.load(folder / "ours.npz"))))
    else:
        for line in both(*(dict(np.load(folder / f"{name}.npz")) for name in ("ours", "theirs"))):
            print(*line, sep=",")
