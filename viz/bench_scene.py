"""The bench in Rerun: arm, sensor, gripper and table, moving as a record has them."""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np
import rerun as rr
from jaxtyping import Float
from rerun_loader_mjcf import MJCFLogger

from viz.frames import SIM_TIME


class Poses(Protocol):
    """Where the B bodies of a model are at each of N samples."""

    @property
    def model(self) -> Any:
        """The compiled MJCF model."""
        ...

    @property
    def position(self) -> Float[np.ndarray, "N B 3"]:
        """m, world."""
        ...

    @property
    def orientation(self) -> Float[np.ndarray, "N B 4"]:
        """wxyz."""
        ...


class _Shapes(MJCFLogger):
    """Logs what bodies look like, and leaves out where they would be at rest."""

    def log_data(self, data: Any, recording: rr.RecordingStream | None = None) -> None:
        """Nothing: the record knows."""


def log_bench(stream: rr.RecordingStream, root: str, poses: Poses, time_s: Float[np.ndarray, "N"]) -> None:
    """Log the shapes once and the bodies' poses on `sim_time`; a body that never moves is static."""
    shapes = _Shapes(poses.model, root)
    shapes.log_model(stream)
    index = [rr.TimeColumn(SIM_TIME, duration=time_s)]
    for body in range(poses.model.nbody):
        entity = shapes.paths.body_path(poses.model.body(body).name)
        place, turn = poses.position[:, body], np.roll(poses.orientation[:, body], -1, axis=1)  # to xyzw
        if np.ptp(place, axis=0).max() + np.ptp(turn, axis=0).max() < 1e-9:
            stream.log(entity, rr.Transform3D(translation=place[0], quaternion=turn[0]), static=True)
        else:
            stream.send_columns(entity, index, rr.Transform3D.columns(translation=place, quaternion=turn))
