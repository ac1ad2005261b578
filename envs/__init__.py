"""Tasks, one file each, in a folder where several are of a family. Importing a file registers its task with
Gymnasium."""

from envs.gymnasium_tasks import from_gymnasium
from envs.shapes import Quantity, Shape
from envs.spec import BUDGETS, EnvSpec

__all__ = ["BUDGETS", "EnvSpec", "Quantity", "Shape", "from_gymnasium"]
