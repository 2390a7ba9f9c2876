"""One trial in Rerun: motion of robot and object, forces of the table, and the wrench, measured and predicted."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from jaxtyping import Bool, Float
from rerun_loader_mjcf import MJCFLogger
from scipy.spatial.transform import Rotation

from testbed.foot_forces import FootForces
from testbed.frames import rotation_2d
from testbed.objects.colors import group_color
from testbed.objects.model import ObjectShape
from testbed.sensing.lift_windows import poses_in_space
from testbed.trajectory import Phase, Trajectory
from viz import style
from viz.recordings.mass_map import Raster
from viz.recordings.page import Node, log_facts
from viz.trials import push_contacts
from viz.values import ActionArrow, TrialView, WrenchFit

FOOT_ARROW, HAND_ARROW = 0.1, 0.01
"""Scales of the arrows of a foot's and of the gripper's force [m/N]."""
MARK = 0.003
"""Radius of a marked point of the object [m]."""
FITS_EVERY = 4
"""Stride of the samples of trials that are drawn side by side."""
WRENCH = [f"{part}/{axis}" for part in ("force", "torque") for axis in "xyz"]


def log_trial(stream: rr.RecordingStream, root: str, view: TrialView) -> None:
    """Log a trial below `root`, on `sim_time`."""
    trajectory, node = view.trajectory, Node(stream, root)
    (node / "scene").log(rr.ViewCoordinates.RIGHT_HAND_Z_UP)
    _log_robot(node / "scene/bench", view)
    _log_object(node / "scene/object", view)
    force = HAND_ARROW * trajectory.wrench_on_object_world[:, :3]
    hand = node / "scene/gripper_force"
    hand.log(rr.Arrows3D.from_fields(colors=style.rgb(style.OBJECT_VELOCITY), radii=0.003))
    place = np.array(trajectory.tcp_position)
    if (fingertip := trajectory.action.fingertip(view.shape)) is not None:
        place[:, 2] += fingertip.height - np.median(place[trajectory.segment >= 0, 2])
        tip = node / "scene/fingertip"
        tip.log(rr.Points3D.from_fields(colors=style.rgb(style.OBJECT_VELOCITY), radii=fingertip.radius))
        tip.send_timed(trajectory.time_s, rr.Points3D.columns(positions=place))
        _log_push(node / "scene/object", view.shape, trajectory, fingertip.height)
    hand.send_timed(trajectory.time_s, rr.Arrows3D.columns(origins=place, vectors=force))
    if view.feet is not None:
        _log_feet(node / "scene/object/feet", view, view.feet)
    _log_fit(node / "wrench", view.fit)
    for kind, values in (("compensated", trajectory.wrench_on_object_world), ("raw", trajectory.sensor_wrench)):
        for index, name in enumerate(WRENCH):
            color, label = style.AXIS_COLORS[index % 3], name.replace("/", " ")
            _log_line(node / kind / name, label, color, trajectory.time_s, values[:, index])
    if view.shape.chain is not None and trajectory.camera is not None:
        for hinge, angle in enumerate(np.degrees(trajectory.camera.joint_angles).T):
            color, line = style.series_color(hinge), node / f"joints/hinge_{hinge}"
            _log_line(line, f"hinge {hinge}", color, trajectory.camera.time_s, angle)
    _log_states(node / "states", view)
    facts = {"status": trajectory.status, "why": trajectory.reason, **view.facts}
    log_facts(node / "facts", view.title, "trial", facts)


def trial_blueprint(root: str, view: TrialView) -> rrb.Container:
    """Views of the entities that `log_trial` logs below `root`."""
    legend = rrb.PlotLegend(corner=rrb.Corner2D.RightTop)

    def plots(origin: str, force: str, torque: str, name: str) -> rrb.Container:
        titles = {"force": force, "torque": torque}
        lines = [
            rrb.TimeSeriesView(origin=f"{root}/{origin}/{part}", name=title, plot_legend=legend)
            for part, title in titles.items()
        ]
        return rrb.Vertical(*lines, name=name)

    x, y = view.trajectory.tcp_position[:, :2].mean(axis=0)
    eye = rrb.EyeControls3D(position=(x + 0.3, y - 0.4, 0.36), look_target=(x - 0.02, y, 0.05), eye_up=(0, 0, 1))
    model = f"model: {view.model}" if view.model else "no model"
    pushed = view.trajectory.action.pushes
    hinged = view.shape.chain is not None and view.trajectory.camera is not None
    held = "fingertip" if pushed else "grasp"
    force, torque = f"force on the object, its own axes, N ({model})", f"torque about the {held}, N m ({model})"
    wrench = plots("wrench", force, torque, "measured")
    if hinged:
        angles = rrb.TimeSeriesView(origin=f"{root}/joints", name="joint angle of each hinge, deg", plot_legend=legend)
        wrench = rrb.Vertical(*wrench.contents, angles, name="measured")
    force, torque = "force on the object, world axes, N", "torque on the object about the TCP, world axes, N m"
    whole = plots("compensated", force, torque, "after tare and tool")
    raw = plots("raw", "force at the sensor, its axes, N", "torque at the sensor, its axes, N m", "raw")
    states = rrb.StateTimelineView(origin=f"{root}/states", name="phase, and samples for the estimator")
    more = "; orange: push and path of its contact" * pushed + "; outlines: links; dots: hinges" * hinged
    scene = rrb.Spatial3DView(
        origin=f"{root}/scene",
        name=f"scene; arrows: table on a foot {100 * FOOT_ARROW:g} cm, gripper {100 * HAND_ARROW:g} cm a N{more}",
        eye_controls=eye,
        background=rrb.Background(kind=rrb.BackgroundKind.SolidColor, color=(238, 240, 243)),
        line_grid=False,
    )
    facts = rrb.TextDocumentView(origin=f"{root}/facts", name="facts")
    return rrb.Horizontal(
        rrb.Vertical(scene, rrb.Horizontal(facts, states, column_shares=[2, 3]), row_shares=[5, 2]),
        rrb.Tabs(wrench, whole, raw, active_tab=0),
        column_shares=[11, 9],
        name=view.title,
    )


class _Shapes(MJCFLogger):
    """Logger of the bodies' geometry without their poses at rest."""

    def log_data(self, data: Any, recording: rr.RecordingStream | None = None) -> None:
        """Log nothing: the poses are those of the trial."""


def _log_robot(node: Node, view: TrialView) -> None:
    """Log the bodies' geometry, and their poses on `sim_time`; the pose of a body at rest is static."""
    poses, shapes = view.poses, _Shapes(view.poses.model, node.path)
    shapes.log_model(node.stream)
    for body in range(poses.model.nbody):
        link = Node(node.stream, shapes.paths.body_path(poses.model.body(body).name))
        place, turn = poses.position[:, body], np.roll(poses.orientation[:, body], -1, axis=1)  # to xyzw
        if np.ptp(place, axis=0).max() + np.ptp(turn, axis=0).max() < 1e-9:
            link.log(rr.Transform3D(translation=place[0], quaternion=turn[0]))
        else:
            moving = rr.Transform3D.columns(translation=place, quaternion=turn)
            link.send_timed(view.pose_times, moving)


def _log_object(node: Node, view: TrialView) -> None:
    """Log the object's cells in the colors of their groups, labeled with known true masses, and the object's pose."""
    shape, truth = view.shape, view.truth
    half = np.array([shape.cell / 2, shape.cell / 2, shape.height / 2])
    centers = np.column_stack([shape.particles, np.full(len(shape.particles), shape.height / 2)])
    names = list(shape.group_names)
    if truth is not None:
        masses = truth.group_mass(shape)
        names = [f"{name}: {mass:.3f} kg" for name, mass in zip(names, masses, strict=True)]
    if shape.chain is not None:
        names = [f"link {link}, {name}" for link, name in zip(shape.chain.link, names, strict=True)]

    def cells(kept: Bool[np.ndarray, "P"]) -> rr.Boxes3D:
        kept = kept & ~shape.is_contact
        groups = shape.mass_group[kept]
        return rr.Boxes3D(
            centers=centers[kept],
            half_sizes=half,
            colors=[style.rgb(group_color(group)) for group in groups],
            labels=[names[group] for group in groups],
            show_labels=False,  # the viewer shows them on hover
            fill_mode="transparentfillmajorwireframe",
        )

    time, camera = view.trajectory.time_s, view.trajectory.camera
    if shape.chain is not None and camera is not None:
        raster, of = Raster.of(shape), shape.chain.link[shape.mass_group]
        for link, pose in enumerate(camera.at(time).transpose(1, 0, 2)):
            body, color = node / f"link_{link}", style.rgb(style.series_color(link))
            (body / "cells").log(cells(of == link))
            edges = [np.insert(edge, 2, shape.height, axis=1) for edge in raster.link(shape.chain, link).outlines()]
            (body / "outline").log(rr.LineStrips3D(edges, colors=color, radii=MARK / 2))
            if link:
                top = [*shape.chain.hinges[link - 1], shape.height]
                black = style.rgb(style.BLACK)
                (body / "hinge").log(
                    rr.Points3D([top], colors=black, radii=1.5 * MARK, labels=[f"hinge {link - 1}"], show_labels=False)
                )
            body.send_timed(time, rr.Transform3D.columns(**_on_table(pose)))
        return
    (node / "cells").log(cells(np.ones(len(centers), dtype=bool)))
    node.send_timed(time, rr.Transform3D.columns(**_object_poses(view.trajectory)))


def _log_push(node: Node, shape: ObjectShape, trajectory: Trajectory, height: float) -> None:
    """Log the arrow of a push up to its first contact, and the path of its contact point, object frame."""
    arrow = ActionArrow.of(shape, trajectory.action)
    approach, path = (np.insert(p, 2, height, axis=1) for p in (arrow.way, push_contacts(shape, trajectory)))
    color = style.rgb(style.PUSH)
    vector = approach[-1:] - approach[:1]
    (node / "push").log(rr.Arrows3D(origins=approach[:1], vectors=vector, colors=color, radii=0.0015))
    (node / "contact").log(rr.Points3D(approach[-1:], colors=color, radii=MARK))
    if len(path):
        (node / "contact_path").log(rr.LineStrips3D([path], colors=color, radii=MARK / 2))


def _object_poses(trajectory: Trajectory) -> dict[str, Any]:
    """Poses of the object: planar, or in space for a lift with a grip."""
    if trajectory.action.in_air and trajectory.mask(Phase.SETTLE).any():
        place, axes = poses_in_space(trajectory)
        return {"translation": place, "quaternion": Rotation.from_matrix(axes).as_quat()}
    return _on_table(trajectory.object_pose)


def _on_table(pose: Float[np.ndarray, "T 3"]) -> dict[str, Any]:
    return {
        "translation": np.column_stack([pose[:, :2], np.zeros(len(pose))]),
        "rotation_axis_angle": [rr.RotationAxisAngle((0, 0, 1), radians=float(yaw)) for yaw in pose[:, 2]],
    }


def _log_feet(node: Node, view: TrialView, feet: FootForces) -> None:
    """Log normal force and friction under every foot, object axes, so that the arrows move with the object."""
    count = len(feet.particle)
    yaw = np.interp(feet.time_s, view.trajectory.time_s, view.trajectory.object_pose[:, 2])
    inward = np.einsum("nij,nfj->nfi", rotation_2d(-yaw), feet.force[..., :2])
    zeros = np.zeros((*inward.shape[:2], 1))
    origins = np.column_stack([view.shape.particles[feet.particle], np.full(count, 1e-3)])
    for name, color, vectors in (
        ("normal", style.NORMAL_FORCE, np.concatenate([0 * inward, feet.force[..., 2:]], axis=-1)),
        ("friction", style.FRICTION_FORCE, np.concatenate([inward, zeros], axis=-1)),
    ):
        (node / name).log(rr.Arrows3D.from_fields(origins=origins, colors=style.rgb(color), radii=0.0012))
        flat = (FOOT_ARROW * vectors).reshape(-1, 3).astype(np.float32)
        columns = rr.Arrows3D.columns(vectors=flat).partition([count] * len(feet.time_s))
        (node / name).send_timed(feet.time_s, columns)


def log_fits(stream: rr.RecordingStream, root: str, fits: Sequence[WrenchFit]) -> None:
    """Log the wrench of several trials, measured and predicted."""
    for index, fit in enumerate(fits):
        _log_fit(Node(stream, root) / index, fit, FITS_EVERY)


def fits_blueprint(root: str, fits: Sequence[WrenchFit]) -> rrb.Container:
    """Views of the entities that `log_fits` logs: force above torque, a column per trial."""
    hidden = rrb.PlotLegend(visible=False)
    columns = [
        rrb.Vertical(
            rrb.TimeSeriesView(origin=f"{root}/{i}/force", name=f"{fit.label}: force, N", plot_legend=hidden),
            rrb.TimeSeriesView(origin=f"{root}/{i}/torque", name="torque, N m", plot_legend=hidden),
        )
        for i, fit in enumerate(fits)
    ]
    return rrb.Grid(*columns, grid_columns=min(len(columns), 4) or 1, name="measured wrench, and the model")


def _log_fit(node: Node, fit: WrenchFit, every: int = 1) -> None:
    """Log measured and predicted wrench, and the band around the prediction, at every `every`-th sample."""
    time_s, measures, predictions, bands = (a[::every] for a in (fit.time_s, fit.measured, fit.predicted, fit.band))
    for index, entity in enumerate(("force/x", "force/y", "torque/z")):
        color, name = style.AXIS_COLORS[index], entity[-1]
        _log_line(node / entity / "measured", f"{name}, measured", color, time_s, measures[:, index])
        predicted, band = predictions[:, index], bands[:, index]
        if np.isnan(predicted).all():
            continue
        _log_line(node / entity / "model", f"{name}, model", style.EDGE, time_s, predicted, 2.5)
        for side, sign in (("upper", 1), ("lower", -1)):  # one name, so that the legend has one entry
            values = predicted + sign * band
            _log_line(node / entity / side, f"{name}, 95 %", "#A0A0A0", time_s, values, 1.0)


def _log_line(node: Node, name: str, color: str, time_s: np.ndarray, values: np.ndarray, width=1.2) -> None:
    """Log a line over time; NaN leaves a gap."""
    node.log(rr.SeriesLines(colors=style.rgb(color), names=name, widths=width))
    node.send_timed(time_s, rr.Scalars.columns(scalars=values))


def _log_states(node: Node, view: TrialView) -> None:
    """Log two lanes of states: the phase, and the steady window, whose samples estimators use."""
    trajectory = view.trajectory
    steady = np.where(view.fit.steady, "steady window", "")
    names = np.array([phase.name.lower() for phase in Phase])[trajectory.phase]
    colors = {phase.name.lower(): color for phase, color in zip(Phase, style.PHASE_COLORS, strict=True)}
    for lane, states, known in (("phase", names, colors), ("window", steady, {"steady window": style.AXIS_COLORS[2]})):
        look = [style.rgb(color) for color in known.values()]
        (node / lane).log(rr.StateConfiguration(values=list(known), labels=list(known), colors=look))
        change = np.flatnonzero(np.append(True, states[1:] != states[:-1]))
        (node / lane).send_timed(trajectory.time_s[change], rr.StateChange.columns(state=states[change].tolist()))


class SensorStream:
    """Stream of a sensor's samples to the viewer at `url`, as a recording named `title`."""

    def __init__(self, url: str, title: str):
        views = [rrb.TimeSeriesView(origin=k, name=f"{k}, {unit}") for k, unit in (("force", "N"), ("torque", "N m"))]
        self._stream = rr.RecordingStream("heft sensor")
        self._stream.connect_grpc(url, default_blueprint=rrb.Blueprint(rrb.Vertical(*views), collapse_panels=True))
        self._stream.send_recording_name(title)
        self._begin: float | None = None
        for path, color in zip(WRENCH, 2 * style.AXIS_COLORS, strict=True):
            look = rr.SeriesLines(colors=style.rgb(color), names=path[-1])
            self._stream.log(path, look, static=True, strict=True)

    def send(self, times: Sequence[float], wrenches: np.ndarray) -> None:
        """Send samples: times [s], (T,), and wrenches [N, N m], (T, 6)."""
        if not len(times):
            return
        self._begin = times[0] if self._begin is None else self._begin
        column = rr.TimeColumn("time", duration=np.asarray(times) - self._begin)
        for path, values in zip(WRENCH, wrenches.T, strict=True):
            self._stream.send_columns(path, [column], rr.Scalars.columns(scalars=values))
