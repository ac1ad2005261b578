"""Tasks, one file each. Importing a file registers its task with Gymnasium."""

from envs.gymnasium_tasks import from_gymnasium
from envs.spec import BUDGETS, EnvSpec, Quantity, Shape

__all__ = ["BUDGETS", "EnvSpec", "Quantity", "Shape", "from_gymnasium"]
