"""A controller of the racing car."""

from dataclasses import dataclass

import numpy as np

from envs.spec import Array

AHEAD = (4.0, 8.0, 12.0, 18.0, 25.0, 35.0)
"""Distances along the road of the points that are observed [m]."""


@dataclass(frozen=True)
class Driver:
    """A controller that sees states: pure pursuit (Coulter 1992) at a speed that curves ahead allow.

    It is called with observations (B, 17), and returns actions (B, 3).
    """

    look: float = 0.25
    """Seconds until the point that it steers to."""
    grip: float = 100.0
    """Lateral acceleration in curves [m/s2]."""
    slow: float = 40.0
    """Deceleration before curves [m/s2]."""
    fastest: float = 65.0
    """Speed on a straight [m/s]."""
    steer: float = 4.0
    """Angle of the front wheels for a curvature [rad m]."""
    damp: float = 0.02
    """Angle of the front wheels against a yaw rate beyond the curve's [s]."""
    pedal: float = 0.1
    """Gas or brake for an error of speed [s/m]."""
    yielding: float = 1.0
    """Gas that an angle of the front wheels takes away [1/rad]."""
    hardest: float = 0.3
    """Largest brake."""

    def __call__(self, obs: Array) -> Array:
        speed, yaw, x, y = obs[:, 0], obs[:, 2], obs[:, 5::2], obs[:, 6::2]
        bend = 2 * y / np.maximum(x * x + y * y, 1.0)
        allowed = self.grip / np.maximum(np.abs(bend), 1e-6) + 2 * self.slow * np.array(AHEAD)
        error = np.minimum(np.sqrt(allowed.min(axis=1)), self.fastest) - speed
        near = np.abs(np.array(AHEAD) - self.look * speed[:, None]).argmin(axis=1)
        curve = bend[np.arange(len(obs)), near]
        angle = self.steer * curve + self.damp * (curve * speed - yaw)
        gas = np.clip(self.pedal * error, 0, np.maximum(1 - self.yielding * np.abs(angle), 0.1))
        brake = np.clip(-self.pedal * error, 0, self.hardest)
        return np.asarray(np.clip(np.column_stack([-angle, 2 * gas - 1, 2 * brake - 1]), -1, 1))
