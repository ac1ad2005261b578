"""Tasks under the conditions of a run."""

from envs import EnvSpec
from harness.records import Conditions
from harness.registry.known import SPECS


def task_for(env: str, conditions: Conditions) -> EnvSpec:
    """Return a task with the learner and the encoder that the conditions say."""
    spec = seen_through(env, conditions.encoder)
    return spec.by_ddpg() if conditions.learner == "ddpg" else spec


def seen_through(env: str, encoder: str) -> EnvSpec:
    """Return a task with an encoder of images, '' for its own."""
    return SPECS[env].encoded_by(encoder) if encoder else SPECS[env]
