"""Views of a trial: what the viewer and the figures draw of one."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from estimators.particles.wrench import predicted_wrenches
from scenarios.results.store import Store, read_json
from scenarios.results.trials import TrialRecord, read_trial, sensed_trials
from testbed.errors import InvalidValueError
from testbed.foot_forces import load_foot_forces
from testbed.objects.model import MassDistribution, ObjectShape
from testbed.sensing.windows import sample_deviation, steady_samples, wrench_in_object
from testbed.trajectory import Trajectory
from viz.values import TrialView, WrenchFit, support_name

POSES_EVERY = 5
"""Number of samples from one pose of the robot to the next."""
WITHIN = 1.96
"""Standard deviations to each side that hold 95 %."""
PLANAR = (0, 1, 5)
"""Force x, y and torque z of a wrench."""


def sensing_of(folder: Path) -> str:
    """Sensor of a folder's simulated trials in the viewer: the scenario's first one with errors, else a perfect one."""
    names = ((read_json(folder / "manifest.json") or {}).get("scenario") or {}).get("sensing") or []
    return next((name for name in names if name != "ideal"), "ideal")


def trial_view(folder: Path, key: str, *, seed: int = 0, meshes: bool = True) -> TrialView:
    """A trial by its key; a simulated one is given a draw of the sensor's errors, and the true masses as a model.

    Args:
        folder: results folder.
        key: whole, or a beginning that no other has.
        seed: of the draw.
        meshes: dress the arm in its own meshes where the extra "meshes" is installed.

    Raises:
        InvalidValueError: a weighing, where nothing moves.
        HeftError: a file of it is damaged.
    """
    record = read_trial(folder, key)
    trajectory, sensor = record.trajectory, "as measured"
    if trajectory.simulated:
        sensing = sensing_of(folder)
        trajectory = sensed_trials(Store(folder), (record.folder.name,), sensing, seed)[0]
        sensor = f"{sensing}, draw {seed}"
    model = record.object.truth if trajectory.simulated else None
    called = "the true masses, each on its own weight"
    return view_of(record, trajectory, record.object.shape, model, called, {"sensing": sensor}, meshes=meshes)


def view_of(
    record: TrialRecord,
    trajectory: Trajectory,
    shape: ObjectShape,
    model: MassDistribution | None,
    called: str,
    facts: dict[str, str],
    *,
    meshes: bool = True,
) -> TrialView:
    """A trial with what a model says of it.

    Args:
        record: the trial as it lies in the folder.
        trajectory: as sensed.
        shape: the model's particles.
        model: masses and friction that the wrench is predicted from; None without.
        called: which masses those are.
        facts: further facts by name.
        meshes: as `trial_view`.
    """
    from testbed.simulation.rendering import body_poses  # noqa: PLC0415  graphics are chosen before MuJoCo loads

    action = trajectory.action
    if not action.moves:
        raise InvalidValueError(
            "TRIAL", f"{record.folder.name[:8]}, a weighing", "a slide or a turn: nothing else moves"
        )
    feet = record.folder / "foot_forces.parquet"
    predicted = None if model is None else predicted_wrenches(shape, model, [trajectory])[0]
    name = trajectory.action.describe(record.object.shape)
    return TrialView(
        title=f"{record.object.name}: {name}",
        shape=record.object.shape,
        trajectory=trajectory,
        poses=body_poses(trajectory, record.grip_width, meshes=meshes, every=POSES_EVERY),
        pose_times=trajectory.time_s[::POSES_EVERY],
        fit=wrench_fit(name, trajectory, predicted),
        model=called if model is not None else "",
        truth=record.object.truth if trajectory.simulated else None,
        feet=load_foot_forces(feet) if feet.is_file() else None,
        facts={
            "object": record.object.name,
            "action": name,
            "support": support_name(record.support) if trajectory.simulated else "",
            "trial": record.folder.name,
            "runner": trajectory.provenance.get("runner", ""),
            "arm": "" if trajectory.joint_position.any() else "not where it was: its joints were not logged",
            "feet": "" if feet.is_file() else "forces not known: no foot_forces.parquet beside this trial",
        }
        | facts,
    )


def wrench_fit(label: str, trajectory: Trajectory, predicted: np.ndarray | None) -> WrenchFit:
    """Measured against predicted (T, 3), in the object's axes."""
    steady = np.zeros(len(trajectory.time_s), dtype=bool)
    try:
        for kept in steady_samples(trajectory):
            steady[kept] = True
    except InvalidValueError:  # cut short before it was steady: it is still worth seeing
        pass
    measured = wrench_in_object(trajectory)[:, PLANAR]
    deviation = sample_deviation(trajectory)[list(PLANAR)]
    return WrenchFit(
        label,
        trajectory.time_s,
        measured,
        steady,
        np.full_like(measured, np.nan) if predicted is None else predicted,
        np.broadcast_to(WITHIN * deviation, measured.shape),
    )
