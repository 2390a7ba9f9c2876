"""Trials of one object for figures and reports: actions, contact paths of pushes, and joint angles of links."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Self

import numpy as np
from jaxtyping import Float

from testbed.errors import InvalidValueError
from testbed.objects.model import ObjectShape
from testbed.sensing.camera import PoseStream
from testbed.sensing.push_windows import contact_path
from testbed.trajectory import Trajectory
from viz.values import ActionsView


@dataclass(frozen=True, eq=False)
class TrialsView(ActionsView):
    """T trials of one object, numbered from 1."""

    title: str
    """Object and setting."""
    contacts: Mapping[int, Float[np.ndarray, "W 2"]] = field(default_factory=dict)
    """Contact points of each push in order [m], object frame, by number."""
    cameras: Mapping[int, PoseStream] = field(default_factory=dict)
    """Measured poses of the links in each trial, by number."""

    @classmethod
    def of(cls, shape: ObjectShape, trajectories: Sequence[Trajectory], title: str) -> Self:
        """View of the trials whose action moves."""
        moved = dict(enumerate((trial for trial in trajectories if trial.action.moves), start=1))
        contacts = {n: path for n, trial in moved.items() if len(path := push_contacts(shape, trial))}
        cameras = {n: t.camera for n, t in moved.items() if shape.chain is not None and t.camera is not None}
        return cls(shape, tuple(trial.action for trial in moved.values()), title, contacts, cameras)

    @property
    def strokes(self) -> Float[np.ndarray, "N 2"]:
        """Points along every line of the drawing, and its marks [m], object frame."""
        return np.vstack([super().strokes, *self.contacts.values()])

    def slid(self, number: int) -> float:
        """Distance between the first and the last contact point of a push [m]; NaN without contact points."""
        if number not in self.contacts:
            return np.nan
        return float(np.linalg.norm(self.contacts[number][-1] - self.contacts[number][0]))

    def joint_range(self, number: int, hinge: int) -> tuple[float, float]:
        """Least and greatest joint angle of a hinge in a trial [deg]; NaN where the camera measured none."""
        if number not in self.cameras:
            return np.nan, np.nan
        angle = self.cameras[number].joint_angles[:, hinge]
        measured = np.degrees(angle[~np.isnan(angle)])
        return (float(measured.min()), float(measured.max())) if len(measured) else (np.nan, np.nan)


def push_contacts(shape: ObjectShape, trajectory: Trajectory) -> Float[np.ndarray, "W 2"]:
    """Contact points of a push from the first contact on [m], object frame, shape (W, 2).

    Empty, of shape (0, 2), for other trials and where the camera measured too few poses.
    """
    if not trajectory.action.pushes:
        return np.empty((0, 2))
    try:
        return np.vstack([trajectory.action.hand(shape)[0], contact_path(shape, trajectory)])
    except InvalidValueError:
        return np.empty((0, 2))
