"""The one table of hyper-parameters that differ from a method's defaults."""

from __future__ import annotations

from typing import Any

ITERATIVE = ("maxmargin", "maxmargin_projection", "maxent", "maxent_state")
"""Methods in which reinforcement learning goes on between updates of the reward."""
SHAPED = ("shaped", "shaped_decay", "shaped_ml", "shaped_ranked")
"""Methods whose policy is the f of the thesis's model."""
MANY_STEPS = ("acrobot", "point_maze", "double_pendulum", "hopper", "walker2d")
"""Environments where RL is PPO, which takes many steps."""
LARGE = ("halfcheetah", "hopper", "walker2d")
"""Environments whose experts the usual networks are too small to clone."""
CLONE = {"steps": 10_000, "iterations": 100, "final_iterations": 100}
SETTINGS: dict[tuple[str, str, str], dict[str, Any]] = {
    ("maxmargin_projection", "*", "*"): {"projection": True},
    ("maxent_state", "*", "*"): {"actions": False},
    **{
        (name, "*", "quick"): {"iterations": 10, "averaged": 5, "final_steps": 4000}
        for name in ("maxmargin", "maxmargin_projection")
    },
    **{
        (name, "*", "quick"): {"iterations": 15, "averaged": 8, "final_steps": 4000}
        for name in ("maxent", "maxent_state")
    },
    ("maxmargin_projection", "gridworld", "*"): {"iterations": 30},
    ("maxmargin", "gridworld", "*"): {"iterations": 30},
    ("maxent", "gridworld", "*"): {"iterations": 300, "learning_rate": 1e-2},
    ("maxent_state", "gridworld", "*"): {"iterations": 300, "learning_rate": 1e-2},
    ("maxmargin", "highway", "full"): {"rl_steps": 2000, "final_steps": 10_000},
    ("maxmargin_projection", "highway", "full"): {"rl_steps": 2000, "final_steps": 10_000},
    ("maxent", "highway", "full"): {"rl_steps": 1600, "final_steps": 10_000},
    ("maxent_state", "highway", "full"): {"rl_steps": 1600, "final_steps": 10_000},
    ("shaped", "*", "smoke"): {"steps": 300, "iterations": 10},
    ("shaped_decay", "*", "*"): {"weight_decay": 1e-3},
    ("shaped_decay", "*", "smoke"): {"steps": 300, "iterations": 10},
    ("shaped_ml", "*", "smoke"): {"steps": 300, "iterations": 10, "rollouts": 3},
    **{("shaped_ranked", env, "*"): {"rl_steps": 20_000} for env in ("cartpole_swingup", "halfcheetah")},
    ("shaped_ranked", "*", "smoke"): {
        **{"steps": 300, "iterations": 10, "rollouts": 2, "rl_steps": None},
        **{"comparisons": 200, "reward_steps": 50, "networks": 2},
    },
    ("bc", "*", "smoke"): {"steps": 300, "iterations": 10},
    **{
        (name, env, budget): {size: (128, 128), **CLONE}
        for name, size in [("bc", "layers")] + [(name, "f_layers") for name in SHAPED]
        for env in LARGE
        for budget in ("quick", "full")
    },
    **{
        (name, "*", "smoke"): {"iterations": 1, "rl_steps": 320, "final_steps": 320, "rollouts": 3}
        for name in ITERATIVE
    },
    ("maxent_linear", "*", "smoke"): {"iterations": 1, "rl_steps": 320, "rollouts": 3},
    **{
        (name, env, budget): {"rl_steps": 20_000, "final_steps": final_steps}
        for name in ITERATIVE
        for env in MANY_STEPS
        for budget, final_steps in (("smoke", 20_000), ("quick", 100_000), ("full", 100_000))
    },
    **{(name, "acrobot", "full"): {"rl_steps": 60_000, "final_steps": 200_000} for name in ITERATIVE},
    **{
        (name, "hopper", "full"): {
            **{"iterations": 200, "rl_steps": 8000, "final_steps": 100_000},
            **{"reward_steps": 20, "averaged": 100, "remembered": 8},
        }
        for name in ("maxent", "maxent_state")
    },
    **{
        (name, "cartpole_swingup", "full"): {"rl_steps": 2000, "final_steps": 20_000}
        for name in ("maxmargin", "maxmargin_projection")
    },
    **{
        (name, "cartpole_swingup", "full"): {
            **{"iterations": 60, "restart_every": 12, "averaged": 30},
            **{"rl_steps": 2000, "final_steps": 40_000},
        }
        for name in ("maxent", "maxent_state")
    },
    **{("maxent_linear", env, "*"): {"rl_steps": 100_000} for env in MANY_STEPS},
}
"""(method, env, budget), '*' for any, to hyper-parameters; later rows win, and of equal ones only the last is
kept."""


def settings_for(method: str, env: str, budget: str) -> dict[str, Any]:
    """The hyper-parameters that a method gets in an environment at a budget."""
    chosen: dict[str, Any] = {}
    for (its_method, its_env, its_budget), settings in SETTINGS.items():
        if its_method == method and its_env in ("*", env) and its_budget in ("*", budget):
            chosen |= settings
    return chosen
