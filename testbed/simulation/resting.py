"""The object resting on its own feet: who carries what, before a gripper touches it."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from testbed.objects import GRAVITY, ObjectModel
from testbed.simulation.object_scene import foot_stiffness, touching_groups
from testbed.simulation.settings import ContactSettings
from testbed.trial import Support


def resting_loads(obj: ObjectModel, support: Support, contact: ContactSettings) -> Float[np.ndarray, "P"]:
    """Load on every particle, N, (P,); 0 without contact, and below 0 where a foot would have to pull.

    A foundation of even stiffness: the groups share one tilt, and each has a height of its own (own weight), a height
    joined to its neighbours' by springs, or the height of all (rigid). A group's weight acts at its centre of mass.
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
