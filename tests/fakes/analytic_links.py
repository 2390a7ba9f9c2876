"""Turns and slides of known objects in links: the hand moves one steadily, and the others trail by their own mechanics.

The motion solves the equations of every hinge: the torque about it of what trails, of exact Coulomb friction and of
inertia, is the hinge's own friction. The record ends where a hinge comes to rest.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from itertools import product

import numpy as np
from jaxtyping import Float
from scipy.integrate import solve_ivp

from estimators.testing.analytic_world import HEIGHT, RATE, own_weight_loads, record
from testbed import InvalidValueError, ObjectModel, Phase, Rotate, Slide, Trajectory
from testbed.frames import cross_2d, perpendicular, pose_from_point, rotation_2d
from testbed.objects.blocks import block_object, parse_layout
from testbed.objects.chain import Chain
from testbed.sensing.camera import PoseStream

SLOW = 1e-7
"""Speed at which friction of a particle fades [m/s]: the center of a link's turn comes to rest on one, as it does."""
STANDS = 0.02
"""Turn of a hinge at which the record ends [rad/s]."""


@cache
def analytic_links(
    obj: ObjectModel, action: Rotate | Slide, *, rate: float = RATE, camera_rate: float | None = None
) -> Trajectory:
    """Record of one action on an object in links, on its own weight, from rest of those that trail, computed once.

    `camera_rate` is that of the exact camera [Hz], a multiple of `rate`, or None for `rate` itself. An object without
    hinges, or with one that stands from the beginning, is an InvalidValueError.
    """
    shape, chain = obj.shape, obj.shape.chain
    if chain is None:
        raise InvalidValueError("obj.shape.chain", None, "an object with hinges")
    point = shape.grasps[action.grasp].position
    held = int(chain.link[shape.pressed(shape.grasps[action.grasp])[0]])
    if action.turns:
        hand = action.speed * np.array([*perpendicular(point - action.center(shape)), 1.0])
    else:
        hand = np.array([*(action.speed * action.heading), 0.0])
    chained = _Chained(obj, chain, held, point, hand, np.zeros(0))
    free = [link for link in range(chain.links) if link != held]
    still = np.zeros(2 * len(free))
    chained.sign = chained.first_signs(still)
    if not chained.sign.all():
        raise InvalidValueError("action", str(action), "one that turns every hinge at once: across the links")

    def standing(_: float, state: np.ndarray) -> float:
        return float((chained.relative(state) * chained.sign).min()) - STANDS

    standing.terminal, standing.direction = True, -1  # pyright: ignore[reportFunctionMemberAccess]
    each = 1 if camera_rate is None else round(camera_rate / rate)
    times = np.arange(0, action.duration, 1 / (rate * each))
    solved = solve_ivp(
        chained.rates, (0, times[-1]), still, "LSODA", times, events=standing, rtol=1e-9, atol=1e-11, max_step=0.02
    )
    return _record(chained, action, solved.t, solved.y.T, each)


@cache
def drawn_chain(seed: int) -> ObjectModel:
    """A bar of two or three links, of one to three blocks each, with random masses and frictions."""
    rng = np.random.default_rng(seed)
    blocks = rng.integers(1, 4, int(rng.integers(2, 4)))
    count, size = int(blocks.sum()), 0.03
    bar = block_object(
        f"chain_{seed}",
        parse_layout(["1" * count]),
        size=size,
        height=0.02,
        mass=rng.uniform(0.04, 0.25, count).tolist(),
        friction=[float(rng.uniform(0.2, 0.6))],
        friction_group=[0] * count,
        grid=3,
    )
    hinges = (np.cumsum(blocks)[:-1] - count / 2) * size
    chain = Chain(np.repeat(np.arange(len(blocks)), blocks), np.column_stack([hinges, np.zeros(len(hinges))]))
    torques = rng.uniform(0, 0.015, len(hinges))
    return replace(bar, shape=replace(bar.shape, chain=chain), hinge_friction=tuple(torques.tolist()))


class _Chained:
    """Mechanics of what trails; a state has the angles of the free links against the hand's frame, then their rates.

    Rates are of the links in the world.
    """

    def __init__(
        self, obj: ObjectModel, chain: Chain, held: int, point: np.ndarray, hand: np.ndarray, sign: np.ndarray
    ):
        shape = obj.shape
        self.obj, self.chain, self.held, self.point, self.hand, self.sign = obj, chain, held, point, hand, sign
        self.free = [link for link in range(chain.links) if link != held]
        self.link = chain.link[shape.mass_group]
        friction = np.where(shape.friction_group >= 0, obj.truth.friction[shape.friction_group], 0.0)
        self.drag, self.mass = friction * own_weight_loads(obj), obj.particle_mass
        self.beyond = np.array([np.isin(self.link, chain.beyond(h, held)) for h in range(len(chain.hinges))])

    def links(self, state: np.ndarray, slopes: np.ndarray) -> Float[np.ndarray, "L 9"]:
        """Motion of every link, in the held one's axes."""
        turned = np.zeros((1, self.chain.links, 3))
        turned[0, self.free] = np.column_stack([*np.split(state, 2), slopes])
        side = self.hand[2] * perpendicular(self.hand[:2])  # the hand's velocity turns with it
        return self.chain.moved(self.held, self.point, self.hand[None], np.array([*side, 0.0]), turned)[0]

    def particles(self, links: Float[np.ndarray, "L 9"]) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Place of every particle [m], its friction, and the force and torque that its motion takes [N, N m]."""
        own = links[self.link]
        c, s = np.cos(own[:, 0]), np.sin(own[:, 0])
        x, y = (self.obj.shape.particles - self.point).T
        place = np.column_stack([c * x - s * y, s * x + c * y]) + own[:, 1:3]
        velocity = own[:, 3:5] + own[:, 5:6] * perpendicular(place)
        unit = velocity / np.sqrt((velocity**2).sum(axis=1, keepdims=True) + SLOW**2)
        pull = own[:, 6:8] + own[:, 8:9] * perpendicular(place) - own[:, 5:6] ** 2 * place
        pull = self.mass[:, None] * pull
        return place, self.drag[:, None] * unit, pull, self.mass * own[:, 8] * self.obj.shape.cell**2 / 6

    def torques(self, state: np.ndarray, slopes: np.ndarray) -> Float[np.ndarray, "H"]:
        """Torque about every hinge of all that trails behind it [N m]."""
        links = self.links(state, slopes)
        place, friction, pull, turning = self.particles(links)
        joints = [
            rotation_2d(links[h, 0]) @ (hinge - self.point) + links[h, 1:3] for h, hinge in enumerate(self.chain.hinges)
        ]
        each = np.array([cross_2d(place - joint, friction + pull) + turning for joint in joints])
        return (each * self.beyond).sum(axis=1)

    def relative(self, state: np.ndarray) -> Float[np.ndarray, "H"]:
        """Rate of what trails behind each hinge against the link before it [rad/s]."""
        rate = np.full(self.chain.links, self.hand[2])
        rate[self.free] = np.split(state, 2)[1]
        way = np.where(np.arange(len(self.chain.hinges)) >= self.held, 1.0, -1.0)
        return way * np.diff(rate)

    def first_signs(self, state: np.ndarray) -> Float[np.ndarray, "H"]:
        """Sense in which every hinge begins to turn; 0 of one that friction holds."""
        relative, hinges = self.relative(state), len(self.chain.hinges)
        for signs in product((1.0, -1.0), repeat=hinges):
            self.sign = np.array(signs)
            ahead = np.concatenate([state[: len(state) // 2], np.split(self.rates(0.0, state), 2)[1]])
            begins = self.relative(ahead) - self.relative(np.zeros_like(state))
            if (np.where(np.abs(relative) > STANDS, relative, begins) * signs > 0).all():
                return self.sign
        return np.zeros(hinges)

    def rates(self, _: float, state: np.ndarray) -> np.ndarray:
        """Change of the state a second."""
        free = len(self.free)
        base = self.torques(state, np.zeros(free))
        matrix = np.column_stack([self.torques(state, one) - base for one in np.eye(free)])
        slopes = np.linalg.solve(matrix, -base - np.array(self.obj.hinge_friction) * self.sign)
        return np.concatenate([np.split(state, 2)[1] - self.hand[2], slopes])


def _record(
    chained: _Chained, action: Rotate | Slide, seen: np.ndarray, seen_states: np.ndarray, each: int
) -> Trajectory:
    time, states = seen[::each], seen_states[::each]
    hand, shape, count = chained.hand, chained.obj.shape, len(time)
    yaw, place = _hand(hand, time)
    turn = rotation_2d(yaw)
    velocity, still = turn @ hand[:2], np.zeros((count, 2))
    wrench = np.zeros((count, 6))
    for index, state in enumerate(states):
        slopes = np.split(chained.rates(0.0, state), 2)[1]
        links = chained.links(state, slopes)
        where, friction, pull, turning = chained.particles(links)
        force = friction + pull
        total, torque = force.sum(axis=0), float(cross_2d(where, force).sum() + turning.sum())
        moment = shape.height / 2 * pull.sum(axis=0)
        tilt = np.array([HEIGHT * total[1] - moment[1], moment[0] - HEIGHT * total[0]])
        wrench[index] = [*(turn[index] @ total), 0.0, *(turn[index] @ tilt), torque]
    return record(
        count,
        tare=0,
        action=action,
        time_s=time,
        phase=np.full(count, Phase.STEADY),
        segment=np.zeros(count, dtype=int),
        object_pose=pose_from_point(place, chained.point, yaw),
        object_velocity=np.column_stack(
            [velocity - hand[2] * perpendicular(turn @ chained.point), np.full(count, hand[2])]
        ),
        tcp_position=np.column_stack([place, np.full(count, HEIGHT)]),
        tcp_velocity=np.column_stack([velocity, still, still[:, 0], np.full(count, hand[2])]),
        wrench_on_object_world=wrench,
        camera=PoseStream(seen, _poses(chained, seen, seen_states)),
    )


def _hand(hand: np.ndarray, time: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Yaw [rad] and place [m] of the hand at given times [s], world."""
    yaw = hand[2] * time
    arm = perpendicular(hand[:2]) / -hand[2] if hand[2] else np.zeros(2)  # from the center of the turn
    return yaw, rotation_2d(yaw) @ arm + time[:, None] * (0.0 if hand[2] else hand[:2]) + [0.4, 0.1]


def _poses(chained: _Chained, time: np.ndarray, states: np.ndarray) -> Float[np.ndarray, "F L 3"]:
    """Poses of the object frame as each link carries it, world."""
    yaw, place = _hand(chained.hand, time)
    turn, poses = rotation_2d(yaw), np.zeros((len(time), chained.chain.links, 3))
    for index, state in enumerate(states):
        links = chained.links(state, np.zeros(len(chained.free)))
        shifted = links[:, 1:3] - (rotation_2d(links[:, 0]) @ chained.point)
        poses[index] = np.column_stack([place[index] + shifted @ turn[index].T, yaw[index] + links[:, 0]])
    return poses
