"""Monitor of a running trial (slip, tipping, saturation, speed, divergence) and a recorder of contact forces."""

from __future__ import annotations

import math
from dataclasses import dataclass

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from testbed.actions.push import LEAST_CONTACT
from testbed.foot_forces import FootForces
from testbed.simulation.motion import JOINT_SPEED_LIMIT, Motion
from testbed.simulation.scene import Scene
from testbed.simulation.settings import SimulationSettings
from testbed.trajectory import Phase, Status

SLIP_LIMIT = (0.003, math.radians(1.5))
"""Slip in the grip beyond which a trial is invalid [m, rad]."""
IMPOSSIBLE_SPEED = 20.0
"""Multiple of its speed limit that no joint can reach: the simulation has diverged."""
SATURATION_TIME = 0.1
"""Longest time of a joint at its working torque [s]."""
TIPPED = math.radians(5.0)
"""Tilt beyond which a pushed object tips over [rad]; an object that slides on its feet tilts by 1 to 2 degrees."""
LEFT = 0.1
"""Time without contact after which a fingertip has left the object [s]."""
_FAULTS = slice(int(mujoco.mjtWarning.mjWARN_BADQPOS), int(mujoco.mjtWarning.mjWARN_BADQACC) + 1)
"""Warnings of a diverged simulation: of positions, velocities and accelerations."""
_UNSATURATED = np.zeros(7)
"""Times at the working torque if no joint is saturated [s], shape (7,)."""

_PoseInHand = tuple[np.ndarray, np.ndarray]
"""Position [m] and orientation of the object in the hand."""


@dataclass(frozen=True)
class Outcome:
    """Status of a trial, its reason, and the numbers behind it."""

    status: Status
    reason: str
    figures: dict[str, float]
    state: dict[str, list[float]] | None = None
    """Last state before a fault."""


class Monitor:
    """Watch for slip, tipping, saturation, speed and divergence at every tick of one trial.

    Slip is planar on the table, and spatial in the air, where the object may also fall or tilt.
    """

    def __init__(self, scene: Scene, data: mujoco.MjData, motion: Motion, settings: SimulationSettings):
        model, hand, body = scene.model, data.site("gripper/tcp"), data.body(scene.object_body)
        self._rate, self._data = settings.rate, data
        first = model.sensor("arm/joint_1_torque").adr[0]
        # Views of the simulation's state: a look-up at every tick would cost as much as the checks
        self._velocity, self._sensors = data.qvel[:7], data.sensordata
        self._torques, self._faults = data.sensordata[first : first + 7], data.warning.number[_FAULTS]
        self._hand, self._hand_at = hand.xmat.reshape(3, 3), hand.xpos
        self._axes, self._object_at = body.xmat.reshape(3, 3), body.xpos
        self._limit = model.jnt_actfrcrange[:7, 1]
        self._held = (motion.phase >= Phase.SETTLE) & (motion.phase != Phase.RELEASE)
        self._shift = _shift_in_space if motion.action.in_air else _shift_on_table
        self._grasped: _PoseInHand | None = None
        self._tip = model.geom("fingertip").id if motion.action.pushes else None
        self._touched, self._least_touched = 0, LEAST_CONTACT * motion.action.pace * self._rate
        self._since = 0
        self._saturated = _UNSATURATED
        self._torque = self._speed = self._slip = self._turn = 0.0
        self._status: Status = "ok"
        self._reason = ""
        self._state: dict[str, list[float]] = {}
        self._good: list[float] = []

    def must_stop(self, tick: int) -> bool:
        """Check one tick; True if the trial must end."""
        speed = np.abs(self._velocity) / JOINT_SPEED_LIMIT
        fastest = speed.max()
        finite = math.isfinite(self._sensors.sum())
        if self._faults.any() or not finite or not fastest < IMPOSSIBLE_SPEED:
            self._state = {
                "qpos": np.nan_to_num(self._data.qpos).tolist(),
                "qvel": np.nan_to_num(self._data.qvel).tolist(),
                "last_good_qpos": self._good,
            }
            return self._end("fault", f"the simulation diverged at {tick / self._rate:.2f} s")
        if tick % 50 == 0:
            self._good = self._data.qpos.tolist()
        torque = np.abs(self._torques) / self._limit
        largest = torque.max()
        self._torque, self._speed = max(self._torque, largest), max(self._speed, fastest)
        self._saturated = (
            np.where(torque > 0.999, self._saturated + 1 / self._rate, 0.0) if largest > 0.999 else _UNSATURATED
        )
        if self._saturated.max() > SATURATION_TIME:
            joint = int(self._saturated.argmax())
            return self._end(
                "limit",
                f"torque: joint {joint + 1} at its working torque of {self._limit[joint]:g} N m "
                f"at {tick / self._rate:.2f} s",
            )
        if fastest > 1.05:
            joint = int(speed.argmax())
            return self._end(
                "limit", f"speed: joint {joint + 1} at {fastest:.2f} of its limit at {tick / self._rate:.2f} s"
            )
        if self._tip is not None:
            return self._tipped(tick) or self._left(tick)
        return self._held[tick] and self._slipped(tick)

    def _tipped(self, tick: int) -> bool:
        """True if a pushed object has tipped over."""
        upright = self._axes[2, 2]
        if upright > math.cos(TIPPED):
            return False
        return self._end("slipped", f"the object tipped by {math.degrees(TIPPED):.0f} deg at {tick / self._rate:.2f} s")

    def _left(self, tick: int) -> bool:
        """True if the fingertip of a push has left the object."""
        if (self._data.contact.geom == self._tip).any():
            self._touched, self._since = self._touched + 1, 0
            return False
        self._since += bool(self._touched)
        if self._since < LEFT * self._rate:
            return False
        seconds = self._touched / self._rate
        self._reason = f"the fingertip left the object at {tick / self._rate:.2f} s, after {seconds:.2f} s in contact"
        return True

    def _slipped(self, tick: int) -> bool:
        """True if the object has slipped in the grip."""
        hand = self._hand.T
        pose = hand @ (self._object_at - self._hand_at), hand @ self._axes
        if self._grasped is None:
            self._grasped = pose
        moved, turn = self._shift(self._grasped, pose)
        self._turn, self._slip = max(self._turn, turn), max(self._slip, moved)
        if self._slip > SLIP_LIMIT[0] or self._turn > SLIP_LIMIT[1]:
            return self._end(
                "slipped",
                f"the object moved {self._slip * 1e3:.1f} mm and {math.degrees(self._turn):.2f} deg "
                f"in the grip at {tick / self._rate:.2f} s",
            )
        return False

    def _end(self, status: Status, reason: str) -> bool:
        self._status, self._reason = status, reason
        return True

    def outcome(self) -> Outcome:
        """Outcome so far."""
        if self._tip is not None and self._status == "ok" and self._touched < self._least_touched:
            self._status = "slipped"
            self._reason = self._reason or f"the fingertip met the object for {self._touched / self._rate:.2f} s alone"
        figures = {
            "peak_torque_over_limit": float(self._torque),
            "peak_speed_over_limit": float(self._speed),
            "slip_m": float(self._slip),
            "slip_rad": float(self._turn),
        } | ({} if self._tip is None else {"contact_s": self._touched / self._rate})
        return Outcome(self._status, self._reason, figures, self._state or None)


def _shift_on_table(before: _PoseInHand, now: _PoseInHand) -> tuple[float, float]:
    """Shift of the grasp point [m] and turn of the object [rad], across the approach axis."""
    (x, y), (u, v) = before[1][:2, 0].tolist(), now[1][:2, 0].tolist()
    turn = math.atan2(x * v - y * u, x * u + y * v)
    # The body's origin is not the grasp point: subtract the part of its shift that the turn causes
    c, s = math.cos(turn), math.sin(turn)
    (a, b), (p, q) = before[0][:2].tolist(), now[0][:2].tolist()
    return math.hypot(p - c * a + s * b, q - s * a - c * b), abs(turn)


def _shift_in_space(before: _PoseInHand, now: _PoseInHand) -> tuple[float, float]:
    """Shift [m] and turn [rad] in all directions."""
    turn = now[1] @ before[1].T
    shift, turned = now[0] - turn @ before[0], Rotation.from_matrix(turn).as_rotvec()
    return float(np.linalg.norm(shift)), float(np.linalg.norm(turned))


@dataclass(frozen=True, eq=False)
class ContactRecord:
    """Contact forces of F feet at N samples of a trial, world axes."""

    tick: np.ndarray
    """Sample of the trajectory, shape (N,)."""
    force_on_object: np.ndarray
    """Force of the table on each foot [N], shape (N, F, 3)."""
    position: np.ndarray
    """Point of contact [m], shape (N, F, 3)."""
    tcp_position: np.ndarray
    """Position of the TCP [m], shape (N, 3)."""
    particle: np.ndarray
    """Particle over each foot, shape (F,)."""

    @property
    def wrench_at_tcp(self) -> np.ndarray:
        """Wrench of all contact forces on the object about the TCP, world axes [N, N m], shape (N, 6)."""
        lever = self.position - self.tcp_position[:, None]
        return np.concatenate([self.force_on_object.sum(1), np.cross(lever, self.force_on_object).sum(1)], axis=1)

    def foot_forces(self, time_s: np.ndarray) -> FootForces:
        """Foot forces for the file beside a trial; `time_s` (T,) is the trajectory's."""
        kept = self.tick < len(time_s)
        return FootForces(time_s[self.tick[kept]], self.particle, self.force_on_object[kept])


class ContactLog:
    """Recorder of contact forces at every `every`-th tick of a trial."""

    def __init__(self, every: int = 1) -> None:
        self._every, self._rows = every, 0

    def start(self, scene: Scene, ticks: int) -> None:
        """Allocate a trial of `ticks` samples."""
        rows, feet = -(-ticks // self._every), len(scene.foot_geoms)
        self._foot = np.full(scene.model.ngeom, -1)
        self._foot[scene.foot_geoms] = np.arange(feet)
        self._particle = scene.feet.particle
        self._tcp_site = scene.model.site("gripper/tcp").id
        self._force = np.zeros((rows, feet, 3))
        self._position = np.zeros((rows, feet, 3))
        self._tcp = np.zeros((rows, 3))

    def measure(self, data: mujoco.MjData, tick: int) -> None:
        """Read the contacts of all feet."""
        row, remainder = divmod(tick, self._every)
        if remainder:
            return
        contact, self._rows = data.contact, row + 1
        feet = self._foot[contact.geom]
        found = np.flatnonzero((feet.max(axis=1, initial=-1) >= 0) & (contact.efc_address >= 0))
        foot = feet[found].max(axis=1)
        # The rows of an elliptic cone are the force in the contact frame: normal, then two tangents
        along = data.efc_force[contact.efc_address[found][:, None] + np.arange(3)]
        on_second = np.einsum("ci,cij->cj", along, contact.frame[found].reshape(-1, 3, 3))
        sign = np.where(feet[found, 1] >= 0, 1.0, -1.0)  # MuJoCo sorts a pair's geoms
        self._force[row, foot] = sign[:, None] * on_second
        self._position[row, foot] = contact.pos[found]
        self._tcp[row] = data.site_xpos[self._tcp_site]

    def record(self) -> ContactRecord:
        """Record so far."""
        n = self._rows
        ticks = self._every * np.arange(n)
        return ContactRecord(ticks, self._force[:n], self._position[:n], self._tcp[:n], self._particle)
