"""A car in MuJoCo on a height field: a box on four wheels with springs. The front wheels steer."""

from dataclasses import dataclass

import mujoco

from envs.hills.tracks import CELLS, HALF, RELIEF

FRAME, FRAMES = 0.02, 5  # s, of a step of physics, and their number in an action
WHEELS = {
    "front_left": (1.3, 0.8),
    "front_right": (1.3, -0.8),
    "rear_left": (-1.3, 0.8),
    "rear_right": (-1.3, -0.8),
}
"""Places of the wheels, forwards and to the left of the chassis [m]."""
WHEEL, DROP = 0.35, 0.3  # m, a wheel's radius, and how far below the chassis its centre is
STEER = 0.5  # rad, the largest angle of the front wheels
TURNS = [8, 11]  # entries of qpos that are these angles
MOTOR, BRAKE = 500.0, 40.0  # N m and N m s/rad, of a wheel
LENGTH, WIDTH, HEIGHT = 4.0, 1.8, 0.6  # m, of the chassis


@dataclass(frozen=True)
class Physics:
    """Parameters that variants change."""

    tyres: float = 1.0
    """Coefficient of friction of tyres on the ground."""
    mass: float = 1000.0
    """Mass of the chassis [kg]."""
    steering: float = 1.0
    """Factor of steering. -1 flips it."""
    camera: float = 1.2
    """Height of the camera above the chassis's centre [m]."""

    def compile(self) -> mujoco.MjModel:
        """Return the model. Controls: the front wheels' angles [rad], then each wheel's motor in [-1, 1],
        then each wheel's brake in [0, 1]."""
        front = [name for name in WHEELS if name.startswith("front")]
        bodies = "".join(
            f"""<body name="{name}" pos="{x} {y} {-DROP}">
                  <joint name="{name}_spring" type="slide" axis="0 0 1" stiffness="30000" damping="3000"
                    springref="{-9.81 * self.mass / 4 / 30000}"/>
                  {f'<joint name="{name}_turn" axis="0 0 1" damping="300"/>' if name in front else ""}
                  <joint name="{name}_spin" axis="0 1 0" damping="2" armature="1"/>
                  <geom name="{name}" type="sphere" size="{WHEEL}" mass="20" contype="1"/>
                </body>"""
            for name, (x, y) in WHEELS.items()
        )
        turns = "".join(f'<position joint="{name}_turn" kp="6000"/>' for name in front)
        motors = "".join(f'<motor joint="{name}_spin" gear="{MOTOR}"/>' for name in WHEELS)
        brakes = "".join(f'<damper joint="{name}_spin" kv="{BRAKE}" ctrlrange="0 1"/>' for name in WHEELS)
        return mujoco.MjModel.from_xml_string(f"""
            <mujoco>
              <compiler angle="radian"/>
              <option timestep="{FRAME}" integrator="implicitfast"/>
              <default>
                <geom contype="0" conaffinity="0" friction="{self.tyres}" solref="0.04 1"/>
              </default>
              <asset>
                <hfield name="ground" nrow="{CELLS}" ncol="{CELLS}" size="{HALF} {HALF} {RELIEF} 1"/>
              </asset>
              <worldbody>
                <geom name="ground" type="hfield" hfield="ground" conaffinity="1" group="1"/>
                <body name="car">
                  <freejoint/>
                  <geom name="chassis" type="box" size="{LENGTH / 2} {WIDTH / 2} {HEIGHT / 2}"
                    mass="{self.mass}"/>
                  {bodies}
                </body>
              </worldbody>
              <actuator>{turns}{motors}{brakes}</actuator>
            </mujoco>""")
