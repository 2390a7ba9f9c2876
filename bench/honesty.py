"""Honesty of the answers in worlds that are not the model: python bench/honesty.py [--objects N] [--seed S].

Objects of four to eight blocks, 30 to 60 mm, 0.05 to 0.8 kg, friction 0.15 to 0.9, stand on their own weight in a plain
Coulomb world of its own contact points, offsets, frictions and sensor errors, drawn anew for each object; in `plastic`
friction departs from Coulomb's law by 10 %. Six turns there and back and six accelerated ones. A row a kind of contact:
methods know the spreads of the errors, never the draw. NAD is the median over all answers in percent; then the root
mean square of the errors over that of the bound, the posterior spread by the trials' information at the truth with the
errors of the setup as drawn beforehand; that of error over claimed error, the 90 % intervals that hold the truth and
their median width as a part of the object's mass, the answers with status ok, and those of them with a group off by
more than three times its claimed error. In brackets 95 % intervals, by a bootstrap over objects, and for the silent
ones the exact upper bound. Below, the methods paired on the same trials.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import dataclass, replace
from functools import partial
from itertools import combinations
from multiprocessing import get_context
from pathlib import Path

import numpy as np
import torch
from rich import box
from rich.console import Console
from rich.table import Table
from scipy.spatial.transform import Rotation
from scipy.stats import beta

from estimators.action_selection.design import Guess, prior_belief
from estimators.identifiability.information import shown_information
from estimators.registry import build_method
from estimators.testing.analytic_world import DOWN, HEIGHT, RATE, TOOL, record
from testbed.actions.accelerate import Accelerate
from testbed.actions.base import TableAction
from testbed.actions.rotate import Rotate
from testbed.frames import cross_2d, move_wrench, perpendicular, pose_from_point, rotate_wrench, rotation_2d
from testbed.objects.blocks import parse_layout
from testbed.objects.files import ObjectFile
from testbed.objects.model import GRAVITY, ObjectModel
from testbed.objects.random import Family
from testbed.sensing.presets import preset
from testbed.trajectory import Phase, Trajectory
from testbed.worlds.feet import Feet
from testbed.worlds.presets import UNSTATED
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
IDEAL = SetupErrors()
WORLDS = {"ideal": IDEAL, "lab": LAB, "rough": ROUGH, "plastic": replace(LAB, friction_law=0.1)}
NINETY = 1.645
"""Standard errors within which 90 % of errors lie."""
SETTINGS = {"explicit_state": {"use_weight": True, "weighting": "covariance"}}
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
        aside = setup.foot_offset * rng.standard_normal((count, 2))
        feet = Feet.known(obj, aside, setup.foot_load * rng.standard_normal(count))
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
    """Points under a block of half a side's length, and their shares of its load."""
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
    """One setup as it is: everything but the contacts and what is drawn by trial."""

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
    """Drag of every foot beside Coulomb's, drawn for the trial and for each stretch of it."""
    of_trial, *of_stretch = setup.friction_law * rng.standard_normal((2 + segment.max(), 3))
    along, across, around = (of_trial + np.array([*of_stretch, np.zeros(3)])[segment]).T[..., None, None]
    arm = place - place.mean(axis=1, keepdims=True)
    reach = np.sqrt((arm**2).sum(-1).mean())
    return along * push + across * perpendicular(push) + around / reach * drag[..., None] * perpendicular(arm)


def flawed_trial(
    obj: ObjectModel, action: TableAction, feet: Contacts, draw: Draw, rng: np.random.Generator
) -> Trajectory:
    """Record of one action in a drawn world, told as if nothing were wrong."""
    shape, setup = obj.shape, draw.setup
    grasp = shape.grasps[action.grasp]
    offset, angle = setup.grasp_offset * rng.standard_normal(2), setup.grasp_angle * rng.standard_normal()
    offset = offset + rotation_2d(grasp.angle) @ (draw.tcp * [1, -1])
    turn = rotation_2d(angle + draw.tcp_angle)
    lever = (feet.position - grasp.position) @ turn.T + offset  # from the TCP, in the axes that are told
    to_com = turn @ (obj.center_of_mass - grasp.position) + offset
    time, yaw, spin, alpha, segment = motion(action)
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
    push = push + departure(setup, segment, drag, push, world, rng.spawn(1)[0])
    com = np.einsum("nij,j->ni", out, to_com)
    com_acceleration = acceleration + alpha[:, None] * perpendicular(com) - spin[:, None] ** 2 * com
    pull = obj.total_mass * GRAVITY * draw.tilt
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
    read = read + BIAS * rng.standard_normal(6) + NOISE * rng.standard_normal((len(time), 6))
    told = rotate_wrench(axes, move_wrench(read, TOOL.tcp))
    origin = np.einsum("nij,j->ni", out, -grasp.position)
    values = {
        "object_pose": pose_from_point(hand, grasp.position, yaw),
        "object_velocity": np.column_stack([velocity + spin[:, None] * perpendicular(origin), spin]),
        "tcp_position": np.column_stack([hand, np.full(len(time), HEIGHT)]),
        "tcp_velocity": np.column_stack([velocity, np.zeros((len(time), 3)), spin]),
        "sensor_orientation": hand_to_world.as_quat(scalar_first=True),
    }
    then = np.clip(np.arange(len(time)) - round(draw.delay * RATE), 0, None)
    values = {name: value[then] for name, value in values.items()}
    return record(
        len(time),
        tare=0,
        action=action,
        time_s=time,
        phase=np.where(segment >= 0, Phase.STEADY, Phase.RAMP),
        segment=segment,
        sensor_wrench=read,
        wrench_on_object_world=told,
        sensor_bias_std=BIAS,
        setup=setup,
        **values,
    )


def motion(action: TableAction) -> tuple[np.ndarray, ...]:
    """Time, yaw, turn rate, its slope and the steady stretch at every sample."""
    parts, begin = [], 0.0
    for segment, (speed, slope, seconds) in enumerate(action.steady):
        time = np.arange(round(seconds * RATE)) / RATE
        yaw, same = begin + speed * time + slope * time**2 / 2, np.ones(len(time))
        parts.append(np.stack([yaw, speed + slope * time, slope * same, segment * same]))
        begin += speed * seconds + slope * seconds**2 / 2
    yaw, spin, alpha, segment = np.concatenate(parts, axis=1)
    return np.arange(len(yaw)) / RATE, yaw, spin, alpha, segment.astype(int)


def drawn(index: int, seed: int, pattern: str) -> ObjectModel:
    """An object that can be gripped at three blocks or more, on feet of known places where the pattern is of such."""
    rng = np.random.default_rng([seed, index])
    for attempt in range(1000):
        size, own = float(rng.uniform(0.03, 0.06)), int(rng.integers(2**31))
        found = Family(count=1, seed=own, size_m=size, friction=[0.15, 0.9]).draw(0, attempt)
        assert found.blocks is not None
        mass = np.exp(rng.uniform(np.log(0.05), np.log(0.8), len(parse_layout(found.blocks.layout))))
        blocks = found.blocks.model_copy(update={"mass_kg": mass.tolist()})
        obj = ObjectFile(name=f"d{index}", blocks=blocks).build(3, Path())
        if len(obj.shape.grasps) >= 3:
            pads = size / 3 * np.array([(x, y) for x in (-1, 1) for y in (-1, 1)])
            middles = [obj.shape.middle_of(group) for group in range(obj.shape.n_m)]
            return obj.on_feet([middle + pads for middle in middles]) if pattern == PADS else obj
    raise RuntimeError("no object")


def trials(
    obj: ObjectModel, pattern: str, setup: SetupErrors, stated: SetupErrors, rng: np.random.Generator
) -> tuple[list[Trajectory], float]:
    """Trials of a drawn world and the weight that the scale read."""
    feet, draw = contacts(obj, pattern, setup, rng), Draw.of(setup, rng)
    grasps = [int(g) for g in rng.permutation(len(obj.shape.grasps))]
    chosen = (grasps * 6)[:6]
    beside = obj.shape.cell / 2
    actions: list[TableAction] = [Accelerate(g) for g in chosen]
    for k, g in enumerate(chosen):
        sign = np.array([(1, 1), (-1, 1), (-1, -1), (1, -1)][k % 4])
        pivot = obj.shape.grasps[g].position + beside * sign
        actions.append(Rotate(g, duration=6.0, pivot=tuple(pivot), back=True))
    found = [flawed_trial(obj, action, feet, draw, rng) for action in actions]
    weight = obj.total_mass + (0.001 + setup.scale) * rng.standard_normal()
    return [replace(t, setup=stated) for t in found], weight


@dataclass(frozen=True)
class Judged:
    """One answer."""

    index: int
    world: str
    contact: str
    method: str
    status: str
    nad: float
    off: tuple[float, ...]
    """Errors of the masses over those claimed."""
    width: float
    """Median width of the 90 % intervals, as a part of the object's mass."""
    seconds: float
    misfit: float
    errors: tuple[float, ...]
    """Errors of the groups, as parts of the object's mass; empty without an answer."""
    bound: tuple[float, ...]
    """Standard deviations of the groups by the information of the trials, as parts of the object's mass."""


def bound(obj: ObjectModel, made: list[Trajectory], weight: float, setup: SetupErrors, support: str) -> np.ndarray:
    """Standard deviations of the masses of the groups that no estimator can beat on average over setups [kg].

    Those of the posterior by the information of the trials at the true masses and frictions (van Trees' bound).
    """
    guess = Guess(weight, preset("ft300s"), setup=setup, supports=(support,))
    information = shown_information(obj.shape, obj.truth, made, guess.assumptions()[0]).information()
    return np.sqrt(np.diag(prior_belief(obj.shape, guess).after(information[None]).covariance()[0]))


def judged(job: tuple[int, str, str], seed: int, methods: tuple[str, ...], given: SetupErrors | None) -> list[Judged]:
    """Answers of the methods on one object under one contact in one world."""
    index, pattern, world = job
    setup = WORLDS[world]
    obj = drawn(index, seed, pattern)
    rng = np.random.default_rng(seed * 1000 + index)
    made, weight = trials(obj, pattern, setup, given or setup, rng)
    rows, support = [], "rigid" if pattern in RIGID else "own_weight"
    least = tuple(bound(obj, made, weight, setup, support) / obj.total_mass)
    for name in methods:
        begin = time.process_time()
        found = build_method(name, SETTINGS.get(name, {})).estimate(obj.shape, weight, made, 0)
        spent, misfit = time.process_time() - begin, found.diagnostics.get("misfit", np.nan)
        nad, off, width, errors = np.nan, np.zeros(0), np.nan, ()
        if found.distribution is not None:
            off, claimed = found.distribution.group_mass(obj.shape) - obj.group_mass, found.group_error(obj.shape)
            nad, errors = float(np.abs(off).sum() / obj.total_mass), tuple(off / obj.total_mass)
            if claimed is None:
                off = np.zeros(0)
            else:
                off, width = off / claimed, float(np.median(2 * NINETY * claimed) / obj.total_mass)
        scores = found.status, nad, tuple(off), width, spent, misfit, errors, least
        rows.append(Judged(index, world, pattern, name, *scores))
    return rows


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--objects", type=int, default=20)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--methods", nargs="+", default=["hidden_states"])
    parser.add_argument("--worlds", nargs="+", choices=WORLDS, default=["ideal", "lab", "rough"])
    parser.add_argument("--contacts", nargs="+", default=list(PATTERNS), help=f"{', '.join([*PATTERNS, PADS, *RIGID])}")
    given = parser.add_mutually_exclusive_group()
    given.add_argument("--blind", dest="given", action="store_const", const=IDEAL, help="state that the setup is exact")
    given.add_argument(
        "--unstated", dest="given", action="store_const", const=UNSTATED, help="state nothing of the setup"
    )
    parser.add_argument("--workers", type=int, default=2)
    args = parser.parse_args()
    kinds = {world: ["grid"] if world == "ideal" else args.contacts for world in args.worlds}
    jobs = [(i, kind, world) for world in args.worlds for kind in kinds[world] for i in range(args.objects)]
    judge = partial(judged, seed=args.seed, methods=tuple(args.methods), given=args.given)
    with get_context("spawn").Pool(args.workers, torch.set_num_threads, (1,)) as pool:
        rows = [row for part in pool.imap(judge, jobs) for row in part]
    table = Table(box=box.SIMPLE_HEAD)
    names = ("world", "contacts", "method")
    numbers = ("NAD", "RMSE / bound", "off / claimed", "90 % hold", "width, %", "ok, %", "silent, %", "misfit", "s")
    for column in (*names, *numbers):
        table.add_column(column, justify="left" if column in names else "right")
    for world in args.worlds:
        for kind in [*kinds[world], "all"] if len(kinds[world]) > 1 else kinds[world]:
            for method in args.methods:
                part = [r for r in rows if (r.world, r.method) == (world, method) and kind in (r.contact, "all")]
                table.add_row(world, kind, method, *summary(part))
    console = Console(width=160)
    console.print(table)
    for world in args.worlds:
        for method in args.methods[1:]:
            console.print(f"{world}: {paired(rows, world, args.methods[0], method)}")


def paired(rows: list[Judged], world: str, first: str, second: str) -> str:
    """Mean difference of NAD of two methods on the same trials, with its 95 % interval: a bootstrap over objects."""
    nad = {name: [r for r in rows if (r.world, r.method) == (world, name)] for name in (first, second)}
    off = 100 * np.array([b.nad - a.nad for a, b in zip(nad[first], nad[second], strict=True)])
    of_object = np.array([r.index for r in nad[first]])
    objects = np.unique(of_object)
    means = np.array([np.nanmean(off[of_object == index]) for index in objects])
    drawn = np.random.default_rng(0).choice(means, (10_000, len(means))).mean(axis=1)
    low, high = np.quantile(drawn, [0.025, 0.975])
    return f"NAD of {second} less that of {first}: {means.mean():.1f} points [{low:.1f}, {high:.1f}]"


def holding(part: list[Judged]) -> str:
    """95 % interval of the share of 90 % intervals that hold: a bootstrap over objects."""
    objects = sorted({r.index for r in part})
    held = np.array([[sum(abs(z) < NINETY for r in part if r.index == i for z in r.off)] for i in objects])
    total = np.array([[sum(len(r.off) for r in part if r.index == i)] for i in objects])
    again = np.random.default_rng(0).integers(len(objects), size=(len(objects), 2000))
    low, high = np.quantile(held[again].sum(0) / total[again].sum(0), [0.025, 0.975])
    return f"[{100 * low:.0f}, {100 * high:.0f}]"


def summary(part: list[Judged]) -> list[str]:
    """Cells of some answers."""
    off = np.concatenate([np.array(r.off) for r in part])
    ok = [r for r in part if r.status == "ok"]
    silent = sum(any(abs(z) > 3 for z in r.off) for r in ok)
    claimed = len(off) > 0
    answered = [r for r in part if r.errors]
    errors, least = (np.concatenate([getattr(r, name) for r in answered]) for name in ("errors", "bound"))
    most = float(beta.ppf(0.975, silent + 1, len(part) - silent)) if silent < len(part) else 1.0
    return [
        f"{100 * np.nanmedian([r.nad for r in part]):.1f}",
        f"{np.sqrt(np.mean(errors**2) / np.mean(least**2)):.2f}",
        f"{np.sqrt(np.mean(off**2)):.2f}" if claimed else "",
        f"{100 * np.mean(np.abs(off) < NINETY):.0f} {holding(part)}" if claimed else "",
        f"{100 * np.nanmedian([r.width for r in part]):.0f}" if claimed else "",
        f"{100 * len(ok) / len(part):.0f}",
        f"{100 * silent / len(part):.1f} [< {100 * most:.1f}]" if claimed else "",
        f"{np.nanmedian([r.misfit for r in part]):.2f}",
        f"{np.mean([r.seconds for r in part]):.2f}",
    ]


if __name__ == "__main__":
    main()
