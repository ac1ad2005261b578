"""The tasks, one file each, in a folder where several are of a family. Importing a file registers its task
with Gymnasium."""

from envs.spec import BUDGETS, EnvSpec, Quantity, Shape, from_gymnasium

__all__ = ["BUDGETS", "EnvSpec", "Quantity", "Shape", "from_gymnasium"]
