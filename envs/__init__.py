"""The tasks. Importing this package registers them with Gymnasium."""

from envs import cartpole, cartpole_discrete, gridworld, highway, pendulum
from envs.spec import BUDGETS, EnvSpec, Shape

SPECS = {
    module.SPEC.name: module.SPEC for module in (cartpole, pendulum, highway, cartpole_discrete, gridworld)
}

__all__ = ["BUDGETS", "SPECS", "EnvSpec", "Shape"]
