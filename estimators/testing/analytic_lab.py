"""Analytic lab: trials of objects under Coulomb friction with every error of a setup drawn, in plain numpy.

Each group of an object rests on contact points of its own, or the object is one rigid body; grasp, TCP, table and
sensor are off by draws of the stated errors. Records have the values that a robot would report, which does not know the
errors.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import combinations
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from estimators.testing.analytic_world import DOWN, HEIGHT, RATE, TOOL, motion, record
from testbed.actions.base import TableAction
from testbed.frames import cross_2d, move_wrench, perpendicular, pose_from_point, rotate_wrench, rotation_2d
from testbed.objects.blocks import parse_layout
from testbed.objects.files import ObjectFile
from testbed.objects.model import GRAVITY, ObjectModel
from testbed.objects.random import Family
from testbed.trajectory import Phase, Trajectory
from testbed.worlds.feet import Feet
from testbed.worlds.setup_errors import SetupErrors

LAB = SetupErrors(
    contact_points=4,
    foot_offset=0.0005,
    foot_load=0.2,
    group_friction=0.03,
    place_friction=0.03,
    anisotropy=0.05,
    speed_friction=0.02,
    table_tilt=0.006,
    particle_offset=0.0007,
    grasp_offset=0.0007,
    grasp_angle=0.009,
    tcp_offset=0.0007,
    tcp_angle=0.005,
    gain=0.01,
    crosstalk=0.01,
    mounting_angle=0.01,
    delay=0.012,
    scale=0.002,
)
ROUGH = replace(
    LAB,
    foot_offset=0.001,
    foot_load=0.4,
    group_friction=0.08,
    place_friction=0.06,
    anisotropy=0.1,
    speed_friction=0.05,
    grasp_offset=0.0014,
    grasp_angle=0.018,
    gain=0.02,
    crosstalk=0.02,
)
BIAS = np.repeat([0.2, 0.01], 3)
NOISE = np.repeat([0.1, 0.005], 3)
PATTERNS = ("grid", "random", "corners", "ring", "rim", "dense", "pressed")
"""Contact under a block: the model's grid; three or four points anywhere that carry it level; four feet; a ring of
eight; a round rim; a grid of 7 x 7; six points of even load, on which it is not level."""
PADS = "pads"
"""Contact on four feet a block whose places the object states; two thirds of a block apart."""
RIGID = {"rigid": "dense", "three_feet": "random"}
"""One rigid body on all of such points, whose loads rise evenly, or on the three that carry it with the widest base."""


@dataclass(frozen=True, eq=False)
class Contacts:
    """Points at which an object truly touches, friction and load of each."""

    position: np.ndarray
    drag: np.ndarray


def contacts(obj: ObjectModel, pattern: str, setup: SetupErrors, rng: np.random.Generator) -> Contacts:
    """Contacts of one draw."""
    shape, parts = obj.shape, []
    feet, count = Feet.of(obj), len(shape.feet)
    if count:
        shift = setup.foot_offset * rng.standard_normal((count, 2))
        feet = Feet.known(obj, shift, setup.foot_load * rng.standard_normal(count))
    offset = setup.particle_offset * rng.standard_normal((shape.n_m, 2))
    friction = 1 + setup.group_friction * rng.standard_normal(shape.n_m)
    for group in range(shape.n_m):
        if pattern == PADS:
            own = shape.mass_group[feet.particle] == group
            at, share = feet.position[own], feet.stiffness[own] / feet.stiffness[own].sum()
        else:
            cells = shape.particles[shape.mass_group == group]
            at, share = points_under(cells, RIGID.get(pattern, pattern), shape.cell * 3 / 2, rng)
        mu = obj.truth.friction[shape.friction_group[shape.mass_group == group].max()]
        load = obj.group_mass[group] * GRAVITY * share
        parts.append((at + offset[group], np.full(len(at), mu * friction[group]), load))
    position, mu, load = (np.concatenate(part) for part in zip(*parts, strict=True))
    if pattern in RIGID:
        load = rigid_loads(position, obj, widest=pattern == "three_feet")
    return Contacts(position, mu * load)


def points_under(
    cells: np.ndarray, pattern: str, half: float, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Points under a block whose half side is `half` [m], and their shares of its load."""
    middle = cells.mean(axis=0)
    if pattern == "random":
        while True:
            at = middle + half * rng.uniform(-1, 1, (int(rng.integers(3, 5)), 2))
            matrix = np.vstack([np.ones(len(at)), (at - middle).T])
            share = np.linalg.lstsq(matrix, np.array([1.0, 0, 0]), rcond=None)[0]
            if share.min() > 0.05 and np.allclose(matrix @ share, [1, 0, 0]):
                return at, share
    if pattern == "ring":
        angle = rng.uniform(0, 2 * np.pi) + np.arange(8) * np.pi / 4
        at = rng.uniform(0.5, 0.95) * np.column_stack([np.cos(angle), np.sin(angle)])
    elif pattern == "pressed":
        at = rng.uniform(-1, 1, (6, 2))
    else:
        angle, ticks = np.arange(40) * np.pi / 20, (np.arange(7) - 3) / 3.5
        at = {
            "grid": (cells - middle) / half,
            "dense": np.array([(x, y) for x in ticks for y in ticks]),
            "corners": 0.9 * np.array([(x, y) for x in (-1, 1) for y in (-1, 1)]),
            "rim": 0.95 * np.column_stack([np.cos(angle), np.sin(angle)]),
        }[pattern]
    return middle + half * at, np.full(len(at), 1 / len(at))


def rigid_loads(position: np.ndarray, obj: ObjectModel, *, widest: bool) -> np.ndarray:
    """Loads of one rigid body: rising evenly over all points, or those of the three of the widest base."""
    whole = np.append(1.0, obj.center_of_mass) * obj.total_mass * GRAVITY
    matrix = np.vstack([np.ones(len(position)), position.T])
    if not widest:
        return np.linalg.lstsq(matrix, whole, rcond=None)[0]
    best, load = 0.0, np.zeros(len(position))
    for three in combinations(range(len(position)), 3):
        base = abs(np.linalg.det(matrix[:, three]))
        if base > best and (carried := np.linalg.solve(matrix[:, three], whole)).min() > 0:
            best, load = base, np.zeros(len(position))
            load[list(three)] = carried
    return load


@dataclass(frozen=True, eq=False)
class Draw:
    """Errors of one setup, without the contacts and the errors that are drawn in each trial."""

    setup: SetupErrors
    waves: np.ndarray
    phases: np.ndarray
    decade: float
    axes: np.ndarray
    tilt: np.ndarray
    tcp: np.ndarray
    tcp_angle: float
    response: np.ndarray
    mounting: np.ndarray
    delay: float

    @staticmethod
    def of(setup: SetupErrors, rng: np.random.Generator) -> Draw:
        """A draw of a setup."""
        scale = np.repeat([300.0, 30.0], 3)
        response = setup.crosstalk * rng.standard_normal((6, 6)) * np.outer(scale, 1 / scale)
        np.fill_diagonal(response, 1 + setup.gain * rng.standard_normal(6))
        way, length = rng.uniform(0, 2 * np.pi, 10), rng.uniform(0.1, 0.5, 10)
        return Draw(
            setup,
            (2 * np.pi / length)[:, None] * np.column_stack([np.cos(way), np.sin(way)]),
            rng.uniform(0, 2 * np.pi, 10),
            setup.speed_friction * rng.standard_normal(),
            setup.anisotropy * rng.standard_normal(2),
            setup.table_tilt * rng.standard_normal(2),
            setup.tcp_offset * rng.standard_normal(2),
            setup.tcp_angle * rng.standard_normal(),
            response,
            Rotation.from_rotvec(setup.mounting_angle * rng.standard_normal(3)).as_matrix(),
            setup.delay * 3**0.5 * rng.uniform(),
        )


def departure(
    setup: SetupErrors,
    segment: np.ndarray,
    drag: np.ndarray,
    push: np.ndarray,
    place: np.ndarray,
    rng: np.random.Generator,
) -> np.ndarray:
    """Departure of every foot's drag from Coulomb's law, drawn for the trial and for each stretch of it."""
    of_trial, *of_stretch = setup.friction_law * rng.standard_normal((2 + segment.max(), 3))
    along, across, around = (of_trial + np.array([*of_stretch, np.zeros(3)])[segment]).T[..., None, None]
    arm = place - place.mean(axis=1, keepdims=True)
    reach = np.sqrt((arm**2).sum(-1).mean())
    return along * push + across * perpendicular(push) + around / reach * drag[..., None] * perpendicular(arm)


def flawed_trial(
    obj: ObjectModel, action: TableAction, feet: Contacts, draw: Draw, rng: np.random.Generator, rate: float = RATE
) -> Trajectory:
    """Record of one action in a drawn setup, with the values that a robot would report.

    The noise of a sample scales with the root of `rate` [Hz], so that means over time have the same noise.
    """
    shape, setup = obj.shape, draw.setup
    grasp = shape.grasps[action.grasp]
    offset, angle = setup.grasp_offset * rng.standard_normal(2), setup.grasp_angle * rng.standard_normal()
    offset = offset + rotation_2d(grasp.angle) @ (draw.tcp * [1, -1])
    turn = rotation_2d(angle + draw.tcp_angle)
    lever = (feet.position - grasp.position) @ turn.T + offset  # from the TCP, in the stated axes
    to_com = turn @ (obj.center_of_mass - grasp.position) + offset
    yaw, spin, alpha, segment = motion(action, rate)
    time = np.arange(len(yaw)) / rate
    yaw0 = rng.uniform(-0.3, 0.3)
    yaw = yaw + yaw0
    arm = rotation_2d(yaw) @ (grasp.position - action.center(shape))
    hand = arm + np.array([0.45, 0.0]) + rng.uniform(-0.02, 0.02, 2)
    velocity = spin[:, None] * perpendicular(arm)
    acceleration = alpha[:, None] * perpendicular(arm) - spin[:, None] ** 2 * arm
    out = rotation_2d(yaw)
    world = np.einsum("nij,fj->nfi", out, lever)
    speed = velocity[:, None] + spin[:, None, None] * perpendicular(world)
    size = np.maximum(np.linalg.norm(speed, axis=-1), 1e-9)
    unit = speed / size[..., None]
    field = setup.place_friction * 0.2**0.5 * np.cos((hand[:, None] + world) @ draw.waves.T + draw.phases).sum(-1)
    drag = feet.drag * (1 + field) * (1 + draw.decade * np.log10(np.clip(size, 1e-4, 1) / 0.02))
    h1, h2 = 2 * draw.axes
    along = unit @ np.array([[1 + h1, h2], [h2, 1 - h1]])
    push = drag[..., None] * along / np.sqrt(np.maximum((along * unit).sum(-1), 1e-30))[..., None]
    law_rng = rng.spawn(1)[0]  # a stream of its own: the other draws do not depend on it
    if setup.friction_law:
        push = push + departure(setup, segment, drag, push, world, law_rng)
    com = np.einsum("nij,j->ni", out, to_com)
    com_acceleration = acceleration + alpha[:, None] * perpendicular(com) - spin[:, None] ** 2 * com
    pull = obj.total_mass * GRAVITY * draw.tilt  # a slope along x and y
    own = obj.total_mass * com_acceleration + pull
    force = push.sum(1) + own
    torque = cross_2d(world, push).sum(1) + obj.inertia_cm * alpha + cross_2d(com, own)
    on_feet = shape.height / 2 * own  # the mass acts at half the height, and so does what a tilt pulls
    moment = np.column_stack([-(on_feet[:, 1] - HEIGHT * force[:, 1]), on_feet[:, 0] - HEIGHT * force[:, 0]])
    wrench = np.column_stack([force, np.zeros(len(time)), moment, torque])
    # as the sensor, which turns with the hand, reads it
    hand_to_world = Rotation.from_rotvec(np.outer(yaw + grasp.angle, [0, 0, 1])) * DOWN
    axes = hand_to_world.as_matrix()
    to_sensor = rotate_wrench(axes.transpose(0, 2, 1), wrench)
    to_sensor = move_wrench(to_sensor, -TOOL.tcp)
    read = rotate_wrench(np.broadcast_to(draw.mounting, axes.shape), to_sensor) @ draw.response.T
    read = read + BIAS * rng.standard_normal(6) + NOISE * (rate / RATE) ** 0.5 * rng.standard_normal((len(time), 6))
    origin = np.einsum("nij,j->ni", out, -grasp.position)
    values = {
        "object_pose": pose_from_point(hand, grasp.position, yaw),
        "object_velocity": np.column_stack([velocity + spin[:, None] * perpendicular(origin), spin]),
        "tcp_position": np.column_stack([hand, np.full(len(time), HEIGHT)]),
        "tcp_velocity": np.column_stack([velocity, np.zeros((len(time), 3)), spin]),
        "sensor_orientation": hand_to_world.as_quat(scalar_first=True),
    }
    then = np.clip(np.arange(len(time)) - round(draw.delay * rate), 0, None)
    values = {name: value[then] for name, value in values.items()}
    recorded = rotate_wrench(axes[then], move_wrench(read, TOOL.tcp))
    return record(
        len(time),
        tare=0,
        action=action,
        time_s=time,
        phase=np.where(segment >= 0, Phase.STEADY, Phase.RAMP),
        segment=segment,
        sensor_wrench=read,
        wrench_on_object_world=recorded,
        sensor_bias_std=BIAS,
        setup=setup,
        **values,
    )


def drawn(index: int, seed: int, pattern: str, blocks: tuple[int, int] = (4, 8), least_grasps: int = 3) -> ObjectModel:
    """Random object with a number of blocks in `blocks` and `least_grasps` grasps or more; `PADS` adds known feet."""
    rng = np.random.default_rng([seed, index])
    for attempt in range(1000):
        size, own = float(rng.uniform(0.03, 0.06)), int(rng.integers(2**31))
        found = Family(count=1, seed=own, size_m=size, friction=[0.15, 0.9], blocks=list(blocks)).draw(0, attempt)
        assert found.blocks is not None
        mass = np.exp(rng.uniform(np.log(0.05), np.log(0.8), len(parse_layout(found.blocks.layout))))
        weighted = found.blocks.model_copy(update={"mass_kg": mass.tolist()})
        obj = ObjectFile(name=f"d{index}", blocks=weighted).build(3, Path())
        if len(obj.shape.grasps) >= least_grasps:
            pads = size / 3 * np.array([(x, y) for x in (-1, 1) for y in (-1, 1)])
            middles = [obj.shape.middle_of(group) for group in range(obj.shape.n_m)]
            return obj.on_feet([middle + pads for middle in middles]) if pattern == PADS else obj
    raise RuntimeError("no object")
