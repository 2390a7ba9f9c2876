"""Analytic world: records of an object under exact Coulomb friction, in plain numpy, without a simulator."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from testbed.actions.accelerate import Accelerate
from testbed.actions.base import TableAction
from testbed.actions.rotate import Rotate
from testbed.actions.slide import Slide
from testbed.frames import cross_2d, perpendicular, pose_from_point, rotation_2d
from testbed.objects.blocks import block_object, parse_layout
from testbed.objects.model import GRAVITY, ObjectModel, ObjectShape, even_shares
from testbed.trajectory import Phase, Tool, Trajectory

RATE = 100.0
"""Sampling rate [Hz]."""
DOWN = Rotation.from_quat([0.0, 1.0, 0.0, 0.0], scalar_first=True)
"""Orientation with the sensor's z towards the table."""
TOOL = Tool(
    mass=0.9,
    com=np.array([0.01, -0.02, 0.06]),
    inertia=np.array([[2e-3, 1e-4, -2e-4], [1e-4, 3e-3, 3e-4], [-2e-4, 3e-4, 1e-3]]),
    tcp=np.array([0.002, -0.001, 0.17]),
)
"""Lopsided tool, so that nothing cancels by symmetry."""
HEIGHT = 0.022
"""Height of the TCP over the table [m]."""


def record(count: int = 400, *, tare: int = 100, orientation: Rotation = DOWN, **changes: Any) -> Trajectory:
    """Record of a hand at rest: `tare` samples of tare, then one steady stretch. `changes` replaces fields."""
    steady = np.arange(count) >= tare
    values: dict[str, Any] = {
        "action": Rotate(0),
        "status": "ok",
        "reason": "",
        "time_s": np.arange(count) / RATE,
        "phase": np.where(steady, Phase.STEADY, Phase.TARE),
        "segment": np.where(steady, 0, -1),
        "object_pose": np.zeros((count, 3)),
        "object_velocity": np.zeros((count, 3)),
        "tcp_position": np.zeros((count, 3)),
        "tcp_velocity": np.zeros((count, 6)),
        "sensor_orientation": np.tile(orientation.as_quat(scalar_first=True), (count, 1)),
        "sensor_wrench": np.zeros((count, 6)),
        "wrench_on_object_world": np.zeros((count, 6)),
        "joint_position": np.zeros((count, 7)),
        "tool": TOOL,
        "sensor_bias_std": np.zeros(6),
    }
    return Trajectory(**values | changes)


@lru_cache(maxsize=256)  # rules share records, and windows are cached by record
def analytic_trial(
    obj: ObjectModel,
    action: Rotate | Accelerate | Slide,
    *,
    rigid: bool = False,
    springs: float = 0.0,
    lift: float = 0.0,
    moment: tuple[float, float] = (0.0, 0.0),
    wander: float = 0.0,
    noise: float | tuple[float, ...] = 0.0,
    seed: int = 0,
) -> Trajectory:
    """Record of one action.

    Args:
        obj: the object, truth included.
        action: action on the table.
        rigid: one rigid body; else every group rests on its own weight.
        springs: stiffness of springs between neighboring groups over that of a foot.
        lift: vertical force of the gripper [N].
        moment: moment of the feet beyond the weights, about the grasp point, object axes [N m].
        wander: amplitude of the motion of a turn's center, as under a compliant arm [m].
        noise: white noise on each axis of the wrench [N, N m]; one number is in N and 0.1 N m.
        seed: seed of the noise.
    """
    shape = obj.shape
    grasp = shape.grasps[action.grasp].position
    along, rate, rate_slope, segment = motion(action, same_places=True)
    count = len(along)
    if not action.turns:
        heading = action.heading
        yaw, spin, spin_slope = np.zeros(count), np.zeros(count), np.zeros(count)
        hand = along[:, None] * heading + [0.4, 0.1]
        hand_velocity, hand_acceleration = rate[:, None] * heading, np.zeros((count, 2))
    else:
        yaw, spin, spin_slope = along, rate, rate_slope
        arm = rotation_2d(yaw) @ (grasp - action.center(shape))
        hand = arm + np.array([0.4, 0.1])
        hand_velocity = spin[:, None] * perpendicular(arm)
        hand_acceleration = spin_slope[:, None] * perpendicular(arm) - spin[:, None] ** 2 * arm
        off = wander * np.column_stack([np.sin(3 * yaw), np.cos(5 * yaw)])
        hand_velocity += spin[:, None] * perpendicular(off)
    turn = rotation_2d(yaw)
    into = turn.transpose(0, 2, 1)
    velocity = np.einsum("nij,nj->ni", into, hand_velocity)
    acceleration = np.einsum("nij,nj->ni", into, hand_acceleration)

    lever = shape.particles - grasp
    to_com = obj.center_of_mass - grasp
    com_acceleration = acceleration + spin_slope[:, None] * perpendicular(to_com) - spin[:, None] ** 2 * to_com
    inertia = obj.inertia_cm + obj.total_mass * to_com @ to_com
    load = _rigid(obj, lever, lift, moment) if rigid else _own_weight(obj, action.grasp, lift, moment)
    if springs:
        sinks, joined = foundation(obj.shape)
        load = sinks @ np.linalg.lstsq(sinks.T @ sinks + springs * joined, sinks.T @ load)[0]
    drag = np.where(shape.friction_group >= 0, obj.truth.friction[shape.friction_group], 0.0) * load
    particle = velocity[:, None] + spin[:, None, None] * perpendicular(lever)
    speed = np.linalg.norm(particle, axis=-1, keepdims=True)
    push = drag[:, None] * np.divide(particle, speed, out=np.zeros_like(particle), where=speed > 1e-9)
    force = push.sum(axis=1) + obj.total_mass * com_acceleration
    torque = cross_2d(lever, push).sum(axis=1) + inertia * spin_slope + obj.total_mass * cross_2d(to_com, acceleration)

    # the feet's moment is what the gripper's torque leaves, with the mass at half the object's height
    on_feet = np.asarray(moment) + shape.height / 2 * obj.total_mass * com_acceleration
    tilt = np.column_stack([-(on_feet[:, 1] - HEIGHT * force[:, 1]), on_feet[:, 0] - HEIGHT * force[:, 0]])
    wrench = np.column_stack([force, np.full(count, lift), tilt, torque])
    rng = np.random.default_rng(seed)
    sizes = np.array(noise) if isinstance(noise, tuple) else noise * np.repeat([1, 0.1], 3)
    wrench = wrench + sizes * rng.standard_normal((count, 6))
    world = np.array(wrench)
    for part in (slice(0, 2), slice(3, 5)):
        world[:, part] = np.einsum("nij,nj->ni", turn, wrench[:, part])
    origin = np.einsum("nij,j->ni", turn, -grasp)
    still = np.zeros((count, 2))
    return record(
        count,
        tare=0,
        action=action,
        time_s=np.arange(count) / RATE,
        phase=np.where(segment >= 0, Phase.STEADY, Phase.RAMP),
        segment=segment,
        object_pose=pose_from_point(hand, grasp, yaw),
        object_velocity=np.column_stack([hand_velocity + spin[:, None] * perpendicular(origin), spin]),
        tcp_position=np.column_stack([hand, np.full(count, HEIGHT)]),
        tcp_velocity=np.column_stack([hand_velocity, still, still[:, 0], spin]),
        sensor_orientation=(Rotation.from_rotvec(np.outer(yaw, [0, 0, 1])) * DOWN).as_quat(scalar_first=True),
        wrench_on_object_world=world,
    )


def turns(obj: ObjectModel, grasps: list[int] | None = None, **world: object) -> list[Trajectory]:
    """Records of a turn there and back about every grasp, beside its center."""
    chosen = range(len(obj.shape.grasps)) if grasps is None else grasps
    offset = obj.shape.cell / 2
    pivots = [tuple(obj.shape.grasps[g].position + offset) for g in chosen]
    actions = [Rotate(g, duration=2.5, pivot=p, back=True) for g, p in zip(chosen, pivots, strict=True)]
    return [analytic_trial(obj, a, seed=i, **world) for i, a in enumerate(actions)]  # pyright: ignore[reportArgumentType]


def accelerated(obj: ObjectModel, grasps: list[int] | None = None, **world: object) -> list[Trajectory]:
    """Records of an accelerated turn about every grasp."""
    chosen = range(len(obj.shape.grasps)) if grasps is None else grasps
    return [analytic_trial(obj, Accelerate(g), seed=100 + g, **world) for g in chosen]  # pyright: ignore[reportArgumentType]


def drawn_object(seed: int, layout: list[str] | None = None, friction_groups: int = 1) -> ObjectModel:
    """Object of joined blocks with random masses and frictions."""
    layout = layout or [["1111", "0100", "0100"], ["101", "101", "111"], ["110", "011"]][seed % 3]
    return _drawn(seed, tuple(layout), friction_groups)


@lru_cache(maxsize=32)
def _drawn(seed: int, layout: tuple[str, ...], friction_groups: int) -> ObjectModel:
    rng = np.random.default_rng(seed)
    cells = parse_layout(list(layout))
    groups = (rng.permutation(len(cells)) % friction_groups).tolist()
    return block_object(
        "drawn",
        cells,
        size=0.05,
        height=0.03,
        mass=rng.uniform(0.05, 0.6, len(cells)).tolist(),
        friction=rng.uniform(0.2, 0.8, friction_groups).tolist(),
        friction_group=groups,
        grid=3,
    )


def motion(action: TableAction, rate: float = RATE, *, same_places: bool = False) -> tuple[np.ndarray, ...]:
    """Distance along the path, its rate and slope, and the steady stretch, at every sample.

    A way back starts where the way there ends; with `same_places` it is sampled at the same places.
    """
    parts, begin = [], 0.0
    for segment, (speed, slope, seconds) in enumerate(action.steady):
        back = same_places and speed * action.steady[0].speed < 0
        time = (np.arange(round(seconds * rate)) + back) / rate
        along, same = begin + speed * time + slope * time**2 / 2, np.ones(len(time))
        parts.append(np.stack([along, speed + slope * time, slope * same, segment * same]))
        begin += speed * seconds + slope * seconds**2 / 2
    along, pace, slope, segment = np.concatenate(parts, axis=1)
    return along, pace, slope, segment.astype(int)


def own_weight_loads(obj: ObjectModel) -> np.ndarray:
    """Load on every particle [N] where each group rests on its own weight, shape (P,)."""
    shape = obj.shape
    feet = shape.friction_group >= 0
    load = np.zeros(len(feet))
    for group in range(shape.n_m):
        inside = shape.mass_group == group
        share = np.full((inside & feet).sum(), 1 / (inside & feet).sum())
        if shape.stands_on_feet:
            share = even_shares(shape.particles[inside & feet] - shape.middle_of(group))
        load[inside & feet] = obj.particle_mass[inside].sum() * GRAVITY * share
    return load


def foundation(shape: ObjectShape) -> tuple[np.ndarray, np.ndarray]:
    """Foundation of groups that share one tilt.

    Returns:
        Sinking of each foot with the height of each group and the tilt, (P, n_m + 2); and stiffness of springs between
        neighboring groups in these, of 1 N/m each.
    """
    feet = shape.friction_group >= 0
    sinks = np.column_stack([np.eye(shape.n_m)[shape.mass_group], shape.particles]) * feet[:, None]
    joined = np.zeros((shape.n_m + 2, shape.n_m + 2))
    for a, b in shape.neighbors:
        joined[[a, b], [a, b]] += 1
        joined[[a, b], [b, a]] -= 1
    return sinks, joined


def _own_weight(obj: ObjectModel, grasp: int, lift: float, moment: tuple[float, float]) -> np.ndarray:
    """Every group's weight on its own feet; the lift off those held; one tilt on an even foundation."""
    shape = obj.shape
    feet = shape.friction_group >= 0
    load, offset = own_weight_loads(obj), np.zeros((len(feet), 2))
    for group in range(shape.n_m):
        under = (shape.mass_group == group) & feet
        offset[under] = shape.particles[under] - shape.particles[under].mean(axis=0)
    # one foot a group takes no moment
    tilt = offset @ np.linalg.lstsq(offset.T @ offset, np.asarray(moment), rcond=1e-9)[0]
    for group in shape.pressed(shape.grasps[grasp]):
        held = feet & (shape.mass_group == group)
        load -= held * lift / 2 / held.sum()
    return load + tilt


def _rigid(obj: ObjectModel, lever: np.ndarray, lift: float, moment: tuple[float, float]) -> np.ndarray:
    """Loads affine over the feet, in balance with weight, lift and moment."""
    feet = obj.shape.friction_group >= 0
    basis = np.column_stack([np.ones(len(lever)), lever]) * feet[:, None]
    weight = obj.particle_mass * GRAVITY
    wanted = np.append(weight.sum() - lift, weight @ lever + moment)
    return basis @ np.linalg.solve(basis.T @ basis, wanted)
