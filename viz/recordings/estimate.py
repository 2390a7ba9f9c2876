"""One estimate in Rerun: mass maps, bars, losses, friction loads, and velocities in one of its trials."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from jaxtyping import Float
from matplotlib.transforms import Bbox

from estimators.base import Trace
from testbed.frames import perpendicular, rotation_2d, transform_point
from testbed.objects.chain import Chain
from testbed.objects.colors import group_color
from testbed.objects.model import GRAVITY, Grasp, MassDistribution, ObjectShape
from testbed.trajectory import Phase, Trajectory
from viz import style
from viz.recordings.bars import BarScene, BarSeries
from viz.recordings.mass_map import BELOW, MassMap, Raster, bar_box, log_bar
from viz.recordings.page import ITERATION, SIM_TIME, Frames, Node, log_facts
from viz.recordings.planar import (
    HAIR,
    LINE,
    MARGIN,
    TITLE,
    Canvas,
    log_lines,
    log_texts,
    log_upright,
    packed,
    planar_view,
)
from viz.values import LEVEL, EstimateView, evenly

MAIN, SIDE = Canvas(1260, 910), Canvas(325, 0.45 * 910)
"""Sizes of the main column, and of the friction loads beside it, in a window of 1600 by 1000 pixels."""
FULL_CELL = 0.46
"""Radius of the particle with the largest load, relative to the side of a cell."""
MOST_ARROWS = 150
"""Largest number of particles with an arrow."""
PAD = 0.006
"""Thickness of a drawn pad [m]."""
LONGEST = 0.35
"""Length of the longest arrow, relative to the object's size."""
HORIZONS = (0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0)
"""Candidate horizons [s]: an arrow is a velocity times the horizon."""


def log_estimate(stream: rr.RecordingStream, root: str, view: EstimateView) -> None:
    """Log an estimate below `root`: static values, iterates on `iteration`, and its trial on `sim_time`."""
    node, parts = Node(stream, root), _Parts.of(view)
    frames, iterates = frames_of(view)
    for name, (_, mass_map) in parts.maps.items():
        mass_map.log_with_bar(node / f"{name}/object", Frames.still() if name == "true_mass" else frames)
    if parts.bars is not None:
        parts.bars.log(node / "bars/scene")
    if parts.loads is not None:
        parts.loads.log(node / "loads/scene", frames)
    if iterates is not None:
        _log_masses(node / "mass_by_iteration", view.shape, frames, iterates)
    for index, trace in enumerate(view.traces):
        _log_loss(node / f"loss/{index}", trace, style.series_color(index))
    if parts.turn is not None:
        parts.turn.log(node / "turn/scene")
    nad = {} if view.nad is None else {"NAD": f"{100 * view.nad:.2f} %"}
    log_facts(node / "facts", view.title, "estimate", nad | dict(view.facts))


def estimate_blueprint(root: str, view: EstimateView) -> rrb.Container:
    """Views of the entities that `log_estimate` logs below `root`."""
    parts = _Parts.of(view)
    maps = [planar_view(f"{root}/{name}", mass_map.box, title) for name, (title, mass_map) in parts.maps.items()]
    lower: list[rrb.View | rrb.Container] = []
    if parts.bars is not None:
        lower.append(planar_view(f"{root}/bars", parts.bars.box, "mass of each group"))
    if view.traces:
        legend = rrb.PlotLegend(corner=rrb.Corner2D.RightTop)
        loss = rrb.TimeSeriesView(origin=f"{root}/loss", name="log10 of the loss", plot_legend=legend)
        mass = rrb.TimeSeriesView(origin=f"{root}/mass_by_iteration", name="mass, kg per group", plot_legend=legend)
        moves = frames_of(view)[0].timeline is not None
        lower.append(rrb.Tabs(loss, mass, active_tab=0) if moves else loss)
    if parts.turn is not None:
        lower.append(planar_view(f"{root}/turn", parts.turn.box, "velocities in a trial, from above"))
    side: list[rrb.View] = [rrb.TextDocumentView(origin=f"{root}/facts", name="facts")]
    if parts.loads is not None:
        side.append(planar_view(f"{root}/loads", parts.loads.box, "particles: mass and friction load"))
    rows = [rrb.Horizontal(*row) for row in (maps, lower) if row]
    return rrb.Horizontal(
        rrb.Vertical(*rows, row_shares=list(parts.heights)[: len(rows)]),
        rrb.Vertical(*side, row_shares=[MAIN.height - SIDE.height, SIDE.height][: len(side)]),
        column_shares=[MAIN.width, SIDE.width],
        name=view.title,
    )


@dataclass(frozen=True)
class _Parts:
    """Planar parts of an estimate; None where their values are unknown."""

    maps: dict[str, tuple[str, MassMap]]
    """Titles and maps by entity."""
    bars: BarScene | None
    turn: _TurnScene | None
    loads: _LoadScene | None
    heights: tuple[float, float]
    """Heights of the row of maps and of the row below [pixels]; a long object has lower maps."""

    @staticmethod
    def of(view: EstimateView) -> _Parts:
        shape, truth, mass = view.shape, view.true_mass, style.mass_scale([view])
        frames, iterates = frames_of(view)
        record, bars = view.trajectory, iterates is not None or truth is not None
        moves = record is not None and record.action.moves and record.time_s.size > 1
        width, least, most = MAIN.width / (1 if truth is None else 3), 0.28 * MAIN.height, 0.56 * MAIN.height
        needed = MassMap(shape, None, mass, Canvas(width, most)).box
        upper = float(np.clip(width * needed.height / needed.width, least, most))
        place = Canvas(width, upper)
        lower = Canvas(MAIN.width / max(bars + bool(view.traces) + moves, 1), MAIN.height - upper - 2 * TITLE)
        when = "" if frames.timeline is None else ", by iteration"
        maps = {"estimated_mass": (f"estimated mass{when}", MassMap(shape, iterates, mass, place))}
        if truth is not None:
            differences = None if iterates is None else np.abs(iterates - truth)
            difference = MassMap(shape, differences, style.difference_scale([view]), place)
            known = {"true_mass": ("true mass", MassMap(shape, truth[None], mass, place))}
            maps = known | maps | {"difference": (f"absolute difference{when}", difference)}
        label = "estimate" if view.covariance is None else f"estimate, {LEVEL} interval"
        series = () if iterates is None else (BarSeries(label, style.ESTIMATE, iterates, frames, view.half_width),)
        loads = None
        if iterates is not None and view.answer is not None:
            loads = _LoadScene(view, iterates / shape.particles_per_group, view.answer)
        return _Parts(
            maps,
            BarScene(shape.group_names, truth, series, lower) if bars else None,
            _TurnScene(shape, record, lower) if record is not None and moves else None,
            loads,
            (upper, lower.height),
        )


def frames_of(view: EstimateView) -> tuple[Frames, Float[np.ndarray, "F n_m"] | None]:
    """Frames of an estimate's iterates, and the mass of each group in them [kg], (F, n_m) or None without an answer."""
    if view.iterates is None:
        return Frames.still(), None
    iterations, masses = view.iterates
    return Frames.of(iterations), masses


def _log_loss(node: Node, trace: Trace, color: str) -> None:
    """Log the decimal logarithm of a trace's loss; losses of 0 or less leave a gap."""
    loss = np.array(trace.loss, dtype=float)
    node.log(rr.SeriesLines(colors=style.rgb(color), names=trace.method, widths=2.0))
    logarithm = np.log10(np.where(loss > 0, loss, np.nan))
    node.send([rr.TimeColumn(ITERATION, sequence=np.arange(len(loss)))], rr.Scalars.columns(scalars=logarithm))


def _log_masses(node: Node, shape: ObjectShape, frames: Frames, masses: Float[np.ndarray, "F n_m"]) -> None:
    """Log a line per group: its mass [kg]."""
    names, count = list(shape.group_names), shape.n_m
    colors = [style.rgb(group_color(i)) for i in range(count)]
    node.log(rr.SeriesLines(colors=colors, names=names, widths=[1.5] * count))
    frames.send(node, lambda k: rr.Scalars.columns(scalars=masses[k].ravel()).partition([count] * len(k)))


def friction_load(
    shape: ObjectShape, mass: Float[np.ndarray, "... n_m"], friction: Float[np.ndarray, "n_mu"]
) -> Float[np.ndarray, "... P"]:
    """Friction load of every particle [N], its group's weight being carried by those that touch; 0 for the others.

    `mass` is that of one particle of each group [kg].
    """
    coefficient = np.where(shape.friction_group < 0, 0.0, np.append(friction, 0.0)[shape.friction_group])
    carried = np.asarray(mass) * (shape.particles_per_group / np.maximum(shape.feet_per_group, 1))
    return coefficient * carried[..., shape.mass_group] * GRAVITY


@dataclass(frozen=True, eq=False)
class _LoadScene:
    """Particles colored by mass and sized by friction load in F frames; rings show the true load."""

    view: EstimateView
    mass: Float[np.ndarray, "F n_m"]
    """Mass of a particle of each group [kg]."""
    answer: MassDistribution

    @property
    def box(self) -> Bbox:
        """Bounds around the whole drawing."""
        box = Raster.of(self.view.shape).box
        return SIDE.framed(Bbox.union([box, bar_box(box)]), 24, LINE + 3 * MARGIN, BELOW)

    def log(self, node: Node, frames: Frames) -> None:
        """Log the scene below `node`."""
        shape, truth, answer = self.view.shape, self.view.truth, self.answer
        raster, pixel, count = Raster.of(shape), SIDE.pixel(self.box), len(shape.particles)
        log_upright(node)
        log_lines(node / "outlines", raster.outlines())
        load = friction_load(shape, self.mass, answer.friction)
        true_load = np.zeros(count) if truth is None else friction_load(shape, truth.mass, truth.friction)
        largest = max(float(load[-1].max()), float(true_load.max()), 1e-12)

        def radius(load: np.ndarray) -> np.ndarray:
            """Radius of a disc with an area proportional to its load, clipped at the largest load [m]."""
            return FULL_CELL * shape.cell * np.sqrt(np.clip(load / largest, 0.0, 1.0))

        tops = [float(each.mass.max()) for each in (answer, truth) if each is not None]
        scale = style.Scale(max(*tops, 1e-9), style.MASS_COLORS, "mass, kg per particle")
        colors = packed(scale.color(self.mass[:, shape.mass_group]))
        # a least radius, so that the color of particles without load is visible
        radii = np.maximum(radius(load), 0.1 * shape.cell)
        (node / "particles").log(rr.Points2D(shape.particles))
        frames.send(
            node / "particles",
            lambda k: rr.Points2D.columns(colors=colors[k].ravel(), radii=radii[k].ravel()).partition([count] * len(k)),
        )
        if truth is not None:
            ring = radius(true_load)[true_load > 0]
            look = {"colors": style.rgb(style.BLACK), "line_radii": HAIR, "draw_order": 40}
            half, centers = np.column_stack([ring, ring]), shape.particles[true_load > 0]
            (node / "true_load").log(rr.Ellipses2D(half_sizes=half, centers=centers, **look))
        log_bar(node / "bar", scale, bar_box(raster.box), pixel)
        place = np.array([[(raster.box.x0 + raster.box.x1) / 2, raster.box.y1 + (LINE / 2 + 1.5 * MARGIN) * pixel]])
        known = ", ring: truth" if truth is not None else ""
        log_texts(node / "key", place, [f"full cell: {largest:.2g} N{known}"], pixel)


@dataclass(frozen=True, eq=False)
class _TurnScene:
    """A trial in which the object moves on the table."""

    shape: ObjectShape
    """Geometry of the object."""
    trajectory: Trajectory
    """Trajectory of the trial."""
    canvas: Canvas
    """Size of the view."""

    @property
    def horizon(self) -> float:
        """Horizon of the arrows [s]: the longest of HORIZONS with every arrow up to LONGEST, else the shortest."""
        speeds = np.linalg.norm(self._velocity(self.shape.particles), axis=-1)
        size = float(np.linalg.norm(np.ptp(self.shape.particles, axis=0) + self.shape.cell))
        fitting = [h for h in HORIZONS if h * float(speeds.max()) <= LONGEST * size]
        return fitting[-1] if fitting else HORIZONS[0]

    @property
    def box(self) -> Bbox:
        """Bounds around the object in all its poses."""
        outline = np.concatenate(Raster.of(self.shape).outlines())
        reach = 0.5 * LONGEST * float(np.linalg.norm(np.ptp(outline, axis=0)))
        places = transform_point(self._pose[:, None], outline[None]).reshape(-1, 2)
        box = Bbox([places.min(axis=0), places.max(axis=0)]).padded(reach)
        return self.canvas.framed(box, 0, LINE + 2 * MARGIN, 0)

    def log(self, node: Node) -> None:
        """Log the scene below `node`, world axes."""
        log_upright(node)
        frames, body = self._frames, node / "object"
        _log_poses(body, frames, self._pose)
        if self.shape.chain is not None:
            self._log_links(node, self.shape.chain)
            return
        log_lines(body / "outline", Raster.of(self.shape).outlines(), style.EDGE)
        dots = rr.Points2D(self.shape.particles, radii=0.16 * self.shape.cell, colors=style.rgb(style.TRUTH))
        (body / "particles").log(dots)
        particles = self.shape.particles[evenly(len(self.shape.particles), MOST_ARROWS)]
        self._log_arrows(body / "velocity", frames, particles, style.VELOCITY)
        self._log_arrows(body / "object_velocity", frames, np.zeros((1, 2)), style.OBJECT_VELOCITY)
        index = self.trajectory.action.grasp
        if index is not None and index < len(self.shape.grasps):
            pads = rr.LineStrips2D(pad_lines(self.shape.grasps[index]), colors=style.rgb(style.PADS), radii=PAD / 2)
            (body / "pads").log(pads)
        box = self.box
        pixel = self.canvas.pixel(box)
        at = np.array([[(box.x0 + box.x1) / 2, box.y1 - (LINE / 2 + MARGIN) * pixel]])
        key = f"arrows: motion in {self.horizon:g} s; blue particles, black object, pink pads"
        log_texts(node / "key", at, [key], pixel)

    def _log_links(self, node: Node, chain: Chain) -> None:
        """Log the particles of every link in the poses that the camera measured."""
        frames, camera = self._frames, self.trajectory.camera
        poses = np.zeros((0, 0, 3)) if camera is None else camera.at(self.trajectory.time_s[self._kept])
        for link, pose in enumerate(poses.transpose(1, 0, 2)):
            body = node / f"link_{link}"
            _log_poses(body, frames, pose)
            own = self.shape.particles[chain.link[self.shape.mass_group] == link]
            (body / "particles").log(rr.Points2D(own, radii=0.3 * self.shape.cell, colors=style.rgb(group_color(link))))

    def _log_arrows(self, node: Node, frames: Frames, origins: Float[np.ndarray, "N 2"], color: str) -> None:
        look = rr.Arrows2D.from_fields(origins=origins, colors=style.rgb(color), radii=rr.Radius.ui_points(1.0))
        node.log(look)
        vectors = self.horizon * self._velocity(origins)
        frames.send(
            node, lambda k: rr.Arrows2D.columns(vectors=vectors[k].reshape(-1, 2)).partition([len(origins)] * len(k))
        )

    @property
    def _kept(self) -> np.ndarray:
        return evenly(len(self.trajectory.time_s))

    @property
    def _frames(self) -> Frames:
        """Evenly spread samples; on the other timeline, the middle steady one."""
        kept = self._kept
        steady = np.flatnonzero(self.trajectory.mask(Phase.STEADY)[kept])
        rest = steady[len(steady) // 2] if len(steady) else len(kept) // 2
        return Frames(SIM_TIME, self.trajectory.time_s[kept], int(rest))

    @property
    def _pose(self) -> Float[np.ndarray, "F 3"]:
        return self.trajectory.object_pose[self._kept]

    def _velocity(self, points: Float[np.ndarray, "N 2"]) -> Float[np.ndarray, "F N 2"]:
        """Velocities of points of the object [m/s], object axes: v + omega x p."""
        velocity = self.trajectory.object_velocity[self._kept]
        linear = np.einsum("nji,nj->ni", rotation_2d(self._pose[:, 2]), velocity[:, :2])
        return linear[:, None, :] + velocity[:, 2, None, None] * perpendicular(points)


def _log_poses(node: Node, frames: Frames, pose: Float[np.ndarray, "F 3"]) -> None:
    """Log planar poses [m, rad] of an entity."""
    half, still = pose[:, 2] / 2, np.zeros(len(pose))
    place = np.column_stack([pose[:, :2], still])
    turned = np.column_stack([still, still, np.sin(half), np.cos(half)])
    frames.send(node, lambda k: rr.Transform3D.columns(translation=place[k], quaternion=turned[k]))


def pad_lines(grasp: Grasp) -> Float[np.ndarray, "2 2 2"]:
    """Lines of the gripper's two pads, as long as the faces that they hold [m], object frame."""
    close = np.array([np.cos(grasp.angle), np.sin(grasp.angle)])
    along = min(grasp.length, grasp.width) / 2 * perpendicular(close)
    middles = grasp.position + np.outer([-1.0, 1.0], (grasp.width + PAD) / 2 * close)
    return np.stack([middles - along, middles + along], axis=1)
