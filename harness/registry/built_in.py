"""Tables of everything built in, known without an import of any of it."""

from typing import NamedTuple

NO_NUMBERS = {
    "METHODS": "Keys are of a cell's own entry.",
    "VARIANTS": "Keys are of a cell's own entry.",
    "ENVS": "Keys are of a cell's own entry.",
    "DRIVING": "Keys are of a cell's own entry.",
    "IMAGES": "Keys are of a cell's own entry.",
    "OTHER_ENVS": "Keys are of a cell's own entry.",
    "BUILT_IN": "Keys are of a cell's own entry.",
    "GROUPS": "It lists what users may type.",
    "METHOD_GROUPS": "It lists what users may type.",
}


class Entry(NamedTuple):
    """The place of a method's class or of a task's `EnvSpec`, 'module:name', and a summary of one line.

    `variants`: a task's other dynamics.
    `experts`: the task that has its shipped experts, '' for itself.
    `needs`: a module of an extra, whose name is the module's in small letters. '' for none.
    """

    target: str
    summary: str
    variants: tuple[str, ...] = ()
    experts: str = ""
    needs: str = ""

    @property
    def module(self) -> str:
        return self.target.partition(":")[0]


_THESIS = "methods.shaped_thesis:ShapedThesis"
METHODS = {
    "shaped": Entry("methods.shaped:Shaped", "the thesis's shaped-reward model, learned from expert pairs"),
    "shaped_ml": Entry(
        "methods.shaped_ml:ShapedML", "shaped, with L fitted by likelihood and an inverse LQR in the world"
    ),
    "shaped_ranked": Entry(
        "methods.shaped_ranked:ShapedRanked",
        "shaped, with a reward of states learned from rollouts under growing noise (D-REX)",
    ),
    "maxmargin": Entry(
        "methods.maxmargin:MaxMargin", "max-margin apprenticeship learning (Abbeel & Ng 2004)"
    ),
    "maxent": Entry("methods.maxent:MaxEnt", "maximum-entropy deep IRL (Wulfmeier et al. 2015)"),
    "bc": Entry("methods.bc:BehaviourCloning", "behaviour cloning; learns no reward"),
    "gail": Entry("methods.gail:GAIL", "generative adversarial imitation learning (Ho & Ermon 2016)"),
    "gail_mean_state": Entry(
        "methods.gail:GAIL", "gail of states alone, the mean of the latest discriminators as reward"
    ),
    "gaifo": Entry(
        "methods.gaifo:GAIfO", "GAIL from observation, of a state and the next one (Torabi et al. 2018)"
    ),
    "airl_state": Entry(
        "methods.airl:AIRL", "adversarial IRL, with a reward of states alone (Fu et al. 2018)"
    ),
    "f_irl": Entry("methods.f_irl:FIRL", "f-IRL of the forward KL divergence (Ni et al. 2020)"),
    "csil": Entry("methods.csil:CSIL", "coherent soft imitation learning (Watson et al. 2023)"),
    "sqil": Entry("methods.sqil:SQIL", "soft Q imitation learning (Reddy et al. 2020); learns no reward"),
}
THESIS = {
    "shaped_thesis": Entry(_THESIS, "shaped to the letter of the thesis's figures and section 5"),
    "shaped_thesis_batch": Entry(_THESIS, "shaped_thesis, with figure 4.4's one number for a batch as R"),
    "shaped_thesis_start": Entry(_THESIS, "shaped_thesis, with L near 0 at the start, as in shaped"),
    "shaped_thesis_tanh": Entry(_THESIS, "shaped_thesis, with f squashed"),
    "shaped_thesis_squared": Entry(_THESIS, "shaped_thesis, with squared errors of f"),
    "shaped_thesis_units": Entry(_THESIS, "shaped_thesis, in units of the actions' standard deviation"),
    "shaped_thesis_standardised": Entry(_THESIS, "shaped_thesis, on standardised observations"),
    "shaped_thesis_soap": Entry(_THESIS, "shaped_thesis, fitted by SOAP"),
    "shaped_thesis_end": Entry(_THESIS, "shaped_thesis, with shaped's default of what an end pays"),
}
"""The thesis's model, and arms that change one thing in it towards `shaped`."""
VARIANTS = {
    **THESIS,
    "gail_mean": Entry("methods.gail:GAIL", "gail, with the mean of the latest discriminators as reward"),
    "airl": Entry("methods.airl:AIRL", "airl_state, with a reward of states and actions"),
    "dagger": Entry(
        "methods.dagger:DAgger", "DAgger (Ross et al. 2011); asks the expert, so a ceiling and no rival"
    ),
    "trex": Entry("methods.trex:TREX", "T-REX (Brown et al. 2019); sees ranked demonstrations, so no rival"),
    "shaped_decay": Entry("methods.shaped:Shaped", "shaped, with a penalty on its weights"),
    "maxent_state": Entry("methods.maxent:MaxEnt", "maxent, with a reward of states alone"),
    "maxent_linear": Entry(
        "methods.maxent_linear:MaxEntLinear", "maximum-entropy IRL with a linear reward (Ziebart et al. 2008)"
    ),
    "maxmargin_projection": Entry(
        "methods.maxmargin:MaxMargin", "maxmargin by the paper's projection method instead"
    ),
}
"""Methods that run when they are named, and are not part of 'all'."""
ASKING = ("dagger",)
"""Methods that ask the expert for its actions: a ceiling for the others."""
RANKED = ("trex",)
"""Methods that see preferences between demonstrations."""
UNREWARDED = ("bc", "dagger", "sqil")
"""Methods that learn no reward."""
ENVS = {
    "cartpole": Entry(
        "envs.balancing.cartpole:SPEC",
        "continuous cart-pole: keep the pole upright for 500 steps (RLLab's reward)",
        ("long_pole", "heavy", "flipped"),
    ),
    "pendulum": Entry(
        "envs.balancing.pendulum:SPEC",
        "MuJoCo InvertedPendulum-v5: balance the pole for 1000 steps",
        ("long_pole", "heavy", "flipped"),
    ),
    "highway": Entry(
        "envs.driving.highway:SPEC",
        "highway-env, three lanes, steering and acceleration: drive fast without crashing for 30 s",
        ("dense",),
    ),
    "cartpole_discrete": Entry(
        "envs.balancing.cartpole_discrete:SPEC",
        "Gymnasium's CartPole-v1, two actions: keep the pole upright for 500 steps",
        ("long_pole", "heavy", "flipped"),
    ),
    "swingup": Entry(
        "envs.swingups.swingup:SPEC",
        "Gymnasium's Pendulum-v1: swing a pendulum up with a weak motor, and hold it for 10 s",
        ("long", "heavy", "gravity", "light", "flipped"),
    ),
    "cartpole_swingup": Entry(
        "envs.swingups.cartpole_swingup:SPEC",
        "RLLab's Cart-Pole Swing Up: swing the pole up from hanging, and hold it, within 25 s",
        ("long_pole", "heavy", "gravity", "flipped"),
    ),
    "acrobot": Entry(
        "envs.swingups.acrobot:SPEC",
        "RLLab's Acrobot: lift two links upright by a motor between them, and hold them, within 10 s",
        ("long", "heavy", "flipped"),
    ),
    "point_maze": Entry(
        "envs.point_maze:SPEC",
        "AIRL's maze: push a ball around the end of a wall to a target, 100 steps",
        ("wall_moved", "flipped"),
    ),
    "double_pendulum": Entry(
        "envs.mujoco_tasks:DOUBLE_PENDULUM",
        "MuJoCo InvertedDoublePendulum-v5: balance two poles on a cart for 1000 steps",
        ("heavy", "gravity", "flipped"),
    ),
    "reacher": Entry(
        "envs.mujoco_tasks:REACHER",
        "MuJoCo Reacher-v5: reach a target with an arm of two links, 50 steps",
        ("heavy", "flipped"),
    ),
    "halfcheetah": Entry(
        "envs.mujoco_tasks:HALFCHEETAH",
        "MuJoCo HalfCheetah-v5: run, 1000 steps",
        ("weak_leg", "heavy", "flipped"),
    ),
    "hopper": Entry(
        "envs.mujoco_tasks:HOPPER",
        "MuJoCo Hopper-v5: hop without falling, up to 1000 steps",
        ("weak_foot", "heavy", "flipped"),
    ),
    "walker2d": Entry(
        "envs.mujoco_tasks:WALKER2D",
        "MuJoCo Walker2d-v5: walk without falling, up to 1000 steps",
        ("weak_leg", "heavy", "flipped"),
    ),
    "gridworld": Entry(
        "envs.gridworld:SPEC",
        "objectworld, 12 by 12 cells: find what pays, avoid what costs; the model is known",
    ),
}
IMAGES = {
    "swingup_pixels": Entry(
        "envs.swingups.swingup_pixels:SPEC",
        "swingup as a camera sees it, in 32 by 32 pixels",
        ENVS["swingup"].variants,
        experts="swingup",
    ),
    "carracing": Entry(
        "envs.racing.carracing:SPEC",
        "Gymnasium's CarRacing-v3 in 48 by 48 pixels: drive a lap of a new track within 20 s",
        ("turned", "slippery"),
        needs="Box2D",
    ),
}
"""Tasks that are seen in images."""
DRIVING = {
    "drive_state": Entry(
        "envs.hills.drive:SPEC",
        "MuJoCo: drive a car along a new hilly road in each episode, 20 s",
        ("weak_tyres", "heavy", "steering_flipped"),
    ),
    "drive": Entry(
        "envs.hills.drive_images:SPEC",
        "drive_state through the car's camera, in 32 by 16 pixels of distance and road",
        ("weak_tyres", "heavy", "steering_flipped", "camera_lowered"),
        experts="drive_state",
    ),
}
"""A car on hilly roads."""
OTHER_ENVS = {**DRIVING, **IMAGES}
"""Tasks that run when they are named, and are not part of 'all'."""

GROUPS = {
    "classic": ("cartpole", "pendulum", "highway"),
    "swingups": ("swingup", "cartpole_swingup", "acrobot"),
    "locomotion": ("halfcheetah", "hopper", "walker2d"),
    "tabular": ("gridworld",),
    "images": (*IMAGES,),
    "driving": (*DRIVING,),
}
"""Names that stand for several environments."""
METHOD_GROUPS = {"thesis": (*THESIS,)}
"""Names that stand for several methods."""
BUILT_IN = {"method": (*METHODS, *VARIANTS), "env": (*ENVS, *OTHER_ENVS)}
"""Names of this program's own methods and tasks."""
