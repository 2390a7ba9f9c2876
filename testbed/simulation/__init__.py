"""Trials in MuJoCo: scene, contacts, motion of the arm, runner, and pictures. Only this package imports MuJoCo.

The names below load their module on first use: settings are light, and graphics are chosen before MuJoCo loads.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from testbed.simulation.rendering import BodyPoses, Playback, body_poses
    from testbed.simulation.runner import SimulationRunner
    from testbed.simulation.settings import ContactSettings, GripSettings, ServoSettings, SimulationSettings

_MODULES = {
    "rendering": ("BodyPoses", "Playback", "body_poses"),
    "runner": ("SimulationRunner",),
    "settings": ("ContactSettings", "GripSettings", "ServoSettings", "SimulationSettings"),
}
_MODULE_OF = {name: f"{__name__}.{module}" for module, names in _MODULES.items() for name in names}

__all__ = [
    "BodyPoses",
    "ContactSettings",
    "GripSettings",
    "Playback",
    "ServoSettings",
    "SimulationRunner",
    "SimulationSettings",
    "body_poses",
]


def __getattr__(name: str) -> Any:
    if name not in _MODULE_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_MODULE_OF[name]), name)
