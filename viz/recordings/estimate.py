"""One estimate as it is shown: the answer with the truth, and all that is known of how it came about."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from jaxtyping import Float

from estimators.base import Trace
from testbed.errors import InvalidValueError
from testbed.objects.model import MassDistribution, ObjectShape
from testbed.trajectory import Trajectory
from testbed.validation import frozen_array
from viz.recordings.bars import BarScene, Series
from viz.recordings.loads import LoadScene
from viz.recordings.mass_map import CellMap, Scale
from viz.recordings.motion import TurnScene
from viz.recordings.page import ITERATION, MOST_FRAMES, Frames, evenly, facts_markdown
from viz.recordings.planar import Canvas, planar_view
from viz.style import DIFFERENCE_COLORS, ESTIMATE, MASS_COLORS, rgb, series_color

LEVEL, DEVIATIONS = "90 %", 1.645
"""Probability of an interval, and its half width in standard deviations."""
LEAST_DIFFERENCE = 0.02
"""Least end of the scale of differences, over the heaviest group: noise is not blown up."""


@dataclass(frozen=True, eq=False)
class EstimateShown:
    """An estimate with all that is known about it."""

    title: str
    """What is shown: object, method, sensing."""
    shape: ObjectShape
    """Of the object."""
    truth: MassDistribution | None = None
    """None on a real object."""
    answer: MassDistribution | None = None
    """None where the method has none."""
    covariance: Float[np.ndarray, "n_m n_m"] | None = None
    """Of the particle masses, kg^2."""
    traces: tuple[Trace, ...] = ()
    """The one that led to the answer first."""
    trajectory: Trajectory | None = None
    """A trial to show the particles' velocities in."""
    facts: Mapping[str, str] = field(default_factory=dict)
    """What else is said in words; "method" names it in a comparison."""

    def __post_init__(self) -> None:
        shape = self.shape
        for name, given in (("truth", self.truth), ("answer", self.answer)):
            for what, count in (("mass", shape.n_m), ("friction", shape.n_mu)) if given is not None else ():
                values = getattr(given, what)
                if len(values) != count:
                    raise InvalidValueError(
                        f"EstimateShown.{name}.{what}", values.tolist(), f"{count} numbers, one a group"
                    )
        if self.covariance is not None:
            square = (shape.n_m, shape.n_m)
            checked = frozen_array("EstimateShown.covariance", self.covariance, square, finite=False)
            object.__setattr__(self, "covariance", checked)
        for trace in self.traces:
            if trace.mass.size and trace.mass.shape != (len(trace.loss), shape.n_m):
                allowed = f"({len(trace.loss)}, {shape.n_m}), or none"
                raise InvalidValueError(f"EstimateShown.traces.{trace.method}.mass", trace.mass.shape, allowed)
        object.__setattr__(self, "traces", tuple(self.traces))

    @property
    def method(self) -> str:
        """Name of the method."""
        return self.facts.get("method", self.title)

    @property
    def true_mass(self) -> Float[np.ndarray, "n_m"] | None:
        """kg a group."""
        return None if self.truth is None else self.truth.mass * self.shape.particles_per_group

    @property
    def mass(self) -> Float[np.ndarray, "n_m"] | None:
        """The answer, kg a group."""
        return None if self.answer is None else self.answer.mass * self.shape.particles_per_group

    @property
    def difference(self) -> Float[np.ndarray, "n_m"] | None:
        """|answer - truth|, kg a group."""
        mass, truth = self.mass, self.true_mass
        return None if mass is None or truth is None else np.abs(mass - truth)

    @property
    def nad(self) -> float | None:
        """The paper's eta_1: what is misplaced, over the whole mass."""
        off, truth = self.difference, self.true_mass
        return None if off is None or truth is None else float(off.sum() / truth.sum())

    @property
    def half_width(self) -> Float[np.ndarray, "n_m"] | None:
        """Half of the interval of each group's mass, kg; NaN where the variance is none or infinite."""
        if self.covariance is None:
            return None
        variance = np.diagonal(self.covariance)
        deviation = np.sqrt(np.where((variance >= 0) & np.isfinite(variance), variance, np.nan))
        return DEVIATIONS * deviation * self.shape.particles_per_group

    @property
    def history(self) -> tuple[Frames, Float[np.ndarray, "F n_m"]] | None:
        """The masses on the way of the trace that led to the answer, kg a group, and the answer itself at the end."""
        mass = self.mass
        if mass is None:
            return None
        if not self.traces or not self.traces[0].mass.size:
            return Frames.still(), mass[None]
        way = self.traces[0].mass * self.shape.particles_per_group
        kept = evenly(len(way), MOST_FRAMES - 1)
        frames = Frames(ITERATION, np.append(kept, len(way)).astype(float), len(kept))
        return frames, np.vstack([way[kept], mass])


def mass_scale_of(every: Sequence[EstimateShown], top: float | None = None) -> Scale:
    """One scale for the true and all estimated masses; by default up to the largest of them."""
    masses = [m for shown in every for m in (shown.true_mass, shown.mass) if m is not None]
    ways = [shown.history[1] for shown in every if shown.history is not None]
    return _scale(masses, ways, top, 0.0, MASS_COLORS, "mass, kg a group")


def difference_scale_of(every: Sequence[EstimateShown], top: float | None = None) -> Scale:
    """One scale for all absolute differences; by default up to the largest of the answers."""
    known = [(shown, shown.true_mass) for shown in every if shown.true_mass is not None]
    off = [shown.difference for shown, _ in known if shown.difference is not None]
    ways = [np.abs(shown.history[1] - truth) for shown, truth in known if shown.history is not None]
    least = LEAST_DIFFERENCE * max((float(truth.max()) for _, truth in known), default=0.0)
    return _scale(off, ways, top, least, DIFFERENCE_COLORS, "|difference|, kg a group")


def _scale(
    ends: Sequence[np.ndarray], ways: Sequence[np.ndarray], top: float | None, least: float, colors: str, title: str
) -> Scale:
    """Up to `top`, or to the largest of `ends`; open where an end or something on the way to it is larger."""
    largest = max((float(values.max()) for values in ends), default=1.0)
    end = max(largest if top is None else top, least, 1e-6)
    return Scale(end, colors, title, open=any(float(values.max()) > end * (1 + 1e-9) for values in (*ends, *ways)))


MAIN, SIDE = Canvas(1260, 910), Canvas(325, 910)
"""What the views of the main and the side column share in a window of 1600 by 1000, pixels."""
TITLE = 30.0
"""Height of a view's title, pixels."""


def log_estimate(stream: rr.RecordingStream, root: str, shown: EstimateShown) -> None:
    """Log an estimate below `root`: static, on `iteration`, and its trial on `sim_time`."""
    layout, truth = _Layout.of(shown), shown.true_mass
    mass_scale, off_scale = mass_scale_of([shown]), difference_scale_of([shown])
    frames, way = shown.history or (Frames.still(), None)
    if truth is not None:
        _log_map(stream, f"{root}/true_mass", CellMap(shown.shape, truth[None], mass_scale, layout.map), Frames.still())
        off = None if way is None else np.abs(way - truth)
        _log_map(stream, f"{root}/difference", CellMap(shown.shape, off, off_scale, layout.map), frames)
    _log_map(stream, f"{root}/estimated_mass", CellMap(shown.shape, way, mass_scale, layout.map), frames)
    if way is not None or truth is not None:
        bars_of(shown, layout.lower).log(stream, f"{root}/bars/scene")
    if way is not None:
        _loads(shown, layout.side).log(stream, f"{root}/loads/scene", frames)
        _log_masses(stream, f"{root}/mass_by_iteration", shown.shape, frames, way)
    for index, trace in enumerate(shown.traces):
        _log_loss(stream, f"{root}/loss/{index}", trace, series_color(index))
    if shown.trajectory is not None and TurnScene.shows(shown.trajectory):
        TurnScene(shown.shape, shown.trajectory, layout.lower).log(stream, f"{root}/turn/scene")
    document = rr.TextDocument(facts_text(shown), media_type=rr.MediaType.MARKDOWN)
    stream.log(f"{root}/facts", document, static=True, strict=True)


def estimate_blueprint(root: str, shown: EstimateShown) -> rrb.Container:
    """The views of what `log_estimate` logs below `root`."""
    layout = _Layout.of(shown)
    box = CellMap(shown.shape, None, mass_scale_of([shown]), layout.map).box()
    moves = shown.history is not None and shown.history[0].timeline is not None
    when = ", by iteration" if moves else ""
    maps = [planar_view(f"{root}/estimated_mass", box, f"estimated mass{when}")]
    if shown.truth is not None:
        maps.insert(0, planar_view(f"{root}/true_mass", box, "true mass"))
        maps.append(planar_view(f"{root}/difference", box, f"absolute difference{when}"))
    lower: list[rrb.View | rrb.Container] = []
    if shown.answer is not None or shown.truth is not None:
        lower.append(planar_view(f"{root}/bars", bars_of(shown, layout.lower).box, "mass of each group"))
    if shown.traces:
        lower.append(_iterations(root, moves=moves))
    if shown.trajectory is not None and TurnScene.shows(shown.trajectory):
        turn = TurnScene(shown.shape, shown.trajectory, layout.lower)
        lower.append(planar_view(f"{root}/turn", turn.box, "velocities in a trial, from above"))
    side: list[rrb.View] = [rrb.TextDocumentView(origin=f"{root}/facts", name="facts")]
    if shown.answer is not None:
        loads = _loads(shown, layout.side)
        side.append(planar_view(f"{root}/loads", loads.box, "particles: mass and friction load"))
    rows = [rrb.Horizontal(*row) for row in (maps, lower) if row]
    return rrb.Horizontal(
        rrb.Vertical(*rows, row_shares=[layout.map.height, layout.lower.height][: len(rows)]),
        rrb.Vertical(*side, row_shares=[MAIN.height - layout.side.height, layout.side.height][: len(side)]),
        column_shares=[MAIN.width, SIDE.width],
        name=shown.title,
    )


@dataclass(frozen=True)
class _Layout:
    """What each view can count on."""

    map: Canvas
    lower: Canvas
    side: Canvas

    @staticmethod
    def of(shown: EstimateShown) -> _Layout:
        """Long objects leave more room below their maps."""
        columns = 1 if shown.truth is None else 3
        known = shown.answer is not None or shown.truth is not None
        views = max(known + bool(shown.traces) + TurnScene.shows(shown.trajectory), 1)
        width, least, most = MAIN.width / columns, 0.28 * MAIN.height, 0.56 * MAIN.height
        needed = CellMap(shown.shape, None, mass_scale_of([shown]), Canvas(width, most)).box()
        upper = float(np.clip(width * needed.height / needed.width, least, most))
        lower, side = MAIN.height - upper - 2 * TITLE, 0.45 * SIDE.height
        return _Layout(Canvas(width, upper), Canvas(MAIN.width / views, lower), Canvas(SIDE.width, side))


def bars_of(shown: EstimateShown, canvas: Canvas) -> BarScene:
    """Its bars."""
    history = shown.history
    series = ()
    if history is not None:
        label = "estimate" if shown.covariance is None else f"estimate, {LEVEL} interval"
        series = (Series(label, ESTIMATE, history[1], history[0], shown.half_width),)
    return BarScene(shown.shape.group_names, shown.true_mass, series, canvas)


def facts_text(shown: EstimateShown) -> str:
    """Title and facts as Markdown."""
    facts = {} if shown.nad is None else {"NAD": f"{100 * shown.nad:.2f} %"}
    return facts_markdown(shown.title, "estimate", facts | dict(shown.facts))


def _log_loss(stream: rr.RecordingStream, entity: str, trace: Trace, color: str) -> None:
    """The decadic logarithm of a trace's loss; where the loss is not above 0 there is a gap."""
    loss = np.array(trace.loss, dtype=float)
    shown = np.log10(np.where(loss > 0, loss, np.nan))
    stream.log(entity, rr.SeriesLines(colors=rgb(color), names=trace.method, widths=2.0), static=True, strict=True)
    index = rr.TimeColumn(ITERATION, sequence=np.arange(len(loss)))
    stream.send_columns(entity, [index], rr.Scalars.columns(scalars=shown), strict=True)


def _log_map(stream: rr.RecordingStream, entity: str, drawn: CellMap, frames: Frames) -> None:
    drawn.log(stream, f"{entity}/object", frames, drawn.box())
    drawn.log_bar(stream, f"{entity}/object/bar", drawn.box())


def _log_masses(
    stream: rr.RecordingStream, entity: str, shape: ObjectShape, frames: Frames, way: Float[np.ndarray, "F n_m"]
) -> None:
    """The numbers behind the maps, kg a group."""
    names, count = list(shape.group_names), shape.n_m
    colors = [rgb(series_color(i)) for i in range(count)]
    stream.log(entity, rr.SeriesLines(colors=colors, names=names, widths=[1.5] * count), static=True, strict=True)
    frames.send(stream, entity, lambda k: rr.Scalars.columns(scalars=way[k].ravel()).partition([count] * len(k)))


def _iterations(root: str, *, moves: bool) -> rrb.View | rrb.Container:
    """The loss, and behind it the masses where they are known on the way."""
    legend = rrb.PlotLegend(corner=rrb.Corner2D.RightTop)
    loss = rrb.TimeSeriesView(origin=f"{root}/loss", name="log10 of the loss", plot_legend=legend)
    mass = rrb.TimeSeriesView(origin=f"{root}/mass_by_iteration", name="mass, kg a group", plot_legend=legend)
    return rrb.Tabs(loss, mass, active_tab=0) if moves else loss


def _loads(shown: EstimateShown, canvas: Canvas) -> LoadScene:
    history, answer = shown.history, shown.answer
    assert history is not None
    assert answer is not None
    each = history[1] / shown.shape.particles_per_group
    tops = [float(answer.mass.max())] + ([] if shown.truth is None else [float(shown.truth.mass.max())])
    scale = Scale(max(*tops, 1e-9), MASS_COLORS, "mass, kg a particle")
    return LoadScene(shown.shape, each, answer.friction, shown.truth, scale, canvas)
