"""System identification by `mujoco.sysid` on a planar scene: the object alone, driven by its measured motion.

A drive of large inertia moves the grasp point along x, y and yaw; a wrist sensor between drive and object measures the
wrench. Motors apply the gripper's vertical load: its moment tilts the object, its lift acts on the mass group between
the fingers. Contacts are those of the full scene, on a harder foundation.
"""

from __future__ import annotations

import gc
import io
import time
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stdout
from dataclasses import dataclass
from functools import partial
from typing import Any

import mujoco
import numpy as np
from jaxtyping import Bool, Float, Int
from mujoco import sysid
from scipy.optimize import OptimizeResult

from testbed.errors import InvalidValueError
from testbed.frames import rotation_2d
from testbed.objects.model import GRAVITY, ObjectModel
from testbed.simulation.contacts import add_feet, foot_stiffness, soften_feet
from testbed.simulation.scene import add_cell, set_solver
from testbed.simulation.settings import ContactSettings
from testbed.trial import Support
from testbed.worlds.feet import Feet

TIMESTEP = 0.001
"""Physics step [s]; at twice this step the feet of a light guess shake."""
CONTACT = ContactSettings(sag=1e-4, impedance=1e-3, friction_damping=100.0)
"""Contact of the feet, which settles in a third of the time of the full scene."""
ARENA = 2**14
"""Memory of a simulation per particle [byte], twice what is used. MuJoCo's default is 14 MB, and the toolbox keeps many
simulations."""
DRIVE = 1e6
"""Inertia of the drive [kg, kg m^2], too large for an object's drag to slow it down."""
FORCE, TORQUE, PLANAR = "wrist_force", "wrist_torque", [0, 1, 5]
"""Sensors of the drive's wrench on the object, object axes, about the grasp point; indices of f_x, f_y and t_z."""
SETTLE, PART = 60, 2
"""Steps left out at the start of a stretch, while the feet take up their weights; steps that count in each part."""
LEAST, MOST, FRICTIONS = 0.05, 20.0, (0.01, 2.0)
"""Bounds of the fit: least mass of a group over an even share, since the feet of a lighter one shake at `TIMESTEP`;
greatest mass of a group over the guessed total, where M is not known; friction."""


def planar_scene(guess: ObjectModel, support: Support, grasp: Float[np.ndarray, "2"]) -> mujoco.MjSpec:
    """Uncompiled scene: geoms `cell_<particle>` have the masses, pairs `foot_<index>` the frictions.

    Args:
        guess: shape, and initial masses and frictions.
        support: own weight, or rigid.
        grasp: driven point [m], object frame, near the center of a turn: contacts leave out centripetal acceleration.
    """
    spec = mujoco.MjSpec()
    spec.memory = ARENA * len(guess.shape.particles)
    set_solver(spec, TIMESTEP, CONTACT)
    # the discrete integrator lifts sliding feet off a hard foundation
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_EULER
    spec.option.tolerance = 1e-20  # for finite differences at steps of 1e-8
    spec.worldbody.add_geom(name="top", type=mujoco.mjtGeom.mjGEOM_PLANE, size=(1, 1, 0.1), contype=0, conaffinity=0)
    add_feet(spec, guess, _add_groups(spec, _add_drive(spec), guess, support, grasp), CONTACT, Feet.of(guess))
    return spec


def compile_scene(spec: mujoco.MjSpec, guess: ObjectModel) -> mujoco.MjModel:
    """Compile a scene after a change of masses or frictions, with all feet of the same stiffness."""
    soften_feet(model := spec.compile(), guess, Feet.of(guess), CONTACT)
    return model


def sink_depths(guess: ObjectModel, support: Support) -> Float[np.ndarray, "lifts"]:
    """Depth [m] by which each vertical slide of the scene sinks under the guessed weights."""
    if support.is_rigid:
        return np.array([CONTACT.sag])
    feet = guess.shape.feet_per_group
    return guess.group_mass * GRAVITY / feet / foot_stiffness(guess, CONTACT)


def _add_drive(spec: mujoco.MjSpec) -> mujoco.MjsBody:
    """Add drive, wrist and tilt; returns the body of the mass groups, whose frame is on the table under the grasp."""
    hand = _weightless(spec.worldbody.add_body(name="hand"))
    slide, hinge = mujoco.mjtJoint.mjJNT_SLIDE, mujoco.mjtJoint.mjJNT_HINGE
    for name, kind, axis in (("x", slide, (1, 0, 0)), ("y", slide, (0, 1, 0)), ("yaw", hinge, (0, 0, 1))):
        hand.add_joint(name=name, type=kind, axis=axis, armature=DRIVE)
        _add_motor(spec, name, DRIVE)
    hand.add_site(name="wrist")
    for name, kind in ((FORCE, mujoco.mjtSensor.mjSENS_FORCE), (TORQUE, mujoco.mjtSensor.mjSENS_TORQUE)):
        spec.add_sensor(name=name, type=kind, objtype=mujoco.mjtObj.mjOBJ_SITE, objname="wrist")
    plate = _weightless(hand.add_body(name="plate"))
    for name, axis in (("roll", (1, 0, 0)), ("pitch", (0, 1, 0))):
        plate.add_joint(name=name, type=hinge, axis=axis)
        _add_motor(spec, name)
    return plate


def _add_groups(
    spec: mujoco.MjSpec, plate: mujoco.MjsBody, guess: ObjectModel, support: Support, grasp: np.ndarray
) -> list[mujoco.MjsBody]:
    """Add a body for each mass group, on its own vertical slide, or one body for all groups of a rigid object."""
    shape, bodies = guess.shape, []
    for group in range(1 if support.is_rigid else shape.n_m):
        body = plate.add_body(name=f"group_{group}", pos=(*-grasp, shape.height / 2))
        body.add_joint(name=f"lift_{group}", type=mujoco.mjtJoint.mjJNT_SLIDE, axis=(0, 0, 1))
        _add_motor(spec, f"lift_{group}")
        bodies.append(body)
    bodies = bodies * shape.n_m if support.is_rigid else bodies
    for particle in shape.cells.tolist():
        add_cell(bodies[shape.mass_group[particle]], shape, particle, float(guess.particle_mass[particle]))
    return bodies


def _weightless(body: mujoco.MjsBody) -> mujoco.MjsBody:
    """Give a body that carries joints a negligible mass."""
    body.explicitinertial, body.mass, body.inertia = True, 1e-9, (1e-12,) * 3
    return body


def _add_motor(spec: mujoco.MjSpec, joint: str, gear: float = 1.0) -> None:
    spec.add_actuator(name=joint, target=joint, trntype=mujoco.mjtTrn.mjTRN_JOINT, gear=[gear, 0, 0, 0, 0, 0])


@dataclass(frozen=True, eq=False)
class PlanarMotion:
    """K steady stretches of S equal parts, object axes, about the grasp point.

    In a steady stretch motion and wrench are constant in the object frame, so a few steps of each part suffice.
    """

    twists: Float[np.ndarray, "K S 3"]
    """Velocity [m/s] and turn rate [rad/s] in each part; an accelerated stretch has the rate of its middle."""
    spin_up: Float[np.ndarray, "K"]
    """Angular acceleration [rad/s^2]; linear speeds are proportional to the turn rate."""
    moment: Float[np.ndarray, "K 2"]
    """Tilting moment of the gripper about x and y at the table [N m]."""
    lift: Float[np.ndarray, "K"]
    """Vertical force of the gripper [N]."""
    held: Int[np.ndarray, "K 2"]
    """Mass group at each finger."""
    grasp: Float[np.ndarray, "K 2"]
    """Grasp point [m], object frame."""

    @property
    def counted(self) -> Bool[np.ndarray, "T"]:
        """True for steps that count: not the step that changes the velocity to that of a part, nor the next one."""
        part = np.r_[[False, False], np.ones(PART, dtype=bool)]
        return np.concatenate([np.zeros(SETTLE, dtype=bool), np.tile(part, self.twists.shape[1])])

    def velocity(self, step: int) -> Float[np.ndarray, "K 3"]:
        """Velocity before a step [m/s, m/s, rad/s], object axes."""
        part = max(step - SETTLE - 1, 0) // (PART + 2)
        twist = self.twists[:, min(part, self.twists.shape[1] - 1)]
        elapsed = TIMESTEP * (step - len(self.counted) / 2)
        change = np.divide(self.spin_up * elapsed, twist[:, 2], out=np.zeros(len(twist)), where=self.spin_up != 0)
        return twist * (1 + change)[:, None]

    def controls(self, lifts: int) -> Float[np.ndarray, "K T 5+lifts"]:
        """Commands of the motors: acceleration of the drive, world axes; tilting moment; lift per vertical slide."""
        controls = np.empty((len(self.twists), len(self.counted), 5 + lifts))
        held = (np.arange(lifts) == np.minimum(self.held, lifts - 1)[..., None]).mean(axis=1)
        controls[:, :, 3:] = np.concatenate([self.moment, held * self.lift[:, None]], axis=1)[:, None]
        velocity, yaw = self.velocity(0), np.zeros(len(self.twists))
        for step in range(controls.shape[1]):
            target = self.velocity(step + 1)
            yaw = yaw + TIMESTEP * target[:, 2]
            target[:, :2] = np.einsum("kij,kj->ki", rotation_2d(yaw), target[:, :2])
            controls[:, step, :3] = (target - velocity) / TIMESTEP
            velocity = target
        return controls


@dataclass(frozen=True, eq=False)
class PlanarData:
    """Measurements that the toolbox fits."""

    motion: PlanarMotion
    wrench: Float[np.ndarray, "K 3"]
    """f_x, f_y of the gripper on the object and torque about the grasp point, object axes [N, N m]."""
    whiten: Float[np.ndarray, "3K 3K"]
    """Map of wrench errors to unit variance."""
    weight: float | None
    """M as weighed [kg]."""
    weight_error: float
    """Standard error of the weighing [kg]."""


@dataclass(frozen=True, eq=False)
class PlanarFit:
    """Result of the toolbox after I iterations."""

    group_mass: Float[np.ndarray, "n_m"]
    """Mass of each group [kg]."""
    friction: Float[np.ndarray, "n_mu"]
    """Friction of each friction group."""
    masses: Float[np.ndarray, "I n_m"]
    """Mass of each group at each iteration [kg]."""
    losses: Float[np.ndarray, "I"]
    """Mean squared error over its variance at each iteration."""
    seconds: Float[np.ndarray, "I"]
    """Wall time up to each iteration [s]."""
    guesses: int
    """Number of simulated guesses, each over all stretches."""


def check_toolbox() -> None:
    """Raise InvalidValueError if the toolbox's own dependencies are not installed."""
    if not hasattr(sysid, "SystemTrajectory"):  # `import mujoco.sysid` omits names that it cannot import
        given, allowed = "MuJoCo without its toolbox's dependencies", "pip install 'heft-testbed[sysid]'"
        raise InvalidValueError("mujoco_sysid", given, allowed)


@contextmanager
def _collecting() -> Iterator[None]:
    """Collect garbage of the block alone, and all of it at the end: the toolbox leaves reference cycles."""
    gc.freeze()
    try:
        yield
    finally:
        gc.unfreeze()
        gc.collect()


@_collecting()
def identify(guess: ObjectModel, support: Support, measured: PlanarData, max_iters: int) -> PlanarFit:
    """Fit masses and frictions by the toolbox's optimizer "scipy", in units of the residuals' slopes (x_scale "jac").

    Its default optimizer, "mujoco", ends early in the curved valley of two frictions or of light groups, at any
    x_scale.

    Args:
        guess: shape, and the masses and frictions to start from.
        support: support of the weight in the scene.
        measured: data to fit.
        max_iters: greatest number of guesses, without those of finite differences.
    """
    fit = _Residuals(guess, support, measured)
    begin, n_m = time.perf_counter(), guess.shape.n_m
    masses, losses, seconds = [], [], []

    def log(intermediate_result: OptimizeResult) -> None:
        masses.append(intermediate_result.x[:n_m].copy())
        losses.append(intermediate_result.cost)
        seconds.append(time.perf_counter() - begin)

    options: dict[str, Any] = {"x_scale": "jac", "max_iters": max_iters, "verbose": False, "callback": log}
    with redirect_stdout(io.StringIO()):  # the toolbox does not pass on `verbose`, and SciPy prints by default
        _, result = sysid.optimize(fit.parameters(), fit.residuals, optimizer="scipy", **options)
    return PlanarFit(
        result.x[:n_m],
        result.x[n_m:],
        np.array(masses),
        2 * fit.scale**2 * np.array(losses) / len(result.jac),
        np.array(seconds),
        fit.guesses,
    )


class _Residuals:
    """Residuals of all stretches and of the weighing, by the toolbox."""

    def __init__(self, guess: ObjectModel, support: Support, measured: PlanarData):
        self.guesses, self.scale = 0, 0.0
        self._guess, self._measured = guess, measured
        self._models: dict[tuple[int, bytes], mujoco.MjModel] = {}
        self._stretches = sysid.build_residual_fn(
            models_sequences=_sequences(guess, support, measured),
            build_model=self._build,
            modify_residual=self._residual,
            resample_true=False,
            n_threads=1,
        )  # one thread: heft runs a method on each core

    def parameters(self) -> sysid.ParameterDict:
        """Parameters: mass of each group [kg], then each friction, with the guess as initial values."""
        guess, found, particles = self._guess, sysid.ParameterDict(), Feet.of(self._guess).particle
        least = LEAST * guess.total_mass / guess.shape.n_m
        most = guess.total_mass * (MOST if self._measured.weight is None else 1)
        for group, mass in enumerate(guess.group_mass):
            count = guess.shape.particles_per_group[group]
            cells = {f"cell_{i}": guess.shape.fill[i] / count for i in guess.shape.cells_of(group)}
            found.add(sysid.Parameter(f"mass_{group}", mass, least, most, modifier=partial(_set_masses, cells)))
        for group, mu in enumerate(guess.truth.friction):
            feet = [f"foot_{i}" for i, p in enumerate(particles) if guess.shape.friction_group[p] == group]
            found.add(sysid.Parameter(f"friction_{group}", mu, *FRICTIONS, modifier=partial(_set_friction, feet)))
        return found

    def residuals(self, x: np.ndarray, params: sysid.ParameterDict) -> tuple[list[np.ndarray], object, object]:
        """Whitened residuals of wrenches and M at guesses `x` (n,) or (n, G), over the norm of the initial residuals.

        The toolbox's tolerances are for residuals whose initial norm is about 1.
        """
        self.guesses += x.shape[1] if x.ndim == 2 else 1
        self._models.clear()
        differences, predicted, measured = self._stretches(x, params)
        parts = [self._measured.whiten @ np.concatenate(differences)]
        if self._measured.weight is not None:
            excess = (x[: self._guess.shape.n_m].sum(axis=0) - self._measured.weight) / self._measured.weight_error
            parts.append(excess[None])
        self.scale = self.scale or float(np.linalg.norm(np.concatenate(parts)))
        return [np.concatenate(parts) / self.scale], predicted, measured

    def _build(self, params: sysid.ParameterDict, spec: mujoco.MjSpec) -> mujoco.MjModel:
        """Model of a guess at one grasp, shared by its stretches."""
        key = id(spec), params.as_vector().tobytes()
        if not any(spec_id == id(spec) for spec_id, _ in self._models):  # the toolbox goes on to the next grasp
            self._models.clear()
            gc.collect()  # it leaves gigabytes of models in cycles, which look small to Python's collector
        if key not in self._models:
            self._models[key] = compile_scene(sysid.apply_param_modifiers_spec(params, spec), self._guess)
        return self._models[key]

    def _residual(self, params, predicted, measured, model, return_pred_all, **kwargs):
        """Hook of the toolbox: measured wrench of a stretch less the mean over the steps that count, shape (1, 3)."""
        steps = predicted.data[self._measured.motion.counted]
        return (measured.data - steps.mean(axis=0))[:, PLANAR], measured, measured


def _sequences(guess: ObjectModel, support: Support, measured: PlanarData) -> list[sysid.ModelSequences]:
    """Stretches for the toolbox, with a scene per grasp: initial state, controls and measured wrench."""
    motion, sunk = measured.motion, sink_depths(guess, support)
    begin, controls = motion.velocity(0), motion.controls(len(sunk))
    place = np.concatenate([np.zeros(5), -sunk])
    times = TIMESTEP * np.arange(controls.shape[1] + 1)
    whole = np.zeros((len(begin), 1, 6))
    whole[:, 0, PLANAR] = measured.wrench
    sensors = [(name, sysid.SignalType.MjSensor) for name in (FORCE, TORQUE)]
    moved = np.flatnonzero(np.any(np.diff(motion.grasp, axis=0) != 0, axis=1)) + 1
    found = []
    for rows in np.split(np.arange(len(begin)), moved):
        spec = planar_scene(guess, support, motion.grasp[rows[0]])
        model = compile_scene(spec, guess)
        speeds = [np.concatenate([twist, np.zeros(len(sunk) + 2)]) for twist in begin[rows]]
        found.append(
            sysid.ModelSequences(
                f"grasp_{len(found)}",
                spec,
                [f"stretch_{k}" for k in range(len(speeds))],
                [sysid.create_initial_state(model, place, speed) for speed in speeds],
                [sysid.TimeSeries(times, np.vstack([u, u[-1:]])) for u in controls[rows]],  # the last is ignored
                [sysid.TimeSeries.from_names(np.zeros(1), wrench, model, sensors) for wrench in whole[rows]],
            )
        )
    return found


def _set_masses(parts: dict[str, float], spec: mujoco.MjSpec, parameter: sysid.Parameter) -> None:
    for cell, part in parts.items():
        spec.geom(cell).mass = parameter.value[0] * part


def _set_friction(feet: list[str], spec: mujoco.MjSpec, parameter: sysid.Parameter) -> None:
    for foot in feet:
        spec.pair(foot).friction[:2] = parameter.value[0]
