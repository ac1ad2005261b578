"""The one table of hyper-parameters that differ from a method's defaults."""

from __future__ import annotations

from typing import Any

SETTINGS: dict[tuple[str, str, str], dict[str, Any]] = {
    ("maxmargin_projection", "*", "*"): {"projection": True},
    ("maxmargin_projection", "gridworld", "*"): {"iterations": 30},
    ("maxmargin", "gridworld", "*"): {"iterations": 30},
    ("maxent", "gridworld", "*"): {"iterations": 300, "learning_rate": 1e-2},
    ("maxmargin", "highway", "full"): {"iterations": 10, "rl_steps": 5000},
    ("maxent", "highway", "full"): {"iterations": 10, "rl_steps": 5000},
    ("shaped", "*", "smoke"): {"steps": 300, "iterations": 10},
    ("shaped_decay", "*", "*"): {"weight_decay": 1e-3},
    ("shaped_decay", "*", "smoke"): {"steps": 300, "iterations": 10},
    ("shaped_ml", "*", "smoke"): {"steps": 300, "iterations": 10, "rollouts": 3},
    ("bc", "*", "smoke"): {"steps": 300, "iterations": 10},
    ("maxmargin", "*", "smoke"): {"iterations": 1, "rl_steps": 320, "rollouts": 3},
    ("maxmargin_projection", "*", "smoke"): {"iterations": 1, "rl_steps": 320, "rollouts": 3},
    ("maxent", "*", "smoke"): {"iterations": 1, "rl_steps": 320, "rollouts": 3, "reward_steps": 100},
    ("maxent_linear", "*", "smoke"): {"iterations": 1, "rl_steps": 320, "rollouts": 3},
}
"""(method, env, budget), '*' for any, to hyper-parameters; later rows win."""


def settings_for(method: str, env: str, budget: str) -> dict[str, Any]:
    """The hyper-parameters that a method gets in an environment at a budget."""
    chosen: dict[str, Any] = {}
    for (its_method, its_env, its_budget), settings in SETTINGS.items():
        if its_method == method and its_env in ("*", env) and its_budget in ("*", budget):
            chosen |= settings
    return chosen
