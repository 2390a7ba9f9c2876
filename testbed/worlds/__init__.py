"""Worlds: how far a lab is from the estimators' model of it, drawn for each object and trial, and what is stated.

Names are imported on first use.
"""

from typing import TYPE_CHECKING

from testbed.packages import lazy_names

if TYPE_CHECKING:
    from testbed.worlds.draw import WorldDraw
    from testbed.worlds.feet import Feet
    from testbed.worlds.presets import WORLDS, World, world
    from testbed.worlds.setup_errors import EXACT_SETUP, SetupErrors


__all__ = ["EXACT_SETUP", "WORLDS", "Feet", "SetupErrors", "World", "WorldDraw", "world"]

__getattr__, __dir__ = lazy_names(__name__)
