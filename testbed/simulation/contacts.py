"""The true force of the table on every foot: for checking the sensor and for looking, never for estimating."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from testbed.simulation.scene import Scene


@dataclass(frozen=True, eq=False)
class ContactRecord:
    """Contact forces over one trial: T samples, F feet, world axes."""

    force_on_object: np.ndarray
    """Force of the table on each foot, N, (T, F, 3)."""
    position: np.ndarray
    """Where it acts, m, (T, F, 3)."""
    tcp_position: np.ndarray
    """m, (T, 3)."""
    particle: np.ndarray
    """Particle over each foot, (F,)."""

    @property
    def wrench_at_tcp(self) -> np.ndarray:
        """Sum of all contact forces as a wrench on the object about the TCP, world axes, (T, 6)."""
        lever = self.position - self.tcp_position[:, None]
        return np.concatenate([self.force_on_object.sum(1), np.cross(lever, self.force_on_object).sum(1)], axis=1)


class ContactLog:
    """Gathers a `ContactRecord` while a trial runs."""

    def start(self, scene: Scene, ticks: int) -> None:
        """Make room for `ticks` samples."""
        self._foot = {int(geom): i for i, geom in enumerate(scene.foot_geoms)}
        self._particle = scene.foot_particles
        self._tcp_site = scene.model.site("gripper/tcp").id
        self._force = np.zeros((ticks, len(self._foot), 3))
        self._position = np.zeros((ticks, len(self._foot), 3))
        self._tcp = np.zeros((ticks, 3))
        self._count = 0

    def measure(self, model: mujoco.MjModel, data: mujoco.MjData, tick: int) -> None:
        """Read all contacts of the feet."""
        wrench = np.zeros(6)
        for index in range(data.ncon):
            contact = data.contact[index]
            foot = self._foot.get(int(contact.geom1), self._foot.get(int(contact.geom2)))
            if foot is None:
                continue
            mujoco.mj_contactForce(model, data, index, wrench)
            # MuJoCo gives the force on the second geom; the feet come first or second as the pair was sorted
            sign = 1.0 if int(contact.geom2) in self._foot else -1.0
            self._force[tick, foot] = sign * contact.frame.reshape(3, 3).T @ wrench[:3]
            self._position[tick, foot] = contact.pos
        self._tcp[tick] = data.site_xpos[self._tcp_site]
        self._count = tick + 1

    def record(self) -> ContactRecord:
        """All that was gathered."""
        n = self._count
        return ContactRecord(self._force[:n], self._position[:n], self._tcp[:n], self._particle)
