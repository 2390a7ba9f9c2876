"""Testbed: objects, actions, trials and trajectories, sensing, and the simulation or robot that runs trials.

Names are imported on first use: `import testbed` alone loads nothing but the standard library.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from testbed.actions.accelerate import Accelerate
    from testbed.actions.base import Action, TableAction, action_from_dict
    from testbed.actions.lift import Lift
    from testbed.actions.rotate import Rotate
    from testbed.actions.slide import Slide
    from testbed.actions.weigh import Weigh
    from testbed.errors import HeftError, InfeasibleTrialError, InvalidValueError
    from testbed.objects.blocks import block_object
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

_MODULES = {
    "actions.accelerate": ("Accelerate",),
    "actions.base": ("Action", "TableAction", "action_from_dict"),
    "actions.lift": ("Lift",),
    "actions.rotate": ("Rotate",),
    "actions.slide": ("Slide",),
    "actions.weigh": ("Weigh",),
    "errors": ("HeftError", "InfeasibleTrialError", "InvalidValueError"),
    "objects.blocks": ("block_object",),
    "objects.files": ("load_object",),
    "objects.model": ("GRAVITY", "Grasp", "MassDistribution", "ObjectModel", "ObjectShape"),
    "replay": ("ReplayRunner",),
    "sensing.noise": ("draw_sensing",),
    "sensing.presets": ("Sensing", "preset"),
    "sensing.windows": ("steady_windows", "weight_of"),
    "simulation.runner": ("SimulationRunner",),
    "simulation.settings": ("SimulationSettings",),
    "trajectory": ("Phase", "Tool", "Trajectory", "load_trajectory", "save_trajectory"),
    "trial": ("OWN_WEIGHT", "RIGID", "Support", "Trial", "TrialRunner"),
}
_MODULE_OF = {name: f"{__name__}.{module}" for module, names in _MODULES.items() for name in names}

__all__ = [
    "GRAVITY",
    "OWN_WEIGHT",
    "RIGID",
    "Accelerate",
    "Action",
    "Grasp",
    "HeftError",
    "InfeasibleTrialError",
    "InvalidValueError",
    "Lift",
    "MassDistribution",
    "ObjectModel",
    "ObjectShape",
    "Phase",
    "ReplayRunner",
    "Rotate",
    "Sensing",
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
    "action_from_dict",
    "block_object",
    "draw_sensing",
    "load_object",
    "load_trajectory",
    "preset",
    "save_trajectory",
    "steady_windows",
    "weight_of",
]


def __getattr__(name: str) -> Any:
    if name not in _MODULE_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_MODULE_OF[name]), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
