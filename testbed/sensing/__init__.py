"""Sensing: errors of a sensor, tare and tool compensation, drift, a camera, and the windows that estimators read.

Names are imported on first use.
"""

from typing import TYPE_CHECKING

from testbed.packages import lazy_names

if TYPE_CHECKING:
    from testbed.sensing.camera import CAMERAS, Camera, PoseStream, SeenMotion
    from testbed.sensing.compensation import compensate, tare_biases
    from testbed.sensing.drift import Drift, DriftLimit, drift_of, judge_drift
    from testbed.sensing.lift_windows import LiftWindow, lift_windows
    from testbed.sensing.noise import draw_sensing, read_scale
    from testbed.sensing.presets import PRESETS, Sensing, preset
    from testbed.sensing.push_windows import push_windows
    from testbed.sensing.windows import SteadyWindow, steady_windows, weight_of

__all__ = [
    "CAMERAS",
    "PRESETS",
    "Camera",
    "Drift",
    "DriftLimit",
    "LiftWindow",
    "PoseStream",
    "SeenMotion",
    "Sensing",
    "SteadyWindow",
    "compensate",
    "draw_sensing",
    "drift_of",
    "judge_drift",
    "lift_windows",
    "preset",
    "push_windows",
    "read_scale",
    "steady_windows",
    "tare_biases",
    "weight_of",
]

__getattr__, __dir__ = lazy_names(__name__)
