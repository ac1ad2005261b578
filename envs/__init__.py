"""The tasks, one file each; importing that registers it with Gymnasium."""

from envs.spec import BUDGETS, EnvSpec, Quantity, Shape, from_gymnasium

__all__ = ["BUDGETS", "EnvSpec", "Quantity", "Shape", "from_gymnasium"]
