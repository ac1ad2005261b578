"""The table of hyper-parameters that differ from methods' defaults."""

from collections.abc import Sequence
from typing import Any

NO_NUMBERS = "Keys contain the settings that it returns for a method."

MAXMARGIN = ("maxmargin", "maxmargin_projection")
MAXENT = ("maxent", "maxent_state")
ITERATIVE = (*MAXMARGIN, *MAXENT)
"""Methods in which reinforcement learning goes on between updates of the reward."""
GAMES = ("gail", "gail_mean", "gail_mean_state", "gaifo", "airl", "airl_state", "f_irl")
"""Methods in which a discriminator plays against an agent."""
SHAPED = ("shaped", "shaped_decay", "shaped_ml", "shaped_ranked")
"""Methods whose policy is f of the thesis's model."""
BASES = {
    "methods.adversarial:Game": GAMES,
    "methods.network:Regression": ("bc", "dagger", "csil", *SHAPED),
}
"""Methods by the base class that they share."""
THESIS_ARMS: dict[str, dict[str, Any]] = {
    "batch": {"batch_matrix": True},
    "start": {"small_start": True},
    "tanh": {"squashed": True},
    "squared": {"squared": True},
    "units": {"units": True},
    "standardised": {"standardised": True},
    "soap": {"soap_steps": 2000},
    "end": {"default_end": True},
}
"""Settings of the arms of `shaped_thesis`. All but the first together are `shaped`."""
LARGE = ("halfcheetah", "hopper", "walker2d")
"""Environments whose experts need larger networks to be cloned."""
ANY: tuple[str, ...] = ()
SMOKE_CLONE = {"steps": 200}
SMOKE_RL = {"iterations": 1, "rollouts": 3}
SMOKE_RANKS = {"rollouts": 2, "comparisons": 200, "reward_steps": 50, "networks": 2}

SETTINGS: list[tuple[tuple[str, ...], tuple[str, ...], tuple[str, ...], dict[str, Any]]] = [
    *(((f"shaped_thesis_{arm}",), ANY, ANY, own) for arm, own in THESIS_ARMS.items()),
    (("shaped_thesis_soap",), ANY, ("smoke",), {"soap_steps": 200}),
    (("maxmargin_projection",), ANY, ANY, {"projection": True}),
    (MAXMARGIN, ("gridworld",), ANY, {"iterations": 30}),
    (("maxent_state",), ANY, ANY, {"actions": False}),
    (MAXENT, ("gridworld",), ANY, {"iterations": 300, "learning_rate": 1e-2}),
    ((*MAXENT, *GAMES), ("cartpole_swingup",), ANY, {"iterations": 60}),
    ((*ITERATIVE, *GAMES, "maxent_linear"), ANY, ("smoke",), SMOKE_RL),
    (("gail_mean", "gail_mean_state"), ANY, ANY, {"mean": True}),
    (("gail_mean_state", "airl_state"), ANY, ANY, {"actions": False}),
    (("airl", "airl_state", "f_irl"), ("gridworld",), ("smoke",), {"known_steps": 20}),
    (("sqil", "csil"), ANY, ("quick",), {"rl_steps": 8000}),
    (("sqil", "csil"), ANY, ("smoke",), {"rl_steps": 320}),
    (("csil",), ("halfcheetah", "walker2d"), ANY, {"layers": (128, 128)}),
    (("csil", "bc", "dagger", *SHAPED), ANY, ("smoke",), SMOKE_CLONE),
    (("dagger",), ANY, ("smoke",), {"rounds": 1, "rollouts": 2}),
    (("bc", "dagger"), LARGE, ("quick", "full"), {"layers": (128, 128)}),
    (SHAPED, LARGE, ("quick", "full"), {"f_layers": (128, 128)}),
    (("shaped_decay",), ANY, ANY, {"weight_decay": 1e-3}),
    (("shaped_ml",), ANY, ("smoke",), {"rollouts": 3}),
    (("shaped_ranked",), ("swingup", "cartpole_swingup"), ("quick", "full"), {"rl_rounds": 2}),
    (("shaped_ranked",), ("halfcheetah",), ("quick", "full"), {"rl_rounds": 4}),
    (("shaped_ranked", "trex"), ANY, ("smoke",), SMOKE_RANKS),
]
"""Methods, environments and budgets (`ANY` for all), and their hyper-parameters. Later rows win."""


def settings_for(method: str, env: str, budget: str) -> dict[str, Any]:
    """Return the hyper-parameters of a method in an environment at a budget, without its defaults."""
    result: dict[str, Any] = {}
    for methods, envs, budgets, settings in SETTINGS:
        if method in methods and env in (envs or (env,)) and budget in (budgets or (budget,)):
            result |= settings
    return result


def agreed(methods: Sequence[str], env: str, budget: str) -> dict[str, Any]:
    """Return the hyper-parameters that all of these methods share in an environment at a budget."""
    tables = [settings_for(method, env, budget) for method in methods] or [{}]
    return {name: v for name, v in tables[0].items() if all(table.get(name) == v for table in tables)}
