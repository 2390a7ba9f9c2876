"""Trials in MuJoCo: scene, contacts, motion of the arm, runner, and pictures. Only this package imports MuJoCo.

The names below load their module on first use: settings are light, and graphics are chosen before MuJoCo loads.
"""

from typing import TYPE_CHECKING

from testbed.packages import lazy_names

if TYPE_CHECKING:
    from testbed.simulation.rendering import BodyPoses, Playback, body_poses
    from testbed.simulation.runner import SimulationRunner
    from testbed.simulation.settings import ContactSettings, GripSettings, ServoSettings, SimulationSettings


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

__getattr__, __dir__ = lazy_names(__name__)
