"""Contacts of the feet with the table: true forces in a trial, loads at rest, and weighing on a scale."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from jaxtyping import Float

from testbed.foot_forces import FootForces
from testbed.objects.model import GRAVITY, ObjectModel
from testbed.simulation.scene import Scene, build_scene, foot_stiffness, touching_groups
from testbed.simulation.settings import ContactSettings, SimulationSettings
from testbed.trajectory import Trajectory
from testbed.trial import Support, Trial

_SETTLE_TIME, _READ_TIME = 1.0, 0.5


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
    """Recorder of a `ContactRecord` at every `every`-th tick of a trial."""

    def __init__(self, every: int = 1) -> None:
        self._every = every
        self._ticks: list[int] = []

    def start(self, scene: Scene, ticks: int) -> None:
        """Allocate a trial of `ticks` samples."""
        rows, feet = -(-ticks // self._every), len(scene.foot_geoms)
        self._foot = np.full(scene.model.ngeom, -1)
        self._foot[scene.foot_geoms] = np.arange(feet)
        self._particle = scene.foot_particles
        self._tcp_site = scene.model.site("gripper/tcp").id
        self._force = np.zeros((rows, feet, 3))
        self._position = np.zeros((rows, feet, 3))
        self._tcp = np.zeros((rows, 3))

    def measure(self, data: mujoco.MjData, tick: int) -> None:
        """Read the contacts of all feet."""
        if tick % self._every:
            return
        row, contact = len(self._ticks), data.contact
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
        self._ticks.append(tick)

    def record(self) -> ContactRecord:
        """Record so far."""
        n = len(self._ticks)
        return ContactRecord(
            np.array(self._ticks, dtype=np.int64), self._force[:n], self._position[:n], self._tcp[:n], self._particle
        )


def resting_loads(obj: ObjectModel, support: Support, contact: ContactSettings) -> Float[np.ndarray, "P"]:
    """Load on every particle at rest [N], shape (P,); 0 without contact, negative where a foot would have to pull.

    The foundation has even stiffness. All groups share one tilt; each has a height of its own (own weight), a height
    joined to its neighbors' by springs, or the common height (rigid). A group's weight acts at its center of mass.
    """
    shape = obj.shape
    feet = np.flatnonzero(shape.friction_group >= 0)
    group = np.zeros(len(feet), dtype=int) if support.is_rigid else shape.mass_group[feet]
    heights = 1 if support.is_rigid else shape.n_m
    sinks = np.column_stack([np.eye(heights)[group], shape.particles[feet]])
    stiffness = foot_stiffness(obj, contact)
    matrix = stiffness * sinks.T @ sinks
    if not support.is_rigid:
        for a, b in touching_groups(shape):
            matrix[[a, b], [a, b]] += support.stiffness
            matrix[[a, b], [b, a]] -= support.stiffness
    weight = [obj.total_mass * GRAVITY] if support.is_rigid else obj.group_mass * GRAVITY
    wanted = np.append(weight, obj.total_mass * GRAVITY * obj.center_of_mass)
    # A straight row of feet leaves the tilt across it open: the least-norm solution has none
    loads = np.zeros(len(shape.particles))
    loads[feet] = stiffness * sinks @ np.linalg.lstsq(matrix, wanted, rcond=1e-9)[0]
    return loads


def weigh(trial: Trial, settings: SimulationSettings) -> Trajectory:
    """Record of a scale under the object at rest."""
    scene = build_scene(trial.object, trial.support, None, settings)
    model, data = scene.model, mujoco.MjData(scene.model)
    mujoco.mj_step(model, data, round(_SETTLE_TIME / settings.timestep))
    count = round(_READ_TIME * settings.rate)
    weight, force = np.zeros(count), np.zeros(6)
    for tick in range(count):
        mujoco.mj_step(model, data, settings.steps)
        for contact in range(data.ncon):
            mujoco.mj_contactForce(model, data, contact, force)
            weight[tick] += force[0]
    provenance = {"runner": "simulation", "mujoco": mujoco.__version__, "support": trial.support.name}
    return Trajectory.of_scale(weight, np.arange(count) / settings.rate, provenance)
