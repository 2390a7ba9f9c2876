"""One trial in Rerun: bench and object in motion, the table's forces, and the wrench that was felt."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from testbed.actions.base import Lift
from testbed.foot_forces import FootForces
from testbed.frames import rotation_2d
from testbed.objects.model import MassDistribution, ObjectShape
from testbed.sensing.lift_windows import poses_in_space
from testbed.trajectory import Phase, Trajectory
from viz.figures.wrench import WrenchFit
from viz.recordings.motion import Poses, log_bench
from viz.recordings.page import SIM_TIME, facts_markdown
from viz.style import (
    AXIS_COLORS,
    EDGE,
    FRICTION_FORCE,
    MASS_COLORS,
    NORMAL_FORCE,
    OBJECT_VELOCITY,
    PHASE_COLORS,
    mapped,
    rgb,
)

FOOT_ARROW, HAND_ARROW = 0.1, 0.01
"""Length of the arrows of a foot's and of the gripper's force, m a N."""
AXES = ("x", "y", "z")
FITS_EVERY = 4
"""Where many trials are shown side by side, one sample in so many."""


@dataclass(frozen=True, eq=False)
class TrialShown:
    """A trial with all that is known about it."""

    title: str
    """What is shown: object and action."""
    shape: ObjectShape
    """Of the object."""
    trajectory: Trajectory
    """As sensed: with the wrench on the object."""
    poses: Poses
    """Of the bench's bodies, N samples."""
    pose_times: Float[np.ndarray, "N"]
    """Of the poses, s."""
    fit: WrenchFit
    """The wrench in the object's axes, and what a model says that it should be."""
    model: str = ""
    """Which masses the model has; empty without a model."""
    truth: MassDistribution | None = None
    """None on a real object."""
    feet: FootForces | None = None
    """None where nobody knows them."""
    facts: Mapping[str, str] = field(default_factory=dict)
    """What else is said in words."""


def log_trial(stream: rr.RecordingStream, root: str, shown: TrialShown) -> None:
    """Log a trial below `root`, on `sim_time`."""
    trajectory = shown.trajectory
    stream.log(f"{root}/scene", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    log_bench(stream, f"{root}/scene/bench", shown.poses, shown.pose_times)
    _log_object(stream, f"{root}/scene/object", shown)
    _log_hand(stream, f"{root}/scene/gripper_force", trajectory)
    if shown.feet is not None:
        _log_feet(stream, f"{root}/scene/object/feet", shown, shown.feet)
    _log_fit(stream, f"{root}/wrench", shown.fit)
    names = [f"{part}_{axis}" for part in ("force", "torque") for axis in AXES]
    for entity, values in (
        ("compensated", trajectory.wrench_on_object_world),
        ("raw", trajectory.sensor_wrench),
    ):
        for index, name in enumerate(names):
            path = f"{root}/{entity}/{name.replace('_', '/')}"
            _series(stream, path, name.replace("_", " "), AXIS_COLORS[index % 3], trajectory.time_s, values[:, index])
    _log_states(stream, f"{root}/states", shown)
    stream.log(f"{root}/facts", rr.TextDocument(facts_text(shown), media_type=rr.MediaType.MARKDOWN), static=True)


def trial_blueprint(root: str, shown: TrialShown) -> rrb.Container:
    """The views of what `log_trial` logs below `root`."""
    legend = rrb.PlotLegend(corner=rrb.Corner2D.RightTop)

    def plot(origin: str, name: str) -> rrb.TimeSeriesView:
        return rrb.TimeSeriesView(origin=f"{root}/{origin}", name=name, plot_legend=legend)

    x, y = shown.trajectory.tcp_position[:, :2].mean(axis=0)
    eye = rrb.EyeControls3D(position=(x + 0.3, y - 0.4, 0.36), look_target=(x - 0.02, y, 0.05), eye_up=(0, 0, 1))
    said = f"model: {shown.model}" if shown.model else "no model"
    felt = rrb.Vertical(
        plot("wrench/force", f"force on the object, its own axes, N ({said})"),
        plot("wrench/torque", f"torque about the grasp, N m ({said})"),
        name="felt",
    )
    whole = rrb.Vertical(
        plot("compensated/force", "force on the object, world axes, N"),
        plot("compensated/torque", "torque on the object about the TCP, world axes, N m"),
        name="after tare and tool",
    )
    raw = rrb.Vertical(
        plot("raw/force", "force at the sensor, its axes, N"),
        plot("raw/torque", "torque at the sensor, its axes, N m"),
        name="raw",
    )
    states = rrb.StateTimelineView(origin=f"{root}/states", name="phase, and what an estimator is given")
    scene = rrb.Spatial3DView(
        origin=f"{root}/scene",
        name=f"bench; arrows: table on a foot {100 * FOOT_ARROW:g} cm, gripper {100 * HAND_ARROW:g} cm a N",
        eye_controls=eye,
        background=rrb.Background(kind=rrb.BackgroundKind.SolidColor, color=(238, 240, 243)),
        line_grid=False,
    )
    facts = rrb.TextDocumentView(origin=f"{root}/facts", name="facts")
    return rrb.Horizontal(
        rrb.Vertical(scene, rrb.Horizontal(facts, states, column_shares=[2, 3]), row_shares=[5, 2]),
        rrb.Tabs(felt, whole, raw, active_tab=0),
        column_shares=[11, 9],
        name=shown.title,
    )


def facts_text(shown: TrialShown) -> str:
    """Title and facts as Markdown."""
    trajectory = shown.trajectory
    return facts_markdown(shown.title, "trial", {"status": trajectory.status, "why": trajectory.reason, **shown.facts})


def _log_object(stream: rr.RecordingStream, entity: str, shown: TrialShown) -> None:
    """Its cells by mass, where known, and its pose."""
    shape = shown.shape
    half = np.array([shape.cell / 2, shape.cell / 2, shape.height / 2])
    centres = np.column_stack([shape.particles, np.full(len(shape.particles), shape.height / 2)])
    if shown.truth is None:
        colors = np.tile(rgb("#D7A866"), (len(centres), 1))
    else:
        each = shown.truth.mass[shape.mass_group]
        colors = mapped(each, max(float(each.max()), 1e-9), MASS_COLORS)
    boxes = rr.Boxes3D(centers=centres, half_sizes=half, colors=colors, fill_mode="transparentfillmajorwireframe")
    stream.log(f"{entity}/cells", boxes, static=True)
    stream.send_columns(
        entity,
        [rr.TimeColumn(SIM_TIME, duration=shown.trajectory.time_s)],
        rr.Transform3D.columns(**_poses(shown.trajectory)),
    )


def _poses(trajectory: Trajectory) -> dict[str, Any]:
    """Of the object: over the table, or in space where it is lifted and was gripped."""
    if isinstance(trajectory.action, Lift) and trajectory.mask(Phase.SETTLE).any():
        place, axes = poses_in_space(trajectory)
        return {"translation": place, "quaternion": Rotation.from_matrix(axes).as_quat()}
    pose = trajectory.object_pose
    return {
        "translation": np.column_stack([pose[:, :2], np.zeros(len(pose))]),
        "rotation_axis_angle": [rr.RotationAxisAngle((0, 0, 1), radians=float(yaw)) for yaw in pose[:, 2]],
    }


def _log_hand(stream: rr.RecordingStream, entity: str, trajectory: Trajectory) -> None:
    """What the gripper does to the object, at the TCP."""
    stream.log(entity, rr.Arrows3D.from_fields(colors=rgb(OBJECT_VELOCITY), radii=0.003), static=True)
    columns = rr.Arrows3D.columns(
        origins=trajectory.tcp_position, vectors=HAND_ARROW * trajectory.wrench_on_object_world[:, :3]
    )
    stream.send_columns(entity, [rr.TimeColumn(SIM_TIME, duration=trajectory.time_s)], columns)


def _log_feet(stream: rr.RecordingStream, entity: str, shown: TrialShown, feet: FootForces) -> None:
    """Normal load and friction under every foot, in the object's axes: arrows move and turn with it."""
    count = len(feet.particle)
    yaw = np.interp(feet.time_s, shown.trajectory.time_s, shown.trajectory.object_pose[:, 2])
    inward = np.einsum("nij,nfj->nfi", rotation_2d(-yaw), feet.force[..., :2])
    zeros = np.zeros((*inward.shape[:2], 1))
    origins = np.column_stack([shown.shape.particles[feet.particle], np.full(count, 1e-3)])
    index = [rr.TimeColumn(SIM_TIME, duration=feet.time_s)]
    for name, color, vectors in (
        ("normal", NORMAL_FORCE, np.concatenate([0 * inward, feet.force[..., 2:]], axis=-1)),
        ("friction", FRICTION_FORCE, np.concatenate([inward, zeros], axis=-1)),
    ):
        fields = rr.Arrows3D.from_fields(origins=origins, colors=rgb(color), radii=0.0012)
        stream.log(f"{entity}/{name}", fields, static=True)
        flat = (FOOT_ARROW * vectors).reshape(-1, 3).astype(np.float32)
        columns = rr.Arrows3D.columns(vectors=flat).partition([count] * len(feet.time_s))
        stream.send_columns(f"{entity}/{name}", index, columns)


def log_fits(stream: rr.RecordingStream, root: str, fits: Sequence[WrenchFit]) -> None:
    """Log what was felt in each of several trials, and what a model says of it."""
    for index, fit in enumerate(fits):
        _log_fit(stream, f"{root}/{index}", fit, FITS_EVERY)


def fits_blueprint(root: str, fits: Sequence[WrenchFit]) -> rrb.Container:
    """The views of what `log_fits` logs: force above torque, a column a trial."""
    hidden = rrb.PlotLegend(visible=False)
    columns = [
        rrb.Vertical(
            rrb.TimeSeriesView(origin=f"{root}/{i}/force", name=f"{fit.label}: force, N", plot_legend=hidden),
            rrb.TimeSeriesView(origin=f"{root}/{i}/torque", name="torque, N m", plot_legend=hidden),
        )
        for i, fit in enumerate(fits)
    ]
    return rrb.Grid(*columns, grid_columns=min(len(columns), 4) or 1, name="what was felt, and the model")


def _log_fit(stream: rr.RecordingStream, root: str, fit: WrenchFit, every: int = 1) -> None:
    """Measured, predicted, and the band around the prediction; one sample in so many."""
    time_s, measures, predictions, bands = (a[::every] for a in (fit.time_s, fit.measured, fit.predicted, fit.band))
    for index, (entity, name) in enumerate((("force/x", "x"), ("force/y", "y"), ("torque/z", "z"))):
        color = AXIS_COLORS[index]
        _series(stream, f"{root}/{entity}/measured", f"{name}, measured", color, time_s, measures[:, index])
        known = ~np.isnan(predictions[:, index])
        if not known.any():
            continue
        predicted, band = predictions[:, index], bands[:, index]
        _series(stream, f"{root}/{entity}/model", f"{name}, model", EDGE, time_s, predicted, 2.5)
        for side, sign in (("upper", 1), ("lower", -1)):  # of one name: the legend has them once
            values = np.where(known, predicted + sign * band, np.nan)
            _series(stream, f"{root}/{entity}/{side}", f"{name}, 95 %", "#A0A0A0", time_s, values, 1.0)


def _series(
    stream: rr.RecordingStream, entity: str, name: str, color: str, time_s: np.ndarray, values: np.ndarray, width=1.2
) -> None:
    """A line over time; NaN leaves a gap."""
    stream.log(entity, rr.SeriesLines(colors=rgb(color), names=name, widths=width), static=True)
    stream.send_columns(entity, [rr.TimeColumn(SIM_TIME, duration=time_s)], rr.Scalars.columns(scalars=values))


def _log_states(stream: rr.RecordingStream, root: str, shown: TrialShown) -> None:
    """Lanes: the phase, and whether an estimator is given the samples."""
    trajectory = shown.trajectory
    given = np.where(shown.fit.steady, "steady window", "")
    names = np.array([phase.name.lower() for phase in Phase])[trajectory.phase]
    colors = {phase.name.lower(): color for phase, color in zip(Phase, PHASE_COLORS, strict=True)}
    for lane, states, known in (("phase", names, colors), ("window", given, {"steady window": AXIS_COLORS[2]})):
        stream.log(
            f"{root}/{lane}",
            rr.StateConfiguration(values=list(known), labels=list(known), colors=[rgb(c) for c in known.values()]),
            static=True,
        )
        change = np.flatnonzero(np.append(True, states[1:] != states[:-1]))
        stream.send_columns(
            f"{root}/{lane}",
            [rr.TimeColumn(SIM_TIME, duration=trajectory.time_s[change])],
            rr.StateChange.columns(state=states[change].tolist()),
        )
