"""The tasks. Importing this package registers them with Gymnasium."""

from envs import cartpole, highway, pendulum
from envs.spec import BUDGETS, EnvSpec, Shape

SPECS = {module.SPEC.name: module.SPEC for module in (cartpole, highway, pendulum)}

__all__ = ["BUDGETS", "SPECS", "EnvSpec", "Shape"]
