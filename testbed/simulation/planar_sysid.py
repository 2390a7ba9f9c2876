"""A scene for identification: the object alone, driven in the plane by its measured motion, feet under its particles.

A drive that nothing holds back moves the grasp point along x, y and yaw; a wrist sensor between the drive and the
object feels what that takes. What the gripper carries is put in by motors: its moment tilts the object, its lift pulls
at the mass group between the fingers. Contacts are the bench's, on a harder foundation.
"""

from __future__ import annotations

import gc
import io
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import pairwise

import mujoco
import numpy as np
from jaxtyping import Bool, Float, Int
from mujoco import sysid

from testbed.errors import InvalidValueError
from testbed.frames import rotation_2d
from testbed.objects.model import GRAVITY, ObjectModel
from testbed.simulation.scene import add_feet, foot_stiffness, set_solver, soften_feet
from testbed.simulation.settings import ContactSettings
from testbed.trial import Support

TIMESTEP = 0.001
"""Physics step, s: at twice it the feet of a light guess shake."""
CONTACT = ContactSettings(sag=1e-4, impedance=1e-3)
"""Of the feet: it settles in a third of the bench's time."""
ARENA = 2**22
"""Of a simulation, bytes: a tenth is used, and the toolbox keeps many at once, each MuJoCo's own 14 MB large."""
DRIVE = 1e6
"""Inertia of the drive, kg and kg m^2: the drag of an object does not slow it down."""
FORCE, TORQUE = "wrist_force", "wrist_torque"
"""Sensors: what the drive does to the object, object axes, about the grasp point."""


def planar_scene(guess: ObjectModel, support: Support, grasp: Float[np.ndarray, "2"]) -> mujoco.MjSpec:
    """The scene, not yet compiled: geoms `cell_<particle>` have the masses, pairs `foot_<particle>` the frictions.

    Args:
        guess: shape, and the masses and frictions that it is first built with.
        support: own weight, or rigid.
        grasp: point that is driven, m, object frame. A contact in MuJoCo leaves out the centripetal acceleration about
            the joints, and where a foot hardly moves that is not small: a turn is best driven from near its centre.
    """
    spec = mujoco.MjSpec()
    spec.memory = ARENA
    set_solver(spec, TIMESTEP, CONTACT)
    spec.option.tolerance = 1e-20  # slopes are differences of 1e-8
    spec.worldbody.add_geom(name="top", type=mujoco.mjtGeom.mjGEOM_PLANE, size=(1, 1, 0.1), contype=0, conaffinity=0)
    add_feet(spec, guess, _add_groups(spec, _add_drive(spec), guess, support, grasp), CONTACT)
    return spec


def compiled(spec: mujoco.MjSpec, guess: ObjectModel) -> mujoco.MjModel:
    """The model of a scene whose masses or frictions may have changed: every foot of the same stiffness again."""
    model = spec.compile()
    feet = np.flatnonzero(guess.shape.friction_group >= 0)
    soften_feet(model, guess, feet, np.array([model.geom(f"foot_{particle}").id for particle in feet]), CONTACT)
    return model


def sinking(guess: ObjectModel, support: Support) -> Float[np.ndarray, "lifts"]:
    """How far each vertical slide of the scene sinks under the weights that are guessed, m."""
    if support.is_rigid:
        return np.array([CONTACT.sag])
    shape = guess.shape
    feet = np.bincount(shape.mass_group[shape.friction_group >= 0], minlength=shape.n_m)
    return guess.group_mass * GRAVITY / feet / foot_stiffness(guess, CONTACT)


def _add_drive(spec: mujoco.MjSpec) -> mujoco.MjsBody:
    """Drive, wrist and tilt; the body that the mass groups hang on, its frame on the table under the grasp point."""
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
    """The body of each mass group, on a vertical slide of its own; under a rigid body one for all."""
    shape, bodies = guess.shape, []
    for group in range(1 if support.is_rigid else shape.n_m):
        body = plate.add_body(name=f"group_{group}", pos=(*-grasp, shape.height / 2))
        body.add_joint(name=f"lift_{group}", type=mujoco.mjtJoint.mjJNT_SLIDE, axis=(0, 0, 1))
        _add_motor(spec, f"lift_{group}")
        bodies.append(body)
    bodies = bodies * shape.n_m if support.is_rigid else bodies
    for particle, (x, y) in enumerate(shape.particles):
        bodies[shape.mass_group[particle]].add_geom(
            name=f"cell_{particle}",
            type=mujoco.mjtGeom.mjGEOM_BOX,
            pos=(x, y, 0),
            size=(shape.cell / 2, shape.cell / 2, shape.height / 2),
            mass=guess.particle_mass[particle],
            contype=0,
            conaffinity=0,
        )
    return bodies


def _weightless(body: mujoco.MjsBody) -> mujoco.MjsBody:
    """A body of no mass that counts, for joints to be on."""
    body.explicitinertial, body.mass, body.inertia = True, 1e-9, (1e-12,) * 3
    return body


def _add_motor(spec: mujoco.MjSpec, joint: str, gear: float = 1.0) -> None:
    motor = spec.add_actuator(name=joint, target=joint, trntype=mujoco.mjtTrn.mjTRN_JOINT)
    motor.gear[0] = gear


SETTLE = 60
"""Steps before the first part of a stretch counts: until the feet carry what a guess of the masses puts on them."""
PART = 2
"""Steps that count of each part of a stretch."""


@dataclass(frozen=True, eq=False)
class PlanarMotion:
    """K steady stretches of S equal parts. Object axes; velocities and moments of and about the grasp point.

    In a steady stretch motion and wrench are constant in the object frame, so that a few steps of each of its parts say
    what all of it would.
    """

    twists: Float[np.ndarray, "K S 3"]
    """Velocity, m/s, and turn rate, rad/s, in each part; of an accelerated stretch at one rate, that of its middle."""
    spin_up: Float[np.ndarray, "K"]
    """Angular acceleration, rad/s^2; speeds go with the turn rate."""
    moment: Float[np.ndarray, "K 2"]
    """Moment of the gripper that tilts the object, about x and y at the table, N m."""
    lift: Float[np.ndarray, "K"]
    """Vertical force of the gripper, N."""
    held: Int[np.ndarray, "K"]
    """Mass group that the lift pulls at."""
    grasp: Float[np.ndarray, "K 2"]
    """Grasp point, m, object frame."""

    def at_each_grasp(self) -> Iterator[tuple[Float[np.ndarray, "2"], slice]]:
        """Runs of stretches about the same point: the point, and which they are."""
        moved = np.flatnonzero(np.any(np.diff(self.grasp, axis=0) != 0, axis=1)) + 1
        for begin, end in pairwise([0, *moved.tolist(), len(self.grasp)]):
            yield self.grasp[begin], slice(begin, end)

    @property
    def counted(self) -> Bool[np.ndarray, "T"]:
        """Which steps count: not those in which the velocity is set to the next part's, nor those after."""
        part = np.r_[[False, False], np.ones(PART, dtype=bool)]
        return np.concatenate([np.zeros(SETTLE, dtype=bool), np.tile(part, self.twists.shape[1])])

    def velocity(self, step: int) -> Float[np.ndarray, "K 3"]:
        """Before a step, object axes."""
        part = max(step - SETTLE - 1, 0) // (PART + 2)
        twist = self.twists[:, min(part, self.twists.shape[1] - 1)]
        since = TIMESTEP * (step - len(self.counted) / 2)
        gained = np.divide(self.spin_up * since, twist[:, 2], out=np.zeros(len(twist)), where=self.spin_up != 0)
        return twist * (1 + gained)[:, None]

    def drive(self) -> Float[np.ndarray, "K T 3"]:
        """Acceleration of the drive at every step, world axes."""
        velocity, yaw = self.velocity(0), np.zeros(len(self.twists))
        given = np.empty((len(yaw), len(self.counted), 3))
        for step in range(given.shape[1]):
            wanted = self.velocity(step + 1)
            yaw = yaw + TIMESTEP * wanted[:, 2]
            wanted[:, :2] = np.einsum("kij,kj->ki", rotation_2d(yaw), wanted[:, :2])
            given[:, step] = (wanted - velocity) / TIMESTEP
            velocity = wanted
        return given

    def controls(self, lifts: int) -> Float[np.ndarray, "K T 5+lifts"]:
        """What the scene's motors are told: the drive, the tilt, and a lift for each of `lifts` slides."""
        drive = self.drive()
        held = np.arange(lifts) == np.minimum(self.held, lifts - 1)[:, None]
        still = np.concatenate([self.moment, held * self.lift[:, None]], axis=1)
        return np.concatenate([drive, np.broadcast_to(still[:, None], (*drive.shape[:2], still.shape[1]))], axis=2)


LEAST = 0.05
"""Least mass of a group, as a part of an even share: the feet of a lighter one would shake at the scene's step."""
MOST = 20.0
"""Most, where M is not known."""
FRICTIONS = (0.01, 2.0)
"""Bounds of friction: the toolbox asks for some."""
PLANAR = [0, 1, 5]
"""f_x, f_y and the torque about the vertical, of the sensors' six components."""


@dataclass(frozen=True, eq=False)
class Measured:
    """What the toolbox fits."""

    motion: PlanarMotion
    wrench: Float[np.ndarray, "K 3"]
    """f_x, f_y of the gripper on the object and torque about the grasp point, object axes, N and N m."""
    whiten: Float[np.ndarray, "3K 3K"]
    """Takes errors of them to unit variance."""
    weight: float | None
    """M as weighed, kg."""
    weight_error: float
    """Of the weighing, kg."""


@dataclass(frozen=True, eq=False)
class Identified:
    """What the toolbox found: I iterations."""

    group_mass: Float[np.ndarray, "n_m"]
    """kg."""
    friction: Float[np.ndarray, "n_mu"]
    covariance: Float[np.ndarray, "n_m n_m"]
    """Of the groups' masses, kg^2; infinite where its interval is."""
    masses: Float[np.ndarray, "I n_m"]
    """Of the groups, at each iteration, kg."""
    losses: Float[np.ndarray, "I"]
    """Mean squared error over its variance, at each."""
    seconds: Float[np.ndarray, "I"]
    """Wall time up to each, s."""
    guesses: int
    """Masses and frictions that were simulated, each over all stretches."""


def identify(guess: ObjectModel, support: Support, measured: Measured, max_iters: int) -> Identified:
    """Fit masses and frictions by the toolbox's default optimiser.

    Args:
        guess: shape, and the masses and frictions to start from.
        support: who carries the weight in the scene.
        measured: what to fit.
        max_iters: of the optimiser.

    Raises:
        InvalidValueError: the toolbox's own dependencies are not installed.
    """
    if not hasattr(sysid, "SystemTrajectory"):  # `import mujoco.sysid` leaves out what it cannot import, in silence
        raise InvalidValueError("mujoco_sysid", "MuJoCo without what its toolbox needs", "pip install 'heft[sysid]'")
    fit = _Fit(guess, support, measured)
    begin, logged = time.perf_counter(), []
    found, result = sysid.optimize(
        fit.parameters(),
        fit.residuals,
        verbose=False,
        max_iters=max_iters,
        output=io.StringIO(),
        iter_callback=lambda trace: logged.append((trace[-1], time.perf_counter() - begin)),
    )
    guesses = fit.guesses
    covariance, intervals = sysid.calculate_intervals(fit.residuals(result.x, found)[0], result.jac)
    n_m = guess.shape.n_m
    covariance = np.where(np.isinf(intervals[:, None] + intervals), np.inf, covariance)[:n_m, :n_m]
    return Identified(
        result.x[:n_m],
        result.x[n_m:],
        covariance,
        np.array([log.candidate[:n_m, 0] for log, _ in logged]),
        np.array([2 * fit.scale**2 * log.objective / len(result.jac) for log, _ in logged]),
        np.array([at for _, at in logged]),
        guesses,
    )


class _Fit:
    """The toolbox's residual over all stretches, and the weighing's."""

    def __init__(self, guess: ObjectModel, support: Support, measured: Measured):
        self.guesses, self.scale = 0, 0.0
        self._guess, self._measured = guess, measured
        self._models: dict[tuple[int, bytes], mujoco.MjModel] = {}
        self._counted = measured.motion.counted
        self._stretches = sysid.build_residual_fn(
            models_sequences=_sequences(guess, support, measured),
            build_model=self._build,
            modify_residual=self._missing,
            resample_true=False,
            n_threads=1,  # heft asks as many methods at once as there are cores
        )

    def parameters(self) -> sysid.ParameterDict:
        """Each group's mass, kg, then each friction, from those that are guessed."""
        guess, found = self._guess, sysid.ParameterDict()
        least = LEAST * guess.total_mass / guess.shape.n_m
        most = guess.total_mass * (MOST if self._measured.weight is None else 1)
        for group, mass in enumerate(guess.group_mass):
            inside = np.flatnonzero(guess.shape.mass_group == group)
            cells = {f"cell_{i}": guess.shape.fill[i] / len(inside) for i in inside}
            found.add(sysid.Parameter(f"mass_{group}", mass, least, most, modifier=_masses(cells)))
        for group, friction in enumerate(guess.truth.friction):
            feet = [f"foot_{i}" for i in np.flatnonzero(guess.shape.friction_group == group)]
            found.add(sysid.Parameter(f"friction_{group}", friction, *FRICTIONS, modifier=_frictions(feet)))
        return found

    def residuals(self, x: np.ndarray, params: sysid.ParameterDict) -> tuple[list[np.ndarray], object, object]:
        """Of guesses, one a column of `x` (n,) or (n, G), as the toolbox wants them: of wrenches, and of M.

        Over the first guess's norm, for the toolbox stops where a residual of about 1 has come down to nothing.
        """
        self.guesses += x.shape[1] if x.ndim == 2 else 1
        self._models.clear()
        gc.collect()  # guesses before left models in cycles, gigabytes of which Python knows only the handles
        missing, predicted, felt = self._stretches(x, params)
        parts = [self._measured.whiten @ np.concatenate(missing)]
        if self._measured.weight is not None:
            over = (x[: self._guess.shape.n_m].sum(axis=0) - self._measured.weight) / self._measured.weight_error
            parts.append(over[None])
        whole = np.concatenate(parts)
        self.scale = self.scale or float(np.linalg.norm(whole))
        return [whole / self.scale], predicted, felt

    def _build(self, params: sysid.ParameterDict, spec: mujoco.MjSpec) -> mujoco.MjModel:
        """The model of a guess at one grasp; its stretches share it."""
        key = id(spec), params.as_vector().tobytes()
        if key not in self._models:
            self._models[key] = compiled(sysid.apply_param_modifiers_spec(params, spec), self._guess)
        return self._models[key]

    def _missing(self, params, predicted, felt, model, return_pred_all, **kwargs):
        """The toolbox's hook: what one stretch was felt to take, less the mean over its steps that count, (1, 3)."""
        steps = predicted.data[self._counted][:, PLANAR]
        missing = felt.data[:, PLANAR] - steps.mean(axis=0)
        return missing, felt, felt


def _sequences(guess: ObjectModel, support: Support, measured: Measured) -> list[sysid.ModelSequences]:
    """The stretches as the toolbox wants them, a scene a grasp: a first state, controls and what was felt."""
    motion, sunk = measured.motion, sinking(guess, support)
    begin, controls = motion.velocity(0), motion.controls(len(sunk))
    place = np.concatenate([np.zeros(5), -sunk])
    times = TIMESTEP * np.arange(controls.shape[1] + 1)
    whole = np.zeros((len(begin), 1, 6))
    whole[:, 0, PLANAR] = measured.wrench
    sensors = [(name, sysid.SignalType.MjSensor) for name in (FORCE, TORQUE)]
    found = []
    for grasp, rows in motion.at_each_grasp():
        spec = planar_scene(guess, support, grasp)
        model = compiled(spec, guess)
        speeds = [np.concatenate([twist, np.zeros(len(sunk) + 2)]) for twist in begin[rows]]
        found.append(
            sysid.ModelSequences(
                f"grasp_{len(found)}",
                spec,
                [f"stretch_{k}" for k in range(len(speeds))],
                [sysid.create_initial_state(model, place, speed) for speed in speeds],
                [sysid.TimeSeries(times, np.vstack([told, told[-1:]])) for told in controls[rows]],  # it drops the last
                [sysid.TimeSeries.from_names(np.zeros(1), felt, model, sensors) for felt in whole[rows]],
            )
        )
    return found


def _masses(cells: dict[str, float]) -> Callable[[mujoco.MjSpec, sysid.Parameter], None]:
    """Spreads a mass over cells, each its part."""

    def write(spec: mujoco.MjSpec, parameter: sysid.Parameter) -> None:
        for name, part in cells.items():
            spec.geom(name).mass = parameter.value[0] * part

    return write


def _frictions(feet: list[str]) -> Callable[[mujoco.MjSpec, sysid.Parameter], None]:
    """Gives feet a friction."""

    def write(spec: mujoco.MjSpec, parameter: sysid.Parameter) -> None:
        for name in feet:
            spec.pair(name).friction[:2] = parameter.value[0]

    return write
