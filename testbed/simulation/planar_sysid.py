"""MuJoCo's own system identification (`mujoco.sysid`) of an object's masses and frictions, on a planar scene."""

from __future__ import annotations

import gc
import io
import time
from collections.abc import Callable
from dataclasses import dataclass

import mujoco
import numpy as np
from jaxtyping import Float
from mujoco import sysid

from testbed.errors import InvalidValueError
from testbed.objects import ObjectModel
from testbed.simulation.planar_motion import PlanarMotion
from testbed.simulation.planar_scene import FORCE, TIMESTEP, TORQUE, compiled, planar_scene, sinking
from testbed.trial import Support

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
