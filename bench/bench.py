"""Speed and memory, as ratios measured side by side in one process: `make bench`."""

from __future__ import annotations

import os
import resource
import statistics
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial

os.environ["OPENBLAS_NUM_THREADS"] = "1"  # before numpy starts its threads

import mujoco
import numpy as np
import torch
from rich.table import Table
from shared import head_table, show

from estimators.action_selection.rank import between_particles
from estimators.baselines.diff_lcp import DiffLcp
from estimators.baselines.explicit_state import ExplicitState
from estimators.baselines.sampling import RandomSearch, WeightedSampling
from estimators.descent import OPTIMIZERS
from estimators.hidden_states.equations import FrictionEquations
from estimators.hidden_states.estimator import HiddenStates
from estimators.hidden_states.friction import closed_form, descend_loads
from estimators.particles.observe import observe
from estimators.posterior.on_table import OnTable
from estimators.wrench.model import ParticleModel, inertia_of, one_step
from testbed.actions.accelerate import Accelerate
from testbed.actions.rotate import Rotate
from testbed.objects.files import load_object
from testbed.objects.model import GRAVITY, MassDistribution
from testbed.sensing.noise import draw_sensing
from testbed.sensing.presets import preset
from testbed.simulation.controller import Servo
from testbed.simulation.motion import plan_motion
from testbed.simulation.runner import SimulationRunner, place
from testbed.simulation.scene import build_scene
from testbed.simulation.settings import SimulationSettings
from testbed.trajectory import Trajectory
from testbed.trial import OWN_WEIGHT, Trial

SETTINGS = SimulationSettings()
TURNS = 12
DRAWS = 4
"""Draws of a batch: as many as a block object has in the main job."""


def seconds(function: Callable[[], object], repeats: int = 5) -> float:
    """Median wall time of a call, s, after one call to warm up."""
    function()
    times = []
    for _ in range(repeats):
        begin = time.perf_counter()
        function()
        times.append(time.perf_counter() - begin)
    return statistics.median(times)


def bare_loop(settings: SimulationSettings) -> Callable[[], None]:
    """Nothing but mj_step over the model and the commands of `turn_of_l2`."""
    trial = turn_of_l2()
    motion = plan_motion(trial.action, trial.object.shape, settings)
    scene = build_scene(trial.object, OWN_WEIGHT, trial.grasp, settings, origin=motion.center)
    data = mujoco.MjData(scene.model)
    place(scene, data, motion)
    servo = Servo(data, motion, settings)
    controls = []
    for tick in range(len(motion.q)):
        servo.command(tick)
        controls.append(data.ctrl.copy())
        mujoco.mj_step(scene.model, data, settings.steps)
        servo.measure(tick)

    def bare() -> None:
        mujoco.mj_resetData(scene.model, data)
        place(scene, data, motion)
        for control in controls:
            data.ctrl[:] = control
            mujoco.mj_step(scene.model, data, settings.steps)

    return bare


def turn_of_l2() -> Trial:
    """A turn of 6 s."""
    return Trial(load_object("L2"), Rotate(2, duration=6.0))


def time_trial(table: Table) -> None:
    """Rows of a trial, beside bare loops at its own step and at 1 ms."""
    runner, trial = SimulationRunner(SETTINGS), turn_of_l2()
    fine = replace(SETTINGS, timestep=0.001)
    loops = [bare_loop(SETTINGS), bare_loop(fine)]
    whole, bare, at_1_ms = side_by_side([lambda: runner.run(trial), *loops], 3)
    count = len(plan_motion(trial.action, trial.object.shape, SETTINGS).q)
    for label, loop, settings, goal in (
        (f"at its own step, {SETTINGS.timestep * 1e3:g} ms", bare, SETTINGS, "<= 1.25"),
        ("at 1 ms", at_1_ms, fine, ""),
    ):
        ratio = f"{whole / loop:.2f}"
        table.add_row(f"trial / bare mj_step loop {label}", f"{whole:.2f} s", f"{loop:.2f} s", ratio, goal)
        step = loop / count / settings.steps
        speed = f"{settings.timestep / step:.0f} x real time"
        name = f"mj_step {label}, arm gripping six blocks, 54 feet"
        table.add_row(name, f"{step * 1e6:.0f} us", f"{settings.timestep * 1e3:g} ms", speed, "")


def six_turns() -> tuple[list[Trajectory], float]:
    """Three turns there and back (six turns) and three accelerated turns of L2, by a perfect sensor."""
    model, runner = load_object("L2"), SimulationRunner(SETTINGS)
    turns = [
        Rotate(g, duration=6.0, pivot=between_particles(model.shape, model.shape.grasps[g].position), back=True)
        for g in (0, 2, 4)
    ]
    actions = [*turns, *(Accelerate(g) for g in (0, 2, 4))]
    return [runner.run_clean(Trial(model, action)) for action in actions], model.total_mass


def sensed(clean: list[Trajectory], seed: int) -> list[Trajectory]:
    """A draw of an FT-300S's errors on each trial."""
    return [draw_sensing(t, preset("ft300s"), 100 * seed + i) for i, t in enumerate(clean)]


def loss_and_gradient(grid: int) -> tuple[int, Callable[[], None]]:
    """One loss and gradient of the one-step model against mass and friction, with grid x grid particles a block."""
    shape = load_object("L2", grid).shape
    model = ParticleModel.of(shape)
    mass = torch.full((shape.n_m,), 1.8 / len(shape.particles), dtype=torch.float64, requires_grad=True)
    friction = torch.full((shape.n_mu,), 0.5, dtype=torch.float64, requires_grad=True)
    pose = torch.zeros(TURNS, 1, 3, dtype=torch.float64)
    velocity = torch.tensor([0.01, 0.02, 0.17], dtype=torch.float64).expand(TURNS, 1, 3)
    wrench = torch.ones(TURNS, 1, 3, dtype=torch.float64)
    grasp = torch.zeros(TURNS, 2, dtype=torch.float64)

    def once() -> None:
        particle_mass = model.particle_mass(mass)
        load = (model.particle_friction(friction) * particle_mass * GRAVITY).expand(TURNS, 1, -1)
        predicted = one_step(model, inertia_of(model, particle_mass), load, pose, velocity, wrench, grasp, 0.01)
        (predicted - velocity).square().sum().backward()

    return len(shape.particles), once


def time_batches(table: Table, clean: list[Trajectory], weight: float) -> None:
    """Rows of the gradient methods: draws in one batch, and one at a time."""
    shape, seeds = load_object("L2").shape, range(DRAWS)
    draws = [sensed(clean, seed) for seed in seeds]
    weights = [weight] * DRAWS
    for method in (ExplicitState(), DiffLcp()):
        functions = [
            partial(method.estimate_many, shape, weights, draws, seeds),
            lambda m=method: [m.estimate(shape, weight, draws[seed], seed) for seed in seeds],
        ]
        together, apart = side_by_side(functions, 3)
        label = f"{type(method).__name__}, 500 steps: {DRAWS} draws at once, against one at a time"
        table.add_row(label, f"{together:.2f} s", f"{apart:.2f} s", f"{together / apart:.2f}", "")
        table.add_row(f"{type(method).__name__}, estimates a second", f"{DRAWS / together:.2f}",
                      f"{DRAWS / apart:.2f}", "", "")  # fmt: skip


def side_by_side(functions: list[Callable[[], object]], rounds: int = 7) -> list[float]:
    """Median wall times, s, of functions called in turn, so that whatever else the machine does hits all."""
    times = [[] for _ in functions]
    for _ in range(rounds):
        for function, taken in zip(functions, times, strict=True):
            taken.append(seconds(function, 3))
    return [statistics.median(taken) for taken in times]


def peak_memory_mb() -> float:
    """Peak resident memory of a fresh process that runs a trial and an estimate, MiB."""
    script = (
        "import resource, torch; torch.set_num_threads(1)\n"
        "from testbed.objects.files import load_object; from testbed.actions.rotate import Rotate\n"
        "from testbed.trial import Trial\n"
        "from testbed.simulation.runner import SimulationRunner\n"
        "from estimators.hidden_states.estimator import HiddenStates\n"
        "m = load_object('L2'); r = SimulationRunner()\n"
        "t = [r.run(Trial(m, Rotate(g, back=True))) for g in (0, 2, 4)]\n"
        "assert HiddenStates().estimate(m.shape, m.total_mass, t, 0).status == 'ok'\n"
        "print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)\n"
    )
    return float(subprocess.run([sys.executable, "-c", script], check=True, capture_output=True, text=True).stdout)


def main() -> None:
    """Print one table."""
    torch.set_num_threads(1)
    table = head_table("what", "measured", "against", "ratio", "goal", left=("what",))

    time_trial(table)
    clean, weight = six_turns()
    trajectories = sensed(clean, 0)
    shape = load_object("L2").shape
    observed = observe(shape, trajectories)
    assert observed is not None
    steady = observed.where(~observed.accelerated)
    settings = HiddenStates()
    at = MassDistribution(np.full(shape.n_m, weight / len(shape.particles)), np.full(shape.n_mu, 0.5))
    on_table = OnTable.of(shape, steady, "own_weight", settings.errors)
    system = FrictionEquations.about(on_table, weight, at, settings.errors).whitened()
    exact = seconds(lambda: closed_form(system), 50)
    table.add_row("closed form of s, six turns", f"{exact * 1e3:.2f} ms", "", "", "<= 10 ms")
    reference = closed_form(system)
    for optimizer in OPTIMIZERS:
        took = seconds(lambda name=optimizer: descend_loads(system, (name,), 500, 0.0), 3)
        error = np.abs(descend_loads(system, (optimizer,), 500, 0.0)[0] - reference).max() / reference.max()
        table.add_row(f"500 gradient steps, {optimizer} (off by {error:.0e})", f"{took:.3f} s", f"{exact * 1e3:.2f} ms",
                      f"{took / exact:.0f}", "<= 0.5 s")  # fmt: skip
    took = seconds(lambda: settings.estimate(shape, weight, trajectories, 0))
    table.add_row("whole estimate, closed form", f"{took * 1e3:.0f} ms", "", "", "")
    took_draw = seconds(lambda: sensed(clean, 0))
    table.add_row("a sensing draw of six trials", f"{took_draw * 1e3:.0f} ms", "", "", "")

    quick = settings.estimate(shape, weight, trajectories, 0).seconds
    for kind, goal in ((RandomSearch, 2), (WeightedSampling, 2), (ExplicitState, 5), (DiffLcp, 60)):
        took = kind().estimate(shape, weight, trajectories, 0).seconds
        label = f"{kind.__name__}, 500 iterations (each optimiser), against hidden_states"
        table.add_row(label, f"{took:.2f} s", f"{quick:.3f} s", f"{took / quick:.0f}", f"<= {goal} s")

    time_batches(table, clean, weight)
    scaling = [(count, seconds(once)) for count, once in map(loss_and_gradient, (4, 13, 41, 129))]
    first = scaling[0]
    for count, took in scaling:
        each, growth = took / count * 1e9, took / first[1] / (count / first[0])
        label = f"loss and gradient, {count} particles x {TURNS} turns"
        table.add_row(label, f"{took * 1e3:.2f} ms", f"{each:.0f} ns/particle", f"{growth:.2f} x linear", "<= 1")
    table.add_row("peak memory of a worker", f"{peak_memory_mb():.0f} MiB", "", "", "<= 1024 MiB")
    own = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    table.add_row("peak memory of this process", f"{own:.0f} MiB", "", "", "")
    show(table, width=130)


if __name__ == "__main__":
    main()
