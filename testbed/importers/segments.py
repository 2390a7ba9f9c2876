"""Segments of a recording: its tares, turns, slides and pushes, found from pose and wrench, and the grasp of each."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
from scipy.ndimage import uniform_filter1d
from scipy.spatial.transform import Rotation

from testbed.actions.accelerate import Accelerate
from testbed.actions.base import TableAction
from testbed.actions.push import Push
from testbed.actions.rotate import Rotate
from testbed.actions.slide import Slide
from testbed.errors import InvalidValueError, nearest
from testbed.frames import perpendicular, rotation_2d
from testbed.importers.importer import calibrated, object_of
from testbed.importers.logs import LogError
from testbed.importers.mapping import Mapping
from testbed.importers.phases import (
    ABOVE,
    PUSHED_WITHIN,
    RATE,
    SHORTEST_TARE,
    STEADY_WITHIN,
    STILL,
    check_sensor_alive,
    common_base,
    linear_stretches,
    resampled,
)
from testbed.importers.streams import Streams, closing_yaw, differentiated, open_log
from testbed.objects.faces import face_at, room_at
from testbed.objects.model import ObjectShape
from testbed.sensing.push_windows import TOUCHING
from testbed.sensing.series import interpolated, runs
from testbed.toml import load_toml

Kind = Literal["tare", "held still", "turn", "accelerated turn", "slide", "push", "other motion", "empty hand"]
SHORTEST = 0.5
"""Shortest motion that is reported [s]."""
LONGEST_TURN_ROUND = 2.0
"""Longest rest between a turn and its way back [s]."""
GRASP_WITHIN = 0.010, np.radians(10.0)
"""Distance [m] and angle [rad] up to which the hand is at a grasp, where the object was left."""
_SMOOTHING = 0.25
_ROTATION = np.radians(3.0)
"""Smallest turn; a motion with less is a slide [rad]."""
_WAY = 0.005
"""Shortest slide [m]."""
_DRAG = 0.15, 0.01
"""Largest force in the table's plane [N] and torque about its normal [N m] of an empty hand, without noise."""
_LIFTED = 0.5
"""Change of the vertical force over the first tare above which a high hand carries something [N]."""
_STRAIGHT = np.radians(3.0)
"""Turn of a push's heading below which its path is straight [rad]."""
_IMPACT = 5
"""Samples over which the force of a push is averaged."""
_AT_GRASP = 0.003
"""Distance of a center from the TCP up to which a turn is about the grasp [m]."""


@dataclass(frozen=True)
class Segment:
    """Stretch of a recording in which the hand does one thing; times [s] count from the log's first sample."""

    kind: Kind
    from_s: float
    to_s: float
    action: TableAction | Push | None = None
    """Action on the table, in the object's frame if its grasp is found: else from the TCP, x as the pads close."""
    steady: tuple[tuple[float, float], ...] = ()
    """Stretches of constant speed or acceleration."""
    tare: tuple[float, float] | None = None
    """The last tare before; None of a zeroed sensor without one."""
    trial: tuple[float, float] = (0.0, 0.0)
    """Stretch of the log that is the trial: from its tare to the middle of the next one; without a tare, between the
    middles of the rests before and after."""
    alone: bool = True
    """True if the tare is right before it; False if another action of the same grasp is between."""
    grasps: tuple[str, ...] = ()
    """Names of the grasps that it fits: one if it is found."""
    center: tuple[float, float] | None = None
    """Center of a turn from the TCP [m], x as the pads close."""
    flipped: bool = False
    """True if the hand is turned round by 180 degrees, from the first action."""
    closing: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """TCP and closing direction at its begin [m, m, rad], base axes."""
    closing_end: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """The same at its end."""
    reason: str = ""
    """Why a motion beside the object is no push."""
    lay: tuple[float, float, float] | None = None
    """Pose of a rigid object by a camera at the begin of the motion [m, m, rad], base axes."""

    @property
    def held(self) -> bool:
        """True if the pads hold the object, in an action or another motion."""
        return not self.reason and (self.kind == "other motion" or (self.action is not None and not self.action.pushes))


def find_segments(log: Path, mapping: Path, grasps: Sequence[str] = ()) -> list[Segment]:
    """Segments of a recording, in order.

    A tare is a rest of the hand above the table. A motion under force in the table's plane, or torque about its normal,
    moves the object. A turn and its way back are one action. A motion beside a rigid object with a camera is a push.
    The grasps are those at the object's poses by the camera, or else those between which it moves as the hand left it
    each time.

    Args:
        log: a table, an .mcap file, or a ROS 2 bag.
        mapping: a TOML file that describes its columns; its action and phases do not count.
        grasps: names of the actions' grasps, in order; the first few are enough where the object stays in place.

    Raises:
        HeftError: see `import_trajectory`.
        LogError: no tare, or no motion of the object.
    """
    table, gain = calibrated(load_toml(mapping, Mapping), mapping)
    shape = object_of(table, mapping).shape
    names = [grasp.name for grasp in shape.grasps]
    if wrong := [name for name in grasps if name not in names]:
        raise InvalidValueError("--grasps", wrong[0], f"some of {', '.join(names)}{nearest(wrong[0], names)}")
    logged = Streams.of(open_log(log, table), table, mapping.parent)
    streams = logged.early(table.sensor.delay_s or 0.0).sensed(table)
    motion = _Motion(streams, table, gain, shape)
    found = _trials(motion.segments())
    none = not any(segment.action or segment.reason for segment in found)
    try:
        check_sensor_alive(streams.wrench, motion.base[[0, -1 if none else 0]], table.sensor.measured)
    except LogError as error:
        raise LogError(f"{log}: {error}") from None
    if none:
        raise LogError(
            f"{log}: no motion of the object was found: allowed: the hand rests {1e3 * ABOVE:.0f} mm or more above its "
            f"grasp for {SHORTEST:g} s (or sensor.zeroed = true), goes down, and turns, slides or pushes the object"
        )
    return _with_grasps(found, shape, [names.index(name) for name in grasps])


@dataclass(frozen=True, eq=False)
class _Lying:
    """Rigid object on the table by a camera."""

    shape: ObjectShape
    pose: np.ndarray
    """Its planar pose at each sample [m, m, rad], base axes."""

    @staticmethod
    def of(streams: Streams, table: Mapping, base: np.ndarray, shape: ObjectShape) -> _Lying | None:
        """None without a camera, and of hinged objects."""
        camera = streams.camera(table, base)
        if camera is None or camera.poses.shape[1] > 1:
            return None
        there = ~np.isnan(camera.poses[:, 0]).any(axis=1)
        return _Lying(shape, interpolated(base - base[0], camera.time_s[there], camera.poses[there, 0]))

    def in_object(self, at: np.ndarray, place: np.ndarray) -> np.ndarray:
        """Points in the object's frame at some samples [m], shape (N, 2), from base axes."""
        pose = self.pose[at]
        return (rotation_2d(-pose[:, 2]) @ (place - pose[:, :2])[..., None])[..., 0]


class _Motion:
    """Motion and wrench of the hand at 100 Hz."""

    def __init__(self, streams: Streams, table: Mapping, gain: np.ndarray, shape: ObjectShape):
        self.base = common_base(streams.needed, table.longest_gap_s)
        self.position, hand = streams.tcp(table, self.base)
        self.sensor = hand * Rotation.from_quat(table.sensor.in_hand_wxyz, scalar_first=True)
        self.lying, self.zeroed = _Lying.of(streams, table, self.base, shape), table.sensor.zeroed
        self.time, self.yaw = self.base - streams.begin_s, closing_yaw(hand, table.hand)
        wrench = table.sensor.sign * resampled(streams.wrench, self.base) / gain
        twist = differentiated(self.position, hand)
        self.force = uniform_filter1d(wrench[:, :3], _IMPACT, axis=0)
        self.height, size = self.position[:, 2], round(_SMOOTHING * RATE)
        self.twist, self.wrench = (uniform_filter1d(values, size, axis=0) for values in (twist, wrench))
        self.noise = (wrench - self.wrench).std(axis=0) / size**0.5
        self.quick = twist[:, 5]
        self.rate, self.speed = self.twist[:, 5], np.linalg.norm(self.twist[:, :2], axis=1)
        speeds = np.linalg.norm(self.twist.reshape(-1, 2, 3), axis=2)
        still = (speeds < STILL).all(axis=1)
        self.rests = [run for run in runs(still) if len(run) >= SHORTEST_TARE * RATE]

    def segments(self) -> list[Segment]:
        """All segments in order, without their trials."""
        parts = self._parts()
        heights = [float(np.median(self.height[part])) for part in parts]
        floor = min(heights, default=float(self.height.min()))
        lifted = self.rests and [rest for rest in self.rests if self.height[rest].mean() > floor + ABOVE]
        tares = [rest for rest in lifted or [] if self._weight(rest, lifted[0]) < _LIFTED]
        found = []
        for part, height in zip(parts, heights, strict=True):
            before = [t for t in tares if t[-1] < part[0] and self.height[t].mean() > height + ABOVE]
            if before or self.zeroed:
                found.append(self._motion(part, before[-1] if before else None))
        for rest in self.rests:
            kind: Kind = "tare" if any(rest is tare for tare in tares) else "held still"
            found.append(Segment(kind, *self._ends(rest)))
        return _there_and_back(sorted(found, key=lambda segment: segment.from_s))

    def _parts(self) -> list[np.ndarray]:
        """Motions in the plane that keep their sense, but for those that go down or up."""
        level = np.abs(self.twist[:, 2]) < np.maximum(0.02, 0.3 * self.speed)
        turning = np.where(np.abs(self.rate) > STILL[1], np.sign(self.rate), 0.0)
        moving = level & ((turning != 0) | (self.speed > STILL[0]))
        parts = []
        for run in runs(moving):
            turns = np.abs(self.yaw[run[-1]] - self.yaw[run[0]]) > _ROTATION or np.ptp(self.yaw[run]) > _ROTATION
            senses = [sense for s in (-1, 1) for sense in runs(np.isin(np.arange(len(moving)), run) & (turning == s))]
            parts += senses if turns else [run]
        return sorted((part for part in parts if len(part) >= SHORTEST * RATE), key=lambda part: part[0])

    def _weight(self, rest: np.ndarray, first: np.ndarray) -> float:
        """Change of the vertical force since the first rest [N]."""
        force = [self._world(at, self.wrench[at, :3]).mean(axis=0)[2] for at in (rest, first)]
        return float(abs(force[0] - force[1]))

    def _world(self, at: np.ndarray, vectors: np.ndarray) -> np.ndarray:
        """Vectors in base axes, from sensor axes."""
        return self.sensor[int(at[0]) : int(at[-1]) + 1].apply(vectors)

    def _ends(self, run: np.ndarray) -> tuple[float, float]:
        return round(float(self.time[run[0]]), 2), round(float(self.time[run[-1]]), 2)

    def _pose(self, index: int) -> tuple[float, float, float]:
        x, y = self.position[index, :2].tolist()
        return x, y, float(self.yaw[index])

    def _drags(self, part: np.ndarray, tare: np.ndarray | None) -> bool:
        """True if force or torque is that of a motion of the object."""
        net = _net(self.wrench, part, tare)
        force, torque = (self._world(part, net[:, columns]) for columns in (slice(3), slice(3, 6)))
        load = np.median(np.linalg.norm(force[:, :2], axis=1)), np.median(np.abs(torque[:, 2]))
        return bool((np.array(load) > self._least()).any())

    def _least(self) -> np.ndarray:
        """Least force in the plane [N] and torque [N m] of a motion of the object."""
        return np.array(_DRAG) + 3 * np.array([self.noise[:3].max(), self.noise[3:].max()])

    def _motion(self, part: np.ndarray, tare: np.ndarray | None) -> Segment:
        ends, kind = self._ends(part), "other motion"
        action, steady = None, []
        turned, way = abs(float(self.yaw[part[-1]] - self.yaw[part[0]])), float(self.speed[part].sum() / RATE)
        if self.lying and room_at(self.lying.shape, self.lying.in_object(part[:1], self.position[part[:1], :2])[0]) > 0:
            kind, action, steady = self._push(part, tare, self.lying)
        elif not self._drags(part, tare):
            kind = "empty hand"
        elif turned > _ROTATION:
            kind, action, steady = self._turn(part)
        elif way > _WAY:
            kind, action, steady = self._slide(part)
        action, reason = (None, action) if isinstance(action, str) else (action, "")
        windows = tuple(self._ends(run) for run in steady)
        x, y, yaw = (0.0, 0.0, 0.0) if self.lying is None else self.lying.pose[part[0]].tolist()
        return Segment(
            kind,
            *ends,
            action,
            windows,
            None if tare is None else self._ends(tare),
            center=self._center(np.concatenate(steady)) if steady and kind not in ("slide", "push") else None,
            closing=self._pose(part[0]),
            closing_end=self._pose(part[-1]),
            reason=reason,
            lay=None if self.lying is None else (x, y, yaw),
        )

    def _push(self, part: np.ndarray, tare: np.ndarray | None, lying: _Lying) -> tuple[Kind, Push | str | None, list]:
        """A push, from where the force rises, along an arc; or the reason why it is none."""
        force = np.linalg.norm(self._world(part, _net(self.force, part, tare))[:, :2], axis=1)
        usual = float(np.quantile(force, 0.9))
        if usual < self._least()[0]:
            return "empty hand", None, []
        contact = part[max(runs(force > TOUCHING * usual), key=len)]
        most = float(np.quantile(self.speed[contact], 0.8))  # the arm gives way as it meets the object
        speed = float(np.median(self.speed[contact][np.abs(self.speed[contact] - most) < STEADY_WITHIN * most]))
        near = part[max(runs(np.abs(self.speed[part] - speed) < PUSHED_WITHIN * speed), key=len)]
        kept = np.intersect1d(contact, near)
        if len(kept) < SHORTEST_TARE * RATE:
            return "other motion", f"the tip keeps no speed for {SHORTEST_TARE:g} s while it pushes", []
        place = self.position[:, :2]
        way = float(self.speed[contact].sum()) / RATE  # steps between poses add up their noise
        along = np.cumsum(self.speed[kept]) / RATE
        heading = np.unwrap(np.arctan2(self.twist[kept, 1], self.twist[kept, 0]))
        curvature, begin = np.polyfit(along, heading, 1)
        if abs(curvature * way) < _STRAIGHT:
            curvature, begin = 0.0, float(np.median(heading))
        tips = lying.in_object(contact, place[contact])
        face, _ = face_at(lying.shape, tips[0])
        radius = float(np.median([face_at(lying.shape, tip)[1] for tip in tips]))
        try:
            direction = float(np.remainder(begin - lying.pose[contact[0], 2] + np.pi, 2 * np.pi) - np.pi)
            point = tuple(face.nearest(tips[0]).round(5).tolist())
            action = Push(
                point, round(direction, 3), round(curvature, 2), round(speed, 4), round(way, 3), round(radius, 4)
            )
            action.face(lying.shape)
        except InvalidValueError as error:
            return "other motion", str(error), []
        return "push", action, [near]

    def _constant(self, part: np.ndarray, rate: np.ndarray) -> tuple[float, np.ndarray]:
        """Median speed, and the longest stretch near it."""
        speed = float(np.median(rate[part]))
        near = runs(np.abs(rate[part] - speed) < STEADY_WITHIN * abs(speed))
        return speed, part[max(near, key=len)]

    def _turn(self, part: np.ndarray) -> tuple[Kind, TableAction | None, list[np.ndarray]]:
        speed, near = self._constant(part, self.rate)
        if len(near) > len(part) / 2:
            x, y = self._center(near)
            return "turn", Rotate(0, round(speed, 4), round(len(near) / RATE, 1), _pivot(x, y)), [near]
        steps = linear_stretches(self.quick[part])
        slopes = [round(slope, 2) for slope, _ in steps]
        held = [part[within] for _, within in steps]
        try:
            hold = float(np.median([len(step) for step in held])) / RATE
            start = float(self.quick[held[0][0]])
            return "accelerated turn", Accelerate(0, tuple(slopes), round(hold, 2), round(start, 3)), held
        except (InvalidValueError, IndexError):
            return "other motion", None, []

    def _slide(self, part: np.ndarray) -> tuple[Kind, TableAction | None, list[np.ndarray]]:
        speed, near = self._constant(part, self.speed)
        if len(near) <= len(part) / 2:
            return "other motion", None, []
        x, y = rotation_2d(-float(self.yaw[near].mean())) @ self.twist[near, :2].mean(axis=0)
        return "slide", Slide(0, round(float(np.arctan2(y, x)), 3), round(speed, 4), round(len(near) / RATE, 1)), [near]

    def _center(self, part: np.ndarray) -> tuple[float, float]:
        """Center of a turn from the TCP [m], x as the pads close."""
        across = (rotation_2d(-self.yaw[part]) @ perpendicular(self.twist[part, :2])[..., None])[..., 0]
        x, y = np.median(across / self.rate[part, None], axis=0).tolist()  # the hand still settles in the first second
        return x, y


def _net(values: np.ndarray, part: np.ndarray, tare: np.ndarray | None) -> np.ndarray:
    """Readings of a part of a recording less those of its tare, or of a zeroed sensor as they are."""
    return values[part] - (0.0 if tare is None else values[tare].mean(axis=0))


def _pivot(x: float, y: float) -> tuple[float, float] | None:
    """Center of a turn from the TCP, to 0.1 mm [m]; None at the TCP."""
    return None if np.hypot(x, y) < _AT_GRASP else (round(x, 4), round(y, 4))


def _there_and_back(found: list[Segment]) -> list[Segment]:
    """Segments with each turn and its way back as one."""
    done: list[Segment] = []
    for segment in found:
        last = next((other for other in reversed(done) if other.kind != "held still"), None)
        there, back = last and last.action, segment.action
        if (
            last is not None
            and isinstance(there, Rotate)
            and isinstance(back, Rotate)
            and not there.back
            and segment.from_s - last.to_s < LONGEST_TURN_ROUND
            and abs(there.speed + back.speed) < STEADY_WITHIN * abs(there.speed)
            and abs(there.duration - back.duration) < 0.2 * there.duration
            and np.linalg.norm(np.subtract(there.pivot or (0, 0), back.pivot or (0, 0))) < GRASP_WITHIN[0]
        ):
            pivots = [one.pivot or (0.0, 0.0) for one in (there, back)]  # drag displaces them by turns
            about = _pivot(*np.mean(pivots, axis=0).tolist())
            both = replace(there, duration=min(there.duration, back.duration), pivot=about, back=True)
            joined = replace(
                last,
                to_s=segment.to_s,
                action=both,
                steady=(*last.steady, *segment.steady),
                closing_end=segment.closing_end,
                center=about or (0.0, 0.0),
            )
            done = [joined if other is last else other for other in done if other.from_s <= last.from_s]
        else:
            done.append(segment)
    return done


def _trials(found: list[Segment]) -> list[Segment]:
    """Segments with the stretch of the log that is the trial of each action."""
    done, actions = [], [segment for segment in found if segment.action]
    tares = [(segment.from_s, segment.to_s) for segment in found if segment.kind == "tare"]
    last = round(max((segment.to_s for segment in found), default=0.0), 2)
    for segment in found:
        if segment.action is None:
            done.append(segment)
            continue
        at = actions.index(segment)
        following = actions[at + 1] if at + 1 < len(actions) else None
        if segment.tare is None:
            begin = round((actions[at - 1].to_s + segment.from_s) / 2, 2) if at else 0.0
            end = round((segment.to_s + following.from_s) / 2, 2) if following else last
            done.append(replace(segment, trial=(begin, end), alone=False))
            continue
        middle = round(sum(segment.tare) / 2, 2)
        alone = at == 0 or actions[at - 1].tare != segment.tare
        begin = middle if alone and at and segment.tare[1] - middle >= SHORTEST else segment.tare[0]
        after = [tare for tare in tares if tare[0] > segment.to_s]
        if following is not None and following.tare == segment.tare:
            end = round((segment.to_s + following.from_s) / 2, 2)
        elif after:
            middle = round(sum(after[0]) / 2, 2)
            end = (middle if after[0][1] - middle >= SHORTEST else after[0][0]) if following else after[0][1]
        else:
            end = last
        done.append(replace(segment, trial=(begin, end), alone=alone))
    return done


def _with_grasps(found: list[Segment], shape: ObjectShape, given: list[int]) -> list[Segment]:
    """Segments with the grasps that they fit: along each chain of grasps the object stays where the hand left it."""
    actions = [segment for segment in found if segment.held]
    names = [grasp.name for grasp in shape.grasps]
    starts = [given[: len(actions)]] if given else [[index] for index in range(len(names))]
    chains = [chain for start in starts if (chain := _chain(actions, shape, start)) is not None]
    held = []
    for i, segment in enumerate(actions):
        grasps = tuple(dict.fromkeys(names[chain[i][0]] for chain in chains))
        action, flipped = segment.action, bool(chains) and chains[0][i][1]
        if isinstance(action, TableAction) and len(grasps) == 1:
            action = _in_object(action, shape, names.index(grasps[0]), np.pi * flipped)
        held.append(replace(segment, action=action, grasps=grasps, flipped=flipped))
    return [held.pop(0) if segment in actions else segment for segment in found]


def _chain(actions: list[Segment], shape: ObjectShape, start: list[int]) -> list[tuple[int, bool]] | None:
    """Grasp of each action, and whether the hand is turned round; None if it is at none. The first few are given."""
    chain: list[tuple[int, bool]] = []
    yaw, origin = 0.0, np.zeros(2)
    for number, segment in enumerate(actions):
        if segment.lay is not None:
            origin, yaw = np.array(segment.lay[:2]), segment.lay[2]
        at = rotation_2d(-yaw) @ (np.array(segment.closing[:2]) - origin)
        turned = np.array([np.exp(1j * (segment.closing[2] - yaw - grasp.angle)) for grasp in shape.grasps])
        off = np.array([np.linalg.norm(at - grasp.position) for grasp in shape.grasps])
        fits = (off < GRASP_WITHIN[0]) & (np.abs(np.angle(turned**2)) / 2 < GRASP_WITHIN[1])
        if not (fits[start[number]] or segment.lay is None if number < len(start) else fits.any()):
            return None
        index = start[number] if number < len(start) else int(np.argmin(np.where(fits, off, np.inf)))
        flipped = bool(number > 0 and fits[index] and turned[index].real < 0)  # else it was laid anew
        chain.append((index, flipped))
        x, y, closing = segment.closing_end
        yaw = closing + np.pi * flipped - shape.grasps[index].angle
        origin = np.array([x, y]) - rotation_2d(yaw) @ shape.grasps[index].position
    return chain


def _in_object(action: TableAction, shape: ObjectShape, index: int, turned: float) -> TableAction:
    """An action by its grasp, in the object's frame, by a hand turned round by some angle [rad]."""
    grasp, angle = shape.grasps[index], shape.grasps[index].angle + turned
    if isinstance(action, Rotate) and action.pivot is not None:
        x, y = (grasp.position + rotation_2d(angle) @ np.array(action.pivot)).round(4).tolist()
        return replace(action, grasp=index, pivot=(x, y))
    if isinstance(action, Slide):
        heading = np.angle(np.exp(1j * (action.direction + angle)))
        return replace(action, grasp=index, direction=round(float(heading), 3))
    return replace(action, grasp=index)
