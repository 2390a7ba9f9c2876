"""Values that figures, recordings and reports draw: an estimate, a trial, its wrench, and a plan of actions."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Bool, Float, Int

from estimators.base import Trace
from testbed.actions.base import Action
from testbed.errors import InvalidValueError
from testbed.foot_forces import FootForces
from testbed.objects.model import MassDistribution, ObjectShape
from testbed.trajectory import Trajectory
from testbed.validation import frozen_array

if TYPE_CHECKING:
    from testbed.simulation.rendering import BodyPoses

LEVEL, DEVIATIONS = "90 %", 1.645
"""Probability of an interval, and its half width in standard deviations."""
MOST_FRAMES = 200
"""Largest number of frames of a recording."""
ARC, WAY = math.radians(70), 0.05
"""Longest part of a motion that its arrow covers: angle [rad], and length [m]."""
IN_PLACE, PLACE_RADIUS = 0.008, 0.012
"""Radius [m] below which a turn counts as in place, and radius [m] with which it is then drawn."""
NUMBER_AWAY = 0.035
"""Distance of an action's number from its mark, relative to the size of the drawing."""
FINE = 24
"""Points along a stroke of the drawing."""
_SUPPORT_NAMES = {"own_weight": "own weight", "rigid": "rigid body"}


def support_name(support: object) -> str:
    """Name of a support model on screen."""
    return _SUPPORT_NAMES.get(str(support), str(support))


def evenly(count: int, most: int = MOST_FRAMES) -> Int[np.ndarray, "F"]:
    """Indices of at most `most` of `count` samples, evenly spread, with the first and the last."""
    return np.unique(np.linspace(0, count - 1, min(count, most)).round().astype(np.int64))


@dataclass(frozen=True, eq=False)
class EstimateView:
    """An estimate as it is drawn: answer, truth, iterations and facts."""

    title: str
    """Object, method and sensing."""
    shape: ObjectShape
    """Geometry of the object."""
    truth: MassDistribution | None = None
    """True masses and friction; None on a real object."""
    answer: MassDistribution | None = None
    """Estimated masses and friction; None where the method has no answer."""
    covariance: Float[np.ndarray, "n_m n_m"] | None = None
    """Covariance of the particle masses [kg^2]."""
    traces: tuple[Trace, ...] = ()
    """Iterations of the method; those that led to the answer first."""
    trajectory: Trajectory | None = None
    """Trial in which the particles' velocities are drawn."""
    facts: Mapping[str, str] = field(default_factory=dict)
    """Further facts by name; "method" names the estimate in a comparison."""

    def __post_init__(self) -> None:
        shape = self.shape
        for name, masses in (("truth", self.truth), ("answer", self.answer)):
            for part, count in (("mass", shape.n_m), ("friction", shape.n_mu)) if masses is not None else ():
                values = getattr(masses, part)
                if len(values) != count:
                    allowed = f"{count} numbers, one per group"
                    raise InvalidValueError(f"EstimateView.{name}.{part}", values.tolist(), allowed)
        if self.covariance is not None:
            square = (shape.n_m, shape.n_m)
            checked = frozen_array("EstimateView.covariance", self.covariance, square, finite=False)
            object.__setattr__(self, "covariance", checked)
        for trace in self.traces:
            if trace.mass.size and trace.mass.shape != (len(trace.loss), shape.n_m):
                allowed = f"({len(trace.loss)}, {shape.n_m}), or none"
                raise InvalidValueError(f"EstimateView.traces.{trace.method}.mass", trace.mass.shape, allowed)
        object.__setattr__(self, "traces", tuple(self.traces))

    @property
    def method(self) -> str:
        """Name of the method; the title where the facts have none."""
        return self.facts.get("method", self.title)

    @property
    def true_mass(self) -> Float[np.ndarray, "n_m"] | None:
        """True mass of each group [kg]."""
        return None if self.truth is None else self.truth.group_mass(self.shape)

    @property
    def mass(self) -> Float[np.ndarray, "n_m"] | None:
        """Estimated mass of each group [kg]."""
        return None if self.answer is None else self.answer.group_mass(self.shape)

    @property
    def difference(self) -> Float[np.ndarray, "n_m"] | None:
        """Absolute difference |estimate - truth| of each group [kg]."""
        mass, truth = self.mass, self.true_mass
        return None if mass is None or truth is None else np.abs(mass - truth)

    @property
    def nad(self) -> float | None:
        """Normalized absolute difference, the paper's eta_1: sum of `difference` over the true mass."""
        difference, truth = self.difference, self.true_mass
        return None if difference is None or truth is None else float(difference.sum() / truth.sum())

    @property
    def half_width(self) -> Float[np.ndarray, "n_m"] | None:
        """Half width of the interval of each group's mass [kg]; NaN where the variance is unknown or infinite."""
        if self.covariance is None:
            return None
        variance = np.diagonal(self.covariance)
        deviation = np.sqrt(np.where((variance >= 0) & np.isfinite(variance), variance, np.nan))
        return DEVIATIONS * deviation * self.shape.particles_per_group

    @property
    def iterates(self) -> tuple[Int[np.ndarray, "F"], Float[np.ndarray, "F n_m"]] | None:
        """Iterations and the mass of each group at them [kg]; the last entry, or the only one, is the answer."""
        mass = self.mass
        if mass is None:
            return None
        if not self.traces or not self.traces[0].mass.size:
            return np.zeros(1, dtype=np.int64), mass[None]
        traced = self.traces[0].mass * self.shape.particles_per_group
        kept = evenly(len(traced), MOST_FRAMES - 1)
        return np.append(kept, len(traced)), np.vstack([traced[kept], mass])


@dataclass(frozen=True, eq=False)
class WrenchFit:
    """Wrench on the object in one trial, measured and predicted: force x and y [N], torque about z [N m], T samples."""

    label: str
    """Name of the trial."""
    time_s: Float[np.ndarray, "T"]
    """Time [s]."""
    measured: Float[np.ndarray, "T 3"]
    """Measured wrench after tare and tool compensation."""
    steady: Bool[np.ndarray, "T"]
    """True at the samples that estimators use."""
    predicted: Float[np.ndarray, "T 3"]
    """Predicted wrench; NaN outside the steady stretches, or everywhere without a model."""
    band: Float[np.ndarray, "T 3"]
    """Half width of the band around the prediction that holds 95 % of single samples, by the sensor's errors."""
    frame: str = "object axes, about the grasp point"
    """Axes and reference point."""

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


@dataclass(frozen=True, eq=False)
class TrialView:
    """A trial as it is drawn: trajectory, poses, wrench and facts."""

    title: str
    """Object and action."""
    shape: ObjectShape
    """Geometry of the object."""
    trajectory: Trajectory
    """Trajectory as sensed, with the wrench on the object."""
    poses: BodyPoses
    """Poses of the robot's bodies at N samples."""
    pose_times: Float[np.ndarray, "N"]
    """Times of the poses [s]."""
    fit: WrenchFit
    """Wrench in the object's axes, measured and predicted."""
    model: str = ""
    """Name of the masses that the prediction uses; empty without a prediction."""
    truth: MassDistribution | None = None
    """True masses and friction; None on a real object."""
    feet: FootForces | None = None
    """Forces on the feet; None where they were not recorded."""
    facts: Mapping[str, str] = field(default_factory=dict)
    """Further facts by name."""


@dataclass(frozen=True, eq=False)
class ActionArrow:
    """An action as it is drawn on the object, object frame."""

    grasp: Float[np.ndarray, "2"]
    """Grasp point, or first contact point of a push [m]."""
    pivot: Float[np.ndarray, "2"] | None
    """Center of the turn [m]; None for a slide or a push."""
    way: Float[np.ndarray, "N 2"]
    """Line of the arrow [m]; its head is the last point."""
    accelerated: bool
    """True if the turn is accelerated."""

    @staticmethod
    def of(shape: ObjectShape, action: Action) -> ActionArrow:
        """Arrow along the first part of an action's motion; for a push, along its approach."""
        hand = action.hand(shape)[0]
        if not action.turns:
            ends = [-1.0, 0.0] if action.pushes else [0.0, 1.0]
            return ActionArrow(hand, None, hand + WAY * np.outer(ends, action.heading), accelerated=False)
        pivot, speed = action.center(shape), action.steady[0].speed
        arm = hand - pivot
        radius, begin = float(np.linalg.norm(arm)), math.atan2(arm[1], arm[0])
        if radius < IN_PLACE:
            radius, begin = PLACE_RADIUS, 0.0
        angle = begin + math.copysign(min(ARC, WAY / radius), speed) * np.linspace(0.0, 1.0, 12)
        way = pivot + radius * np.column_stack([np.cos(angle), np.sin(angle)])
        return ActionArrow(hand, pivot, way, action.accelerated)

    @property
    def label(self) -> Float[np.ndarray, "2"]:
        """Place of the action's number [m]."""
        return self.way[-1] if self.pivot is None else self.pivot

    @property
    def strokes(self) -> Float[np.ndarray, "N 2"]:
        """Points along every line of the drawing [m]."""
        arms = [] if self.pivot is None else [np.linspace(self.grasp, self.pivot, FINE)]
        parts = [np.linspace(a, b, FINE) for a, b in zip(self.way[:-1], self.way[1:], strict=True)]
        return np.vstack([*parts, *arms])


@dataclass(frozen=True, eq=False)
class ActionsView:
    """T actions on one object."""

    shape: ObjectShape
    """Geometry of the object."""
    actions: tuple[Action, ...]
    """Actions in order."""

    @property
    def arrows(self) -> dict[int, ActionArrow]:
        """Arrows of the actions on the table, by their number from 1."""
        return {n: ActionArrow.of(self.shape, a) for n, a in enumerate(self.actions, start=1) if a.on_table}

    @property
    def lifts(self) -> dict[int, Float[np.ndarray, "2"]]:
        """Grasp points [m] of the lifts, by their number from 1."""
        numbered = enumerate(self.actions, start=1)
        return {n: self.shape.grasps[a.grasp].position for n, a in numbered if a.in_air and a.grasp is not None}

    @property
    def strokes(self) -> Float[np.ndarray, "N 2"]:
        """Points along every line of the drawing, and its marks [m], object frame."""
        marks = [*(arrow.strokes for arrow in self.arrows.values()), *(point[None] for point in self.lifts.values())]
        return np.vstack([np.empty((0, 2)), *marks])

    @property
    def number_places(self) -> dict[int, Float[np.ndarray, "2"]]:
        """Centers of the actions' labels [m], by number: near the mark, farthest from strokes and earlier labels."""
        arrows, lifts = self.arrows, self.lifts
        away = NUMBER_AWAY * float(np.ptp(self.bounds, axis=0).max())
        angles = np.linspace(0, 2 * np.pi, 16, endpoint=False)
        around = away * np.column_stack([np.cos(angles), np.sin(angles)])
        drawn, places = self.strokes, {}
        for number in sorted(arrows | lifts):
            candidates = (arrows[number].label if number in arrows else lifts[number]) + around
            gaps = np.linalg.norm(candidates[:, None] - drawn, axis=-1).min(axis=1)
            places[number] = candidates[int(gaps.argmax())]
            drawn = np.vstack([drawn, places[number]])
        return places

    @property
    def bounds(self) -> Float[np.ndarray, "2 2"]:
        """Lower left and upper right corner around the object and all arrows [m]."""
        points = np.concatenate([self.shape.particles, *(arrow.strokes for arrow in self.arrows.values())])
        return np.stack([points.min(axis=0) - self.shape.cell, points.max(axis=0) + self.shape.cell])


@dataclass(frozen=True, eq=False)
class PlanView(ActionsView):
    """A plan of T actions, and the expected errors of the masses after them."""

    errors: Float[np.ndarray, "T+1 n_m"]
    """Expected standard error of each group's mass [kg]: after the weighing, then after each action."""
    title: str
    """Object and settings."""
    words: tuple[str, ...] = ()
    """Description of each action."""

    @property
    def grams(self) -> Float[np.ndarray, "T+1 n_m"]:
        """Expected standard errors [g]."""
        return 1e3 * self.errors
