"""Testbed: objects, actions, trials and trajectories, sensing, and the simulation or robot that runs trials.

Names are imported on first use: `import testbed` alone loads nothing but the standard library.
"""

from typing import TYPE_CHECKING

from testbed.packages import lazy_names

if TYPE_CHECKING:
    from testbed.actions.accelerate import Accelerate
    from testbed.actions.base import Action, TableAction, action_from_dict
    from testbed.actions.lift import Lift
    from testbed.actions.push import Push
    from testbed.actions.rotate import Rotate
    from testbed.actions.slide import Slide
    from testbed.actions.weigh import Weigh
    from testbed.errors import HeftError, InfeasibleTrialError, InvalidValueError
    from testbed.objects.blocks import block_object
    from testbed.objects.faces import Face, faces
    from testbed.objects.files import load_object
    from testbed.objects.model import GRAVITY, Grasp, MassDistribution, ObjectModel, ObjectShape
    from testbed.replay import ReplayRunner
    from testbed.sensing.noise import draw_sensing
    from testbed.sensing.presets import Sensing, preset
    from testbed.sensing.windows import steady_windows, weight_of
    from testbed.simulation.runner import SimulationRunner
    from testbed.simulation.settings import SimulationSettings
    from testbed.trajectory import Phase, Tool, Trajectory, load_trajectory, save_trajectory
    from testbed.trial import OWN_WEIGHT, RIGID, Support, Trial, TrialRunner
    from testbed.validation import Range
    from testbed.worlds.draw import WorldDraw
    from testbed.worlds.presets import World, world
    from testbed.worlds.setup_errors import SetupErrors


__all__ = [
    "GRAVITY",
    "OWN_WEIGHT",
    "RIGID",
    "Accelerate",
    "Action",
    "Face",
    "Grasp",
    "HeftError",
    "InfeasibleTrialError",
    "InvalidValueError",
    "Lift",
    "MassDistribution",
    "ObjectModel",
    "ObjectShape",
    "Phase",
    "Push",
    "Range",
    "ReplayRunner",
    "Rotate",
    "Sensing",
    "SetupErrors",
    "SimulationRunner",
    "SimulationSettings",
    "Slide",
    "Support",
    "TableAction",
    "Tool",
    "Trajectory",
    "Trial",
    "TrialRunner",
    "Weigh",
    "World",
    "WorldDraw",
    "action_from_dict",
    "block_object",
    "draw_sensing",
    "faces",
    "load_object",
    "load_trajectory",
    "preset",
    "save_trajectory",
    "steady_windows",
    "weight_of",
    "world",
]

__getattr__, __dir__ = lazy_names(__name__)
