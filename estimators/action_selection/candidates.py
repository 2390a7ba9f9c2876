"""Candidate actions, drawn from a continuous family over grasps, pivots, directions, speeds and durations."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int

from estimators.action_selection.random import random_pushes
from testbed.actions.accelerate import Accelerate
from testbed.actions.base import Action
from testbed.actions.lift import Lift
from testbed.actions.path import RAMP_TIME, WORKSPACE, outline, overhang, overhang_of
from testbed.actions.rotate import Rotate
from testbed.actions.slide import Slide
from testbed.errors import InvalidValueError
from testbed.frames import rotation_2d
from testbed.objects.faces import faces
from testbed.objects.model import ObjectShape
from testbed.validation import check_integer, is_number

REACH = (0.20, 0.70)
"""Least and greatest distance of the TCP from the arm's base [m]; the simulated inverse kinematics fail beyond."""
SWEEP_POINTS = 7
"""Points of a turn's path that are compared with the reach."""
SLIDE_PART, ACCELERATED_PART, LIFT_PART, PUSH_PART = 0.1, 0.02, 0.005, 0.025
"""Parts of all candidates; the rest are turns."""
SLIDE_DURATION = (1.6, 4.0)
"""Least and greatest time at constant speed of a slide [s]."""
HALF = 4
"""Number of accelerations of a short accelerated turn, half of the default's."""
MOST_PUSHES, MOST_DRAGS = 200, 100
"""Most pushes among the candidates, and most slides and turns of links: each is followed to its end."""


@dataclass(frozen=True)
class ActionFamily:
    """Family of actions to consider. Turns go there and back: friction flips, and a constant bias does not."""

    duration: tuple[float, float] = (4.0, 18.0)
    """Least and greatest time at constant speed of a turn each way [s]."""
    speed_deg_s: tuple[float, float] = (6.0, 12.0)
    """Least and greatest speed of a turn [deg/s]."""
    arm: float = 0.2
    """Greatest distance of the pivot from the grasp [m]."""
    slides: bool = True
    """Include slides."""
    accelerated: bool = True
    """Include accelerated turns."""
    one_way: bool = False
    """Turn one way only: shorter, but the sensor's bias stays in."""
    lifts: bool = False
    """Include lifts: only a rigid body can be lifted."""
    pushes: bool = False
    """Include pushes; an object without grasps is pushed in any case."""

    def __post_init__(self) -> None:
        for name, least in (("duration", 1.5), ("speed_deg_s", 0.0)):
            low, high = getattr(self, name)
            if not (is_number(low) and is_number(high) and least < low <= high):
                allowed = f"the least and the most, above {least:g}, in that order"
                raise InvalidValueError(f"ActionFamily.{name}", (low, high), allowed)
        if not (is_number(self.arm) and self.arm >= 0):
            raise InvalidValueError("ActionFamily.arm", self.arm, "a finite number >= 0, m")

    def sample(self, shape: ObjectShape, grasps: Sequence[int], count: int, seed: int) -> tuple[Action, ...]:
        """Draw actions that the arm can reach and that keep the object on the table, and pushes anywhere.

        Pivots are uniform in direction and distance from the grasp, durations in their logarithm; pushes are as
        published. For an object in links, all actions are slides and turns one way at constant speed.

        Args:
            shape: geometry and grasps.
            grasps: allowed grasps; without any, all actions are pushes.
            count: approximate number of actions. At least one accelerated turn, one turn, one push and two lifts per
                grasp are drawn, if the family has them; fewer than `count` where actions are not possible, and beyond
                `MOST_PUSHES` and `MOST_DRAGS`.
            seed: seed of the draw.

        Raises:
            InvalidValueError: `count` is no integer >= 1, or pushes of an object with hinges.
        """
        check_integer("count", count)
        family, linked = self, shape.chain is not None
        if linked and self.pushes:
            raise InvalidValueError("pushes", self.pushes, "none: an object with hinges is not pushed")
        if linked:  # links trail behind the hand only one way at constant speed
            count = min(count, MOST_DRAGS)
            family = replace(self, one_way=True, accelerated=False, lifts=False)
        pushed = not linked and (self.pushes or not shape.grasps) and bool(faces(shape))
        if len(grasps) == 0:
            return tuple(random_pushes(shape, min(count, MOST_PUSHES), seed)) if pushed else ()
        rng = np.random.default_rng(seed)
        allowed = np.asarray(grasps, dtype=int)
        lifts = max(round(LIFT_PART * count), 2 * len(allowed)) if family.lifts else 0
        slides = round(SLIDE_PART * count) if self.slides else 0
        accelerated = max(round(ACCELERATED_PART * count), 1) if family.accelerated else 0
        pushes = min(max(round(PUSH_PART * count), 1), MOST_PUSHES) if pushed else 0
        return (
            *self._accelerated(shape, allowed, accelerated, rng),
            *self._slides(shape, allowed, slides, rng),
            *family._turns(shape, allowed, max(count - slides - accelerated - lifts - pushes, 1), rng),
            *self._lifts(shape, allowed, lifts, rng),
            *random_pushes(shape, pushes, seed),
        )

    def _turns(
        self, shape: ObjectShape, allowed: Int[np.ndarray, "G"], count: int, rng: np.random.Generator
    ) -> list[Rotate]:
        found: list[Rotate] = []
        positions, angles = _places(shape)
        corners = outline(shape)
        for _ in range(20):  # a few rounds suffice, unless hardly any pivot is in reach
            grasp = rng.choice(allowed, 2 * count)
            radius, way = self.arm * rng.random(2 * count), rng.uniform(0, 2 * math.pi, 2 * count)
            pivot = (positions[grasp] + radius[:, None] * np.column_stack([np.cos(way), np.sin(way)])).round(4)
            low, high = np.log(self.duration)
            duration = np.exp(rng.uniform(low, high, 2 * count)).round(1)
            slow, fast = np.radians(self.speed_deg_s)
            speed = rng.choice((-1.0, 1.0), 2 * count) * rng.uniform(slow, fast, 2 * count)
            fits = clear_of_particles(shape, pivot)
            turn = speed * (duration + RAMP_TIME)
            fits &= sweep_in_reach(positions[grasp], angles[grasp], pivot, turn)
            fits &= stays_on_table(corners, positions[grasp], angles[grasp], pivot, turn)
            for i in np.flatnonzero(fits)[: count - len(found)]:
                x, y = pivot[i]
                about = float(x), float(y)
                found.append(Rotate(int(grasp[i]), float(speed[i]), float(duration[i]), about, not self.one_way))
            if len(found) >= count:
                break
        return found

    def _slides(
        self, shape: ObjectShape, allowed: Int[np.ndarray, "G"], count: int, rng: np.random.Generator
    ) -> list[Slide]:
        """Straight lines at 5 cm/s, centered in the workspace: all within reach."""
        positions, angles = _places(shape)
        grasps, ways = rng.choice(allowed, count), rng.uniform(-math.pi, math.pi, count)
        durations = np.exp(rng.uniform(np.log(SLIDE_DURATION[0]), np.log(SLIDE_DURATION[1]), count)).round(1)
        length = Slide.speed * (durations + RAMP_TIME)
        along = length[:, None] * np.column_stack([np.cos(ways), np.sin(ways)])
        at = positions[grasps]
        fits = stays_on_table(outline(shape), at, angles[grasps], at, np.zeros(count), along)
        rows = zip(grasps[fits], ways[fits], durations[fits], strict=True)
        return [Slide(int(g), float(w), duration=float(t)) for g, w, t in rows]

    def _accelerated(
        self, shape: ObjectShape, allowed: Int[np.ndarray, "G"], count: int, rng: np.random.Generator
    ) -> list[Accelerate]:
        """Turns of stepped acceleration both ways, whole or half as long as the default."""
        found = []
        for index in range(count):
            grasp, sign = int(allowed[index % len(allowed)]), (1.0, -1.0)[(index // len(allowed)) % 2]
            whole = Accelerate(grasp)
            steps = whole.accelerations[: (None, HALF)[int(rng.integers(2))]]
            if index < 2 * len(allowed):
                steps = whole.accelerations
            found.append(Accelerate(grasp, tuple(sign * a for a in steps), whole.hold, sign * whole.start_speed))
        each = dict.fromkeys(found)
        paths = {a: a.centered_path(shape, a.profile(0.01).length) for a in each}
        return [action for action, path in paths.items() if (overhang_of(shape, path) <= 0).all()]

    def _lifts(
        self, shape: ObjectShape, allowed: Int[np.ndarray, "G"], count: int, rng: np.random.Generator
    ) -> list[Lift]:
        """Default lift and stop-and-go lift of each grasp, then lifts with other holds, swings and tilts.

        Tilts and accelerations are those at which the errors of a lift were measured.
        """
        found = [make(int(grasp)) for make in (Lift, Lift.stop_and_go) for grasp in allowed][:count]
        for index in range(count - len(found)):
            hold, swings = float(np.exp(rng.uniform(np.log(1.5), np.log(4.0))).round(1)), 2 * int(rng.integers(0, 6))
            grasp, tilt = int(allowed[index % len(allowed)]), math.radians(rng.integers(10, 31))
            poses = int(rng.integers(3, 6))
            found.append(
                Lift(grasp, hold=hold, swings=swings) if swings else Lift.stop_and_go(grasp, tilt, poses, hold)
            )
        positions, angles = _places(shape)
        at = np.array([lift.grasp for lift in found], dtype=int)
        fits = stays_on_table(outline(shape), positions[at], angles[at], positions[at], np.zeros(len(at)))
        return [lift for lift, stays in zip(found, fits, strict=True) if stays]


def clear_of_particles(shape: ObjectShape, points: Float[np.ndarray, "N 2"]) -> np.ndarray:
    """Mask of the points well between particles, (N,): a particle at a turn's center has no direction of motion."""
    distance = np.linalg.norm(shape.particles[None] - points[:, None], axis=-1).min(axis=1)
    return distance > shape.cell / 4


def _places(shape: ObjectShape) -> tuple[Float[np.ndarray, "G 2"], Float[np.ndarray, "G"]]:
    """Grasp points [m] and closing directions [rad], object frame."""
    return np.array([grasp.position for grasp in shape.grasps]), np.array([grasp.angle for grasp in shape.grasps])


def stays_on_table(
    corners: Float[np.ndarray, "K 2"],
    grasp: Float[np.ndarray, "N 2"],
    grasp_angle: Float[np.ndarray, "N"],
    pivot: Float[np.ndarray, "N 2"],
    turn: Float[np.ndarray, "N"],
    slide: Float[np.ndarray, "N 2"] | None = None,
) -> np.ndarray:
    """True for actions that keep the outline on the table, the TCP's path centered in the workspace, (N,).

    Args:
        corners: corners of the object's outline [m], object frame.
        grasp: grasp point [m], object frame.
        grasp_angle: closing direction [rad], object frame.
        pivot: center of the turn [m], object frame; of a slide, the grasp point.
        turn: angle of the whole turn [rad].
        slide: displacement over the whole way [m], object frame; zero if left out.
    """
    into_world = rotation_2d(-grasp_angle)
    center = np.array(WORKSPACE) - np.einsum("nij,nj->ni", into_world, grasp - pivot)
    along = np.zeros_like(center) if slide is None else np.einsum("nij,nj->ni", into_world, slide)
    return overhang(corners, pivot, center, -grasp_angle, turn, along).max(axis=1) <= 0


def sweep_in_reach(
    grasp: Float[np.ndarray, "N 2"],
    grasp_angle: Float[np.ndarray, "N"],
    pivot: Float[np.ndarray, "N 2"],
    turn: Float[np.ndarray, "N"],
) -> np.ndarray:
    """True for turns that keep the TCP within the arm's reach, their path centered in the workspace, (N,).

    A quick check before inverse kinematics.

    Args:
        grasp: grasp point [m], object frame.
        grasp_angle: closing direction [rad], object frame.
        pivot: center of the turn [m], object frame.
        turn: angle of the whole turn [rad].
    """
    into_world = rotation_2d(-grasp_angle)
    arm = np.einsum("nij,nj->ni", into_world, grasp - pivot)
    center = np.array(WORKSPACE) - arm
    fits = np.ones(len(grasp), dtype=bool)
    for part in np.linspace(-0.5, 0.5, SWEEP_POINTS):
        place = center + np.einsum("nij,nj->ni", rotation_2d(part * turn), arm)
        distance = np.linalg.norm(place, axis=1)
        fits &= (distance > REACH[0]) & (distance < REACH[1])
    return fits
