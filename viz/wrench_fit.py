"""The wrench of one trial, measured and as a model has it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from testbed.arrays import frozen_array
from testbed.errors import InvalidValueError


@dataclass(frozen=True, eq=False)
class WrenchFit:
    """T samples of what the gripper does to the object: force x and y, N, and torque about z, N m."""

    label: str
    """The trial, in words."""
    time_s: Float[np.ndarray, "T"]
    """s."""
    measured: Float[np.ndarray, "T 3"]
    """After tare and tool compensation."""
    steady: Bool[np.ndarray, "T"]
    """Which samples an estimator is given."""
    predicted: Float[np.ndarray, "T 3"]
    """NaN outside the steady stretches, or everywhere without a model."""
    band: Float[np.ndarray, "T 3"]
    """Half the width of the band around the prediction in which the sensor's errors leave 95 % of single samples."""
    frame: str = "object axes, about the grasp point"
    """In which axes, and about which point."""

    def __post_init__(self) -> None:
        time = frozen_array("WrenchFit.time_s", self.time_s, (None,))
        object.__setattr__(self, "time_s", time)
        for name in ("measured", "predicted", "band"):
            values = frozen_array(f"WrenchFit.{name}", getattr(self, name), (len(time), 3), finite=False)
            object.__setattr__(self, name, values)
        steady = np.array(self.steady)
        if steady.dtype != bool or steady.shape != time.shape:
            allowed = f"true or false a sample, ({len(time)},)"
            raise InvalidValueError("WrenchFit.steady", f"{steady.dtype} of shape {steady.shape}", allowed)
        object.__setattr__(self, "steady", steady)
