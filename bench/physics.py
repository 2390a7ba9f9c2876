"""Checks of the simulation: python bench/physics.py [sensor|coulomb|pushes|links|tools|levers|resolution]."""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Callable
from concurrent.futures import Future, ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
import torch
from rich.console import Console
from rich.table import Table
from shared import head_table

from estimators.action_selection.random import RandomDrags, RandomPushes
from estimators.action_selection.rank import between_particles
from estimators.base import ActionPolicy
from estimators.hidden_states.trial_windows import TrialWindows
from estimators.particles.observe import observe
from estimators.wrench.model import ModelErrors, ParticleModel, inertia_of
from estimators.wrench.support import own_weight, rigid_loads
from scenarios.catalog import LIBRARY
from scenarios.config import Grid, Scenario, Simulation
from scenarios.execution.executor import default_workers
from scenarios.study.run import run_scenario
from testbed.actions.base import Action
from testbed.actions.rotate import Rotate
from testbed.actions.slide import Slide
from testbed.actions.weigh import Weigh
from testbed.errors import InfeasibleTrialError
from testbed.frames import cross_2d, perpendicular, rotation_2d
from testbed.objects.files import load_object
from testbed.objects.model import ObjectModel
from testbed.sensing.compensation import compensate
from testbed.sensing.windows import weight_of
from testbed.simulation.contacts import resting_loads
from testbed.simulation.runner import SimulationRunner
from testbed.simulation.settings import ContactSettings, ServoSettings, SimulationSettings
from testbed.trajectory import Phase, Trajectory
from testbed.trial import OWN_WEIGHT, RIGID, Support, Trial
from tests.fakes.analytic_links import drawn_chain

TOOLS = ("hammer", "wrench")
HINGED = ("shears", "folding_rule", "saw")
OBJECTS = ("I1", "I2", "L1", "L2", "F1", "F2")
PUSHED = (*OBJECTS, *(str(LIBRARY / "objects" / f"rectangle_{size}.toml") for size in ("2x3", "3x3")))
PUSHES = 8
DRAGS, CHAINS = 8, 10
SUPPORTS = (OWN_WEIGHT, RIGID)
BARE = ServoSettings(integral_gain=0.0, null_gain=0.0)
# MuJoCo's damping ratio and time constant as first tried: stiff in the normal direction, strongly coupled to slip
STIFF = ContactSettings(sag=0.0001, impedance=0.1, friction_damping=10.0, impratio=1e3)
LEVERS = {
    "bare position servo, stiff feet": (BARE, STIFF),
    "bare position servo": (BARE, ContactSettings()),
    "+ integral action": (ServoSettings(null_gain=0.0), ContactSettings()),
    "+ nulling after the grip (default)": (ServoSettings(), ContactSettings()),
    "+ compliance while moving": (ServoSettings(comply_gain=0.3), ContactSettings()),
}


def coulomb_error(name: str, support: Support, action: Rotate | Slide) -> tuple[float, float, float]:
    """Simulated drag against Coulomb's, % of the whole drag and of its torque; feet that the model has lifted, %."""
    model = load_object(name)
    force, torque, lifted = off_coulomb(model, SimulationRunner().run(Trial(model, action, support)), support)[0]
    return force, torque, lifted


def push_errors(name: str) -> np.ndarray:
    """`off_coulomb` of every window of random pushes, shape (K, 3)."""
    model = load_object(name)
    found = trials_by(model, lambda refused: RandomPushes(PUSHES, refused=refused))
    return np.concatenate([off_coulomb(model, trajectory, OWN_WEIGHT) for trajectory in found if trajectory.ok])


def trials_by(model: ObjectModel, policy_of: Callable[[dict[Action, str]], ActionPolicy]) -> list[Trajectory]:
    """Trials that a policy asks for, which is told what was refused."""
    runner, refused, found = SimulationRunner(), dict[Action, str](), list[Trajectory]()
    policy = policy_of(refused)
    while (action := policy.next(model.shape, found)) is not None:
        try:
            found.append(runner.run(Trial(model, action)))
        except InfeasibleTrialError as error:
            refused[action] = str(error)
    return found


def off_coulomb(model: ObjectModel, trajectory: Trajectory, support: Support) -> np.ndarray:
    """Drag in each window against Coulomb's, % of the whole drag and of its torque; feet that are lifted, %; (K, 3)."""
    observed = observe(model.shape, [trajectory])
    assert observed is not None
    particles = ParticleModel.of(model.shape)
    mass = torch.tensor(model.particle_mass)
    table = observed.table(particles)
    load = observed.gripper_load(particles, mass, model.shape.height)
    if support.is_rigid:
        normal = rigid_loads(particles, mass, load)
    else:
        feet = own_weight(particles, mass, load)
        normal = feet.loads(load)
    friction = particles.particle_friction(torch.tensor(model.truth.friction)) * normal
    error = observed.wrench - table.dragged(friction).rows({"mass": mass})
    error[:, 2] += observed.spin_up(inertia_of(particles, mass)) * ~observed.pushed
    lever = (friction * table.lever.norm(dim=-1)).sum(-1)
    parts = (error[:, :2].norm(dim=1) / friction.sum(-1), error[:, 2].abs() / lever, (normal < 0).double().mean(-1))
    return 100 * torch.stack(parts, 1).numpy()


def link_errors(model: ObjectModel) -> tuple[np.ndarray, np.ndarray]:
    """In windows of random drags off Coulomb's law: force and torque (K, 2), and torques about hinges, %."""
    found = trials_by(model, lambda refused: RandomDrags(DRAGS, seed=0, refused=refused))
    trials = TrialWindows.of(model.shape, model.total_mass, found, ModelErrors())
    assert trials is not None
    observed, table, particles = trials.windows, trials.on_table.table, trials.model
    mass = torch.tensor(model.particle_mass)
    load = observed.gripper_load(particles, mass, model.shape.height)
    normal = own_weight(particles, mass, load).loads(load)
    friction = particles.particle_friction(torch.tensor(model.truth.friction)) * normal
    hinges = torch.tensor(model.hinge_friction, dtype=torch.float64)
    off = table.dragged(friction).rows({"mass": mass, "hinge_friction": hinges})
    off[:, :3] -= observed.wrench
    lever = (friction * table.lever.norm(dim=-1)).sum(-1)
    planar = torch.stack([off[:, :2].norm(dim=1) / friction.sum(-1), off[:, 2].abs() / lever], 1)
    about = torch.einsum("krp,kp->kr", table.drag_rows().abs(), friction)
    turning = ~observed.standing
    return 100 * planar.numpy(), 100 * (off / about)[:, 3:][turning].abs().numpy()


def sensor_error(name: str, support: Support, action: Rotate) -> tuple[float, float, float]:
    """Sensor against summed contact wrench over a turn, tared and compensated: % of force, % of torque; slip, deg."""
    trajectory, contacts = SimulationRunner().run_with_contacts(Trial(load_object(name), action, support))
    felt = compensate(trajectory).wrench_on_object_world
    steady = trajectory.mask(Phase.STEADY)
    off = np.abs((felt + contacts.wrench_at_tcp)[steady].mean(axis=0))
    scale = np.linalg.norm(felt[steady][:, :2], axis=1).mean(), np.abs(felt[steady][:, 5]).mean()
    slip = np.degrees(trajectory.figures["slip_rad"])
    return 100 * off[:2].max() / scale[0], 100 * off[5] / scale[1], slip


def foot_error(name: str, support: Support, action: Rotate) -> tuple[float, float, float, float]:
    """Friction of a turn against Coulomb's law with the true load of every foot: % of force, % of torque; slip in the
    grip, mm; part of the time that a foot is lifted, %."""
    model = load_object(name)
    trajectory, contacts = SimulationRunner().run_with_contacts(Trial(model, action, support))
    assert trajectory.ok, trajectory.reason
    steady = trajectory.mask(Phase.STEADY)
    force = contacts.force_on_object[steady]
    lever = (contacts.position - contacts.tcp_position[:, None])[steady, :, :2]
    velocity = trajectory.object_velocity[steady, None]
    feet = np.einsum(
        "tij,pj->tpi", rotation_2d(trajectory.object_pose[steady, 2]), model.shape.particles[contacts.particle]
    )
    slip = velocity[..., :2] + velocity[..., 2:] * perpendicular(feet)
    drag = model.truth.friction[model.shape.friction_group[contacts.particle]] * force[:, :, 2]
    off = force[:, :, :2] + drag[..., None] * slip / np.linalg.norm(slip, axis=2, keepdims=True)
    torque = (drag * np.linalg.norm(lever, axis=2)).sum(axis=1).mean()
    return (
        100 * float(np.linalg.norm(off.sum(axis=1).mean(axis=0)) / drag.sum(axis=1).mean()),
        100 * float(abs(cross_2d(lever, off).sum(axis=1).mean()) / torque),
        1e3 * trajectory.figures["slip_m"],
        100 * float((force[:, :, 2] <= 0).mean()),
    )


def least_load(name: str, support: Support) -> float:
    """Least load on a foot of the object at rest, % of the mean over its mass group's feet."""
    model = load_object(name)
    feet = model.shape.friction_group >= 0
    loads, group = resting_loads(model, support, ContactSettings())[feet], model.shape.mass_group[feet]
    return 100 * min(loads[group == g].min() / loads[group == g].mean() for g in range(model.shape.n_m))


def gripper_load(servo: ServoSettings, contact: ContactSettings, support: Support) -> tuple[float, float, float, float]:
    """Lift after settling; over a turn of L2 the largest lift and moment on the feet, and the torque's spread, %."""
    model = load_object("L2")
    runner = SimulationRunner(SimulationSettings(servo=servo, contact=contact))
    trajectory = runner.run(Trial(model, Rotate(0, pivot=pivot_of_turn("L2", 0)), support))
    wrench, height = trajectory.wrench_on_object_world, trajectory.tcp_position[:, 2]
    settled = np.flatnonzero(trajectory.mask(Phase.SETTLE))[-1]
    steady = np.flatnonzero(trajectory.mask(Phase.STEADY))[100:]
    moment = np.hypot(wrench[:, 4] + height * wrench[:, 0], -wrench[:, 3] + height * wrench[:, 1])
    torque = wrench[steady, 5]
    return wrench[settled, 2], np.abs(wrench[steady, 2]).max(), moment[steady].max(), 100 * torque.std() / torque.mean()


def pivot_of_turn(name: str, grasp: int) -> tuple[float, float] | None:
    """The turn's center that the rank-driven policy would take."""
    shape = load_object(name).shape
    return between_particles(shape, shape.grasps[grasp].position)


def sensor(submit: Callable[..., Future[Any]], console: Console) -> None:
    """Sensor against contact."""
    table = _table(
        "Sensor against summed contact wrench over a turn", "object", "support", "force, %", "torque, %", "slip, deg"
    )
    asked = [(n, s, Rotate(1, duration=18.0, pivot=pivot_of_turn(n, 1))) for n in OBJECTS for s in SUPPORTS]
    for (name, support, _), future in [(a, submit(sensor_error, *a)) for a in asked]:
        table.add_row(name, support.name, *(f"{x:.3f}" for x in future.result()))
    console.print(table)


def coulomb(submit: Callable[..., Future[Any]], console: Console) -> None:
    """Drag against Coulomb's law, every object; the largest of several actions."""
    columns = ("object", "support", "turns: force", "torque", "lifted feet", "slides: force", "torque", "lifted feet")
    table = _table("Drag against Coulomb's law with the measured gripper load, largest error, %", *columns)
    futures = {}
    for name in OBJECTS:
        grasps = range(len(load_object(name).shape.grasps))
        turns = [Rotate(g, duration=6.0, pivot=pivot_of_turn(name, g)) for g in grasps]
        slides = [Slide(g, direction=0.5 + g) for g in grasps]
        for support in SUPPORTS:
            for kind, actions in (("turns", turns), ("slides", slides)):
                futures[name, support, kind] = [submit(coulomb_error, name, support, action) for action in actions]
    for name in OBJECTS:
        for support in SUPPORTS:
            cells = [np.max([f.result() for f in futures[name, support, kind]], axis=0) for kind in ("turns", "slides")]
            table.add_row(name, support.name, *(f"{x:.2f}" for x in np.concatenate(cells)))
    console.print(table)


def pushes(submit: Callable[..., Future[Any]], console: Console) -> None:
    """Drag against Coulomb's law in windows of random pushes."""
    columns = ("object", "windows", "force: median", "rms", "torque: median", "rms", "lifted feet")
    table = _table(f"{PUSHES} pushes: drag against Coulomb's law with the measured load of the fingertip, %", *columns)
    futures = {name: submit(push_errors, name) for name in PUSHED}
    for name, future in futures.items():
        error = future.result()
        median, rms = np.median(error, axis=0), np.sqrt(np.square(error).mean(axis=0))
        cells = (f"{x:.2f}" for x in (median[0], rms[0], median[1], rms[1], error[:, 2].mean()))
        table.add_row(Path(name).stem, str(len(error)), *cells)
    console.print(table)


def links(submit: Callable[..., Future[Any]], console: Console) -> None:
    """Drag against Coulomb's law while links trail."""
    columns = ("object", "windows", "force: median", "rms", "torque: median", "rms", "at hinges: median", "rms")
    table = _table(f"{DRAGS} slides and turns of objects in links: against Coulomb's law, %", *columns)
    models = [*(drawn_chain(seed) for seed in range(CHAINS)), *(load_object(name) for name in HINGED)]
    for model, future in [(model, submit(link_errors, model)) for model in models]:
        planar, hinged = future.result()
        cells = (f"{x:.3f}" for part in [*planar.T, hinged] for x in (np.median(part), np.sqrt(np.square(part).mean())))
        table.add_row(model.name, str(len(planar)), *cells)
    console.print(table)


def tools(submit: Callable[..., Future[Any]], console: Console) -> None:
    """The objects made of meshes: weight, load at rest, friction on their own feet."""
    columns = ("object", "support", "weight, %", "least load, %", "force, %", "torque, %", "slip, mm", "lifted, %")
    table = _table("Tools: weighing, load at rest, and turns about every grasp (largest)", *columns)
    futures = {
        (name, support): [
            submit(foot_error, name, support, Rotate(g, duration=4.0, back=True))
            for g in range(len(load_object(name).shape.grasps))
        ]
        for name in TOOLS
        for support in SUPPORTS
    }
    for (name, support), turns in futures.items():
        model = load_object(name)
        weighed = 100 * (weight_of(SimulationRunner().run(Trial(model, Weigh(), support))) / model.total_mass - 1)
        worst = np.max([f.result() for f in turns], axis=0)
        cells = (f"{abs(weighed):.4f}", f"{least_load(name, support):.0f}", *(f"{x:.2f}" for x in worst))
        table.add_row(name, support.name, *cells)
    console.print(table)


def levers(submit: Callable[..., Future[Any]], console: Console) -> None:
    """Effect of each lever against the gripper's load."""
    columns = ("lever", "support", "fz settled, N", "fz turning, N", "moment on feet, N m", "torque spread, %")
    table = _table("Load on the gripper, a turn of L2 about block B1", *columns)
    asked = [(name, (*pair, support)) for name, pair in LEVERS.items() for support in SUPPORTS]
    for (name, arguments), future in [(a, submit(gripper_load, *a[1])) for a in asked]:
        table.add_row(name, arguments[2].name, *(f"{x:.3f}" for x in future.result()))
    console.print(table)


def resolution(console: Console) -> None:
    """NAD with a halved step, with other feet, and with feet that the particles do not match."""
    table = _table("NAD, own weight, ideal, %", "change", "I2", "L2", "F2")
    base = Scenario(objects=["I2", "L2", "F2"], methods={"hidden_states": {}})
    changes = {
        "none: 5 ms, 3 x 3 feet and particles": {},
        "step 2.5 ms": {"simulation": Simulation(timestep_s=0.0025)},
        "4 x 4 feet and particles": {"grid": Grid(feet=4, particles=4)},
        "4 x 4 feet, 3 x 3 particles": {"grid": Grid(feet=4, particles=3)},
        "welded grip": {"simulation": Simulation(grip="weld")},
    }
    for name, change in changes.items():
        with tempfile.TemporaryDirectory() as folder:
            asked = base.model_copy(update=change)
            rows = run_scenario(asked, Path(folder), default_workers(), lambda *_, **__: None)
        nad = dict(zip(rows["object"], rows["nad"], strict=True))
        table.add_row(name, *(f"{100 * nad[o]:.2f}" for o in ("I2", "L2", "F2")))
    console.print(table)


def _table(title: str, *columns: str) -> Table:
    words = ("object", "support", "lever", "change")
    return head_table(*columns, left=words, title=title, title_justify="left")


def main() -> None:
    """Print the tables asked for."""
    what = sys.argv[1] if len(sys.argv) > 1 else "all"
    console = Console(width=120)
    every = (sensor, coulomb, pushes, links, tools, levers)
    parts = {part.__name__: part for part in every}
    context = get_context("spawn")
    with ProcessPoolExecutor(default_workers(), context, torch.set_num_threads, (1,)) as pool:
        for name, show in parts.items():
            if what in (name, "all"):
                show(pool.submit, console)
    if what in ("resolution", "all"):
        resolution(console)


if __name__ == "__main__":
    main()
