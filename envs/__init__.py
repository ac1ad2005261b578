"""The tasks, one file each; importing that registers it with Gymnasium."""

from envs.spec import BUDGETS, EnvSpec, Shape, from_gymnasium

__all__ = ["BUDGETS", "EnvSpec", "Shape", "from_gymnasium"]
