"""Estimates and comparisons in Rerun: what is logged is what was given, entity by entity, value by value."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rerun as rr
import rerun.blueprint as rrb
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from estimators.base import Trace
from testbed.actions.base import Weigh
from testbed.errors import InvalidValueError
from testbed.frames import transform_point
from testbed.objects.files import load_object
from testbed.objects.model import GRAVITY, MassDistribution, ObjectShape
from testbed.trajectory import Trajectory
from tests.helpers.chunks import Entity, read_chunks, verify
from tests.helpers.records import turn_record
from viz.recordings.bars import filled
from viz.recordings.comparison import comparison_blueprint, log_comparison
from viz.recordings.estimate import (
    EstimateShown,
    difference_scale_of,
    estimate_blueprint,
    facts_text,
    log_estimate,
    mass_scale_of,
)
from viz.recordings.mass_map import Raster
from viz.recordings.motion import HORIZONS
from viz.recordings.page import MOST_FRAMES, evenly
from viz.style import BACKGROUND, DIFFERENCE_COLORS, MASS_COLORS, mapped, rgb

ITERATIONS = 500
OFF = np.array([1.013, 1.217, 0.731, 0.977, 1.411, 0.893])
DEVIATION = 1e-3 * np.array([1.0, 2.0, 3.0, 4.0, 5.0, np.nan])
PACK = np.array([1 << 24, 1 << 16, 1 << 8], dtype=np.int64)


@pytest.fixture(autouse=True)
def _strict() -> Iterator[None]:
    """What Rerun would only warn of fails here."""
    rr.set_strict_mode(True)
    yield
    rr.set_strict_mode(False)


def trace(name: str, start: np.ndarray, end: np.ndarray, count: int = ITERATIONS) -> Trace:
    """Masses on a straight way, losses on a geometric one; the last loss is 0, which has no logarithm."""
    part = np.linspace(0, 1, count)[:, None]
    losses = np.append(np.geomspace(1.0, 1e-6, count - 1), 0.0)
    return Trace(name, tuple(losses.tolist()), tuple(np.arange(count) / 100), 1.0, start + part * (end - start))


def turn(shape: ObjectShape) -> Trajectory:
    """A turn about the second grasp that speeds up."""
    held = shape.grasps[1].position
    return turn_record(np.zeros(6), grasp=held, pivot=held, speed=0.4, acceleration=0.1, count=600)


def block_estimate(**changes: Any) -> EstimateShown:
    """L2: two runs of an optimiser, a covariance, a turn."""
    model = load_object("L2")
    answer = MassDistribution(model.truth.mass * OFF, np.array([0.45]))
    uniform = np.full(6, model.truth.mass.mean())
    traces = trace("adam", uniform, 1.01 * answer.mass), trace("plain", uniform, uniform, 7)
    shown = EstimateShown(
        "L2: by hand", model.shape, model.truth, answer, np.diag(DEVIATION**2), traces, turn(model.shape),
        {"method": "hand", "status": "ok"},
    )  # fmt: skip
    return replace(shown, **changes)


def logged(path: Path, log: Callable[[rr.RecordingStream], None], blueprint: Any) -> dict[str, Entity]:
    """Write a recording with its blueprint, and read it back."""
    stream = rr.RecordingStream("heft_test")
    stream.save(path, default_blueprint=rrb.Blueprint(blueprint))
    log(stream)
    stream.flush()
    stream.disconnect()
    return read_chunks(path)


@pytest.fixture(scope="module")
def blocks(tmp_path_factory: pytest.TempPathFactory) -> tuple[EstimateShown, dict[str, Entity]]:
    """An estimate and its recording."""
    shown = block_estimate()
    path = tmp_path_factory.mktemp("view") / "estimate.rrd"
    chunks = logged(path, lambda s: log_estimate(s, "e", shown), estimate_blueprint("e", shown))
    verify(path)
    return shown, chunks


def pixels(entity: Entity, buffer: list) -> np.ndarray:
    """An image, (H, W, 3), the lowest row first."""
    look = entity.static["Image:format"][0]
    return np.array(buffer[0], dtype=np.uint8).reshape(look["height"], look["width"], 3)


def colors_of_groups(shape: ObjectShape, entity: Entity, buffer: list) -> np.ndarray:
    """Colour of each mass group in an image, (n_m, 3), where every particle of it is found; else fails."""
    image, low = pixels(entity, buffer), shape.particles.min(axis=0)
    place = entity.static["Transform3D:translation"][0], entity.static["Transform3D:scale"][0]
    found: dict[int, set] = {}
    for (x, y), group in zip(shape.particles, shape.mass_group, strict=True):
        column, row = (int((value - p) // s) for value, p, s in zip((x, y), *place, strict=False))
        found.setdefault(int(group), set()).add(tuple(image[row, column]))
    assert all(len(colors) == 1 for colors in found.values()), low
    return np.array([next(iter(found[group])) for group in range(shape.n_m)])


def test_everything_is_on_the_two_timelines_or_static(blocks):
    _, chunks = blocks
    assert {timeline for entity in chunks.values() for timeline in entity.times} == {"iteration", "sim_time"}
    for name in ("true_mass", "estimated_mass", "difference"):
        assert {f"e/{name}/object/{part}" for part in ("cells", "outlines", "bar/colors", "bar/ticks")} <= set(chunks)
    assert {"e/facts", "e/loss/0", "e/loss/1", "e/bars/scene/series/0", "e/loads/scene/particles"} <= set(chunks)
    for path, entity in chunks.items():
        if entity.times and not path.startswith("e/loss"):
            assert set(entity.times) == {"iteration", "sim_time"}, f"{path} would vanish on the other timeline"
        for components in entity.times.values():
            for component, times in components.items():
                assert len(times) <= (ITERATIONS if path.startswith("e/loss") else MOST_FRAMES), component
                assert (np.diff(times) > 0).all()


def test_maps_go_from_the_first_guess_to_the_answer_on_one_scale(blocks):
    shown, chunks = blocks
    counts = shown.shape.particles_per_group
    top, off_top = mass_scale_of([shown]).top, difference_scale_of([shown]).top
    assert top == pytest.approx((shown.answer.mass * counts).max())
    assert off_top == pytest.approx(np.abs((shown.answer.mass - shown.truth.mass) * counts).max())
    truth = chunks["e/true_mass/object/cells"]
    read = colors_of_groups(shown.shape, truth, truth.static["Image:buffer"])
    assert_array_equal(read, mapped(shown.truth.mass * counts, top, MASS_COLORS))
    estimate = chunks["e/estimated_mass/object/cells"]
    times = estimate.times["iteration"]["Image:buffer"]
    assert times[0] == 0
    assert_array_equal(times[-2:], [ITERATIONS - 1, ITERATIONS])
    frames = estimate.values["iteration"]["Image:buffer"]
    difference = chunks["e/difference/object/cells"]
    for index in (0, 57, len(times) - 2, len(times) - 1):
        at = int(times[index])
        mass = counts * (shown.traces[0].mass[at] if at < ITERATIONS else shown.answer.mass)
        read = colors_of_groups(shown.shape, estimate, frames[index])
        assert_array_equal(read, mapped(mass, top, MASS_COLORS))
        read = colors_of_groups(shown.shape, difference, difference.values["iteration"]["Image:buffer"][index])
        assert_array_equal(read, mapped(np.abs(mass - shown.truth.mass * counts), off_top, DIFFERENCE_COLORS))
    assert estimate.values["sim_time"]["Image:buffer"] == frames[-1:], "on the other timeline the answer stands"
    beside = pixels(estimate, frames[-1])[-1, -1]
    assert_array_equal(beside, rgb(BACKGROUND))


def test_cells_are_named_and_numbered_and_y_is_up(blocks):
    shown, chunks = blocks
    object_frame = chunks["e/estimated_mass/object"].static["Transform3D:mat3x3"][0]
    assert_allclose(np.array(object_frame).reshape(3, 3), np.diag([1, -1, 1]))  # Rerun's planar views have y down
    names, masses = chunks["e/estimated_mass/object/groups/names"], chunks["e/estimated_mass/object/groups/masses"]
    assert names.static["Points2D:labels"] == list(shown.shape.group_names)
    counts = shown.shape.particles_per_group
    expected = [f"{value:.2f}" for value in shown.answer.mass * counts]
    assert masses.at_end("Points2D:labels") == expected
    heights = dict(zip(shown.shape.group_names, np.array(names.static["Points2D:positions"])[:, 1], strict=True))
    assert heights["A4"] > heights["A1"]
    ticks = chunks["e/estimated_mass/object/bar/ticks"].static
    assert ticks["Points2D:labels"][-1].startswith("≥"), "on the way masses were larger than they are in the end"
    at = np.array([float(text.removeprefix("≥ ")) for text in ticks["Points2D:labels"]])
    x = np.array(ticks["Points2D:positions"])[:, 0]
    bar = chunks["e/estimated_mass/object/bar/outline"].static["LineStrips2D:strips"][0]
    left, right = np.min(bar, axis=0)[0], np.max(bar, axis=0)[0]
    assert_allclose((x - left) / (right - left), at / mass_scale_of([shown]).top, atol=0.01)
    assert "kg" in chunks["e/estimated_mass/object/bar/title"].static["Points2D:labels"][0]


def bar_heights(entity: Entity, timeline: str | None = None) -> np.ndarray:
    """kg, of the strokes' outer edges."""
    strips = (
        entity.static["LineStrips2D:strips"] if timeline is None else entity.at_end("LineStrips2D:strips", timeline)
    )
    radii = entity.static["LineStrips2D:radii"] if timeline is None else entity.at_end("LineStrips2D:radii", timeline)
    return np.array([max(y for _, y in strip) + radius for strip, radius in zip(strips, radii, strict=True)])


def test_bars_are_as_high_as_the_masses_and_intervals_as_long_as_the_covariance_says(blocks):
    shown, chunks = blocks
    counts = shown.shape.particles_per_group
    truth, bars = chunks["e/bars/scene/truth"], chunks["e/bars/scene/series/0"]
    assert_allclose(bar_heights(bars, "iteration"), shown.answer.mass * counts, rtol=1e-5)
    assert_allclose(bar_heights(bars, "sim_time"), shown.answer.mass * counts, rtol=1e-5)
    first = [max(y for _, y in strip) for strip in bars.values["iteration"]["LineStrips2D:strips"][0]]
    radii = bars.values["iteration"]["LineStrips2D:radii"][0]
    assert_allclose(np.add(first, radii), shown.traces[0].mass[0] * counts, rtol=1e-5)
    assert_allclose(bar_heights(truth), shown.truth.mass * counts, rtol=1e-5)
    lines = np.array([line for line in chunks["e/bars/scene/intervals/0"].static["LineStrips2D:strips"]])
    upright = lines[np.abs(lines[:, 0, 0] - lines[:, 1, 0]) < 1e-9]
    assert len(upright) == 5, "a variance that is not known has no interval"
    assert_allclose(np.diff(upright[:, :, 1]).ravel(), 2 * 1.645 * DEVIATION[:5] * counts[:5], rtol=1e-4)
    assert_allclose(upright[:, :, 1].mean(axis=1), (shown.answer.mass * counts)[:5], rtol=1e-5)


@given(st.floats(0, 3), st.floats(0.01, 1), st.floats(0.001, 0.02))
def test_a_filled_bar_covers_its_rectangle_and_no_more(height: float, width: float, stroke: float):
    line, radius = filled(1.0, 1.0 + width, height, stroke)
    low, high = line.min(axis=0) - radius, line.max(axis=0) + radius
    assert_allclose((*low, *high), (1.0, 0.0, 1.0 + width, height), atol=1e-9)
    upright = np.unique(line[:, 0])
    assert np.diff(upright).max(initial=0.0) <= 2 * max(radius, stroke) + 1e-9


def test_losses_and_masses_can_be_read_back(blocks):
    shown, chunks = blocks
    for index, each in enumerate(shown.traces):
        entity = chunks[f"e/loss/{index}"]
        assert entity.static["SeriesLines:names"] == [each.method]
        loss = np.array(entity.values["iteration"]["Scalars:scalars"], dtype=float).ravel()
        assert_allclose(10 ** loss[:-1], each.loss[:-1], rtol=1e-9)
        assert np.isnan(loss[-1]), "no logarithm of 0"
        assert_array_equal(entity.times["iteration"]["Scalars:scalars"], np.arange(len(each.loss)))
    masses = chunks["e/mass_by_iteration"]
    assert masses.static["SeriesLines:names"] == list(shown.shape.group_names)
    assert_allclose(masses.at_end("Scalars:scalars"), shown.answer.mass * shown.shape.particles_per_group)


def test_discs_are_as_large_as_friction_loads(blocks):
    shown, chunks = blocks
    particles, rings = chunks["e/loads/scene/particles"], chunks["e/loads/scene/true_load"]
    assert_allclose(particles.static["Points2D:positions"], shown.shape.particles, atol=1e-6)
    load = 0.45 * shown.answer.mass[shown.shape.mass_group] * GRAVITY
    true_load = shown.truth.friction[0] * shown.truth.mass[shown.shape.mass_group] * GRAVITY
    area = np.array(particles.at_end("Points2D:radii")) ** 2
    true_area = np.array(rings.static["Ellipses2D:half_sizes"])[:, 0] ** 2
    big = load > 0.1 * load.max()  # the smallest discs are drawn larger, so that their colour is seen
    assert_allclose(area[big] / area.max(), load[big] / load.max(), rtol=1e-5)
    assert_allclose(true_area / area.max(), true_load / load.max(), rtol=1e-5)
    top = max(shown.answer.mass.max(), shown.truth.mass.max())
    packed = mapped(shown.answer.mass[shown.shape.mass_group], top, MASS_COLORS).astype(np.int64) @ PACK + 255
    assert_array_equal(particles.at_end("Points2D:colors"), packed)


def test_arrows_are_the_particles_velocities_as_they_move(blocks):
    shown, chunks = blocks
    trajectory, body = shown.trajectory, chunks["e/turn/scene/object"]
    times = body.times["sim_time"]["Transform3D:translation"]
    at = np.searchsorted(trajectory.time_s, times - 1e-6)
    assert_allclose(trajectory.time_s[at], times, atol=1e-9)
    assert times[0] == trajectory.time_s[0]
    assert times[-1] == trajectory.time_s[-1]
    place = np.array(body.values["sim_time"]["Transform3D:translation"])[:, 0]
    turned = np.array(body.values["sim_time"]["Transform3D:quaternion"])[:, 0]
    yaw = 2 * np.arctan2(turned[:, 2], turned[:, 3])
    assert_allclose(place[:, :2], trajectory.object_pose[at, :2], atol=1e-6)
    assert_allclose(yaw, trajectory.object_pose[at, 2], atol=1e-5)
    arrows = chunks["e/turn/scene/object/velocity"]
    points = np.array(arrows.static["Arrows2D:origins"])
    ways = np.array(arrows.values["sim_time"]["Arrows2D:vectors"])
    # what is drawn, in the world, is a round multiple of how fast the particle's place in the world changes
    seen = transform_point(trajectory.object_pose[:, None], points[None])
    fast = np.gradient(seen, trajectory.time_s, axis=0)[at]
    pose = np.column_stack([np.zeros((len(at), 2)), yaw])
    drawn = transform_point(pose[:, None], ways)
    horizon = float((drawn * fast).sum() / (fast**2).sum())
    round_one = min(HORIZONS, key=lambda each: abs(each - horizon))
    assert horizon == pytest.approx(round_one, rel=1e-3)
    assert f"the way of {round_one:g} s" in chunks["e/turn/scene/key"].static["Points2D:labels"][0]
    assert_allclose(drawn[2:-2], horizon * fast[2:-2], atol=2e-4)
    still = np.linalg.norm(points - shown.shape.grasps[1].position, axis=1).argmin()
    assert np.linalg.norm(ways[:, still], axis=-1).max() < 0.1 * np.linalg.norm(ways, axis=-1).max()


def test_a_method_without_a_way_is_static_and_one_without_an_answer_says_so(tmp_path):
    plain = block_estimate(traces=(), covariance=None, trajectory=None)
    chunks = logged(tmp_path / "a.rrd", lambda s: log_estimate(s, "e", plain), estimate_blueprint("e", plain))
    assert not any(entity.times for entity in chunks.values())
    assert "Image:buffer" in chunks["e/estimated_mass/object/cells"].static
    assert not {path for path in chunks if path.startswith(("e/loss", "e/turn", "e/bars/scene/intervals"))}
    silent = block_estimate(answer=None, traces=(), covariance=None, facts={"why": "too few turns"})
    chunks = logged(tmp_path / "b.rrd", lambda s: log_estimate(s, "e", silent), estimate_blueprint("e", silent))
    assert chunks["e/estimated_mass/object/groups"].static["Points2D:labels"] == ["no answer"]
    assert "too few turns" in chunks["e/facts"].static["TextDocument:text"][0]
    assert not {path for path in chunks if path.startswith(("e/loads", "e/mass_by_iteration"))}
    real = block_estimate(truth=None)
    chunks = logged(tmp_path / "c.rrd", lambda s: log_estimate(s, "e", real), estimate_blueprint("e", real))
    assert not {path for path in chunks if path.startswith(("e/true_mass", "e/difference", "e/bars/scene/truth"))}
    assert real.nad is None
    shown = block_estimate(trajectory=replace(turn(plain.shape), action=Weigh()))
    chunks = logged(tmp_path / "d.rrd", lambda s: log_estimate(s, "e", shown), estimate_blueprint("e", shown))
    assert not {path for path in chunks if path.startswith("e/turn")}, "nothing moves on a scale"


def test_an_object_of_a_hundred_particles_with_a_mass_each(tmp_path):
    hammer = load_object("hammer").shape
    count = len(hammer.particles)
    shape = ObjectShape(hammer.particles, np.arange(count), np.zeros(count, int), hammer.cell, hammer.height)
    truth = MassDistribution(np.linspace(0.01, 0.02, count), np.array([0.5]))
    answer = MassDistribution(truth.mass[::-1], np.array([0.5]))
    shown = EstimateShown("hammer", shape, truth, answer, traces=(trace("adam", truth.mass, answer.mass, 50),))
    chunks = logged(tmp_path / "h.rrd", lambda s: log_estimate(s, "e", shown), estimate_blueprint("e", shown))
    cells = chunks["e/estimated_mass/object/cells"]
    read = colors_of_groups(shape, cells, cells.at_end("Image:buffer"))
    assert_array_equal(read, mapped(answer.mass, mass_scale_of([shown]).top, MASS_COLORS))
    assert "e/estimated_mass/object/groups/masses" not in chunks, "there is no room for a hundred numbers"
    assert len(chunks["e/bars/scene/names"].static["Points2D:labels"]) <= 40


def test_a_raster_has_every_particle_once_and_outlines_only_at_borders():
    for name in ("L2", "I1", "hammer", "wrench"):
        shape = load_object(name).shape
        raster = Raster.of(shape)
        assert_array_equal(np.bincount(raster.group[raster.group >= 0]), shape.particles_per_group)
        length = sum(float(np.abs(line[1] - line[0]).sum()) for line in raster.outlines())
        inside = np.pad(raster.group, 1, constant_values=-1)
        borders = (inside[1:] != inside[:-1]).sum() + (inside[:, 1:] != inside[:, :-1]).sum()
        assert length == pytest.approx(borders * raster.pixel)
    shifted = ObjectShape(np.array([[0.0, 0.0], [0.01, 0.005]]), np.arange(2), np.zeros(2, int), 0.01, 0.03)
    raster = Raster.of(shifted)
    assert raster.pixel == pytest.approx(0.0025)
    assert_array_equal(np.bincount(raster.group[raster.group >= 0]), [16, 16])


def views(part: Any) -> list[Any]:
    """Every view of a container."""
    return [part] if isinstance(part, rrb.View) else [view for each in part.contents for view in views(each)]


def test_views_look_where_something_is_logged(blocks):
    shown, chunks = blocks
    for view in views(estimate_blueprint("e", shown)):
        assert any(path.startswith(str(view.origin)) for path in chunks), view.origin
    names = [str(view.name) for view in views(estimate_blueprint("e", shown))]
    assert len(set(names)) == len(names)


def test_facts_are_text_whatever_they_hold():
    shown = block_estimate(title="a|b *c*", facts={"why": "x | y <script>", "empty": ""})
    text = facts_text(shown)
    assert "a\\|b \\*c\\*" in text
    assert "x \\| y \\<script\\>" in text
    assert "empty" not in text
    assert shown.nad is not None
    assert f"| NAD | {100 * shown.nad:.2f} % |" in text


def test_values_that_do_not_fit_are_refused():
    shape = load_object("L2").shape
    with pytest.raises(InvalidValueError, match=r"truth\.mass"):
        EstimateShown("x", shape, MassDistribution(np.ones(5), np.ones(1)))
    with pytest.raises(InvalidValueError, match=r"answer\.friction"):
        EstimateShown("x", shape, None, MassDistribution(np.ones(6), np.ones(2)))
    with pytest.raises(InvalidValueError, match="covariance"):
        EstimateShown("x", shape, covariance=np.eye(5))
    with pytest.raises(InvalidValueError, match="adam"):
        EstimateShown("x", shape, traces=(trace("adam", np.ones(5), np.ones(5)),))


@given(st.integers(1, 3000), st.integers(2, 200))
def test_few_of_many_have_the_first_and_the_last(count: int, most: int):
    kept = evenly(count, most)
    assert kept[0] == 0
    assert kept[-1] == count - 1
    assert len(kept) <= most
    assert (np.diff(kept) > 0).all()


@pytest.fixture(scope="module")
def comparison(tmp_path_factory: pytest.TempPathFactory) -> tuple[list[EstimateShown], dict[str, Entity]]:
    """Three methods: one with a way, one without, one without an answer."""
    right = block_estimate(answer=block_estimate().truth, traces=(), facts={"method": "right"})
    silent = block_estimate(answer=None, traces=(), facts={"method": "silent"})
    shown = [block_estimate(), right, silent]
    path = tmp_path_factory.mktemp("view") / "comparison.rrd"
    chunks = logged(path, lambda s: log_comparison(s, "c", shown), comparison_blueprint("c", shown))
    verify(path)
    return shown, chunks


def test_a_comparison_has_every_method_on_the_same_scales(comparison):
    shown, chunks = comparison
    shape, counts = shown[0].shape, shown[0].shape.particles_per_group
    known = np.concatenate([each.answer.mass * counts for each in shown[:2]])
    top = max((shown[0].truth.mass * counts).max(), np.percentile(known, 95))
    truth = chunks["c/truth/mass/cells"]
    read = colors_of_groups(shape, truth, truth.static["Image:buffer"])
    assert_array_equal(read, mapped(shown[0].truth.mass * counts, top, MASS_COLORS))
    right = chunks["c/methods/1/mass/cells"]
    assert right.static["Image:buffer"] == truth.static["Image:buffer"], "the same masses have the same colours"
    moving = chunks["c/methods/0/mass/cells"]
    read = colors_of_groups(shape, moving, moving.at_end("Image:buffer"))
    assert_array_equal(read, mapped(shown[0].answer.mass * counts, top, MASS_COLORS))
    none = chunks["c/methods/1/difference/cells"]
    read = colors_of_groups(shape, none, none.static["Image:buffer"])
    assert_array_equal(read, mapped(np.zeros(6), 1.0, DIFFERENCE_COLORS))
    assert chunks["c/methods/2/mass/groups"].static["Points2D:labels"] == ["no answer"]
    assert_allclose(bar_heights(chunks["c/bars/scene/series/0"], "iteration"), shown[0].answer.mass * counts, rtol=1e-5)
    assert_allclose(bar_heights(chunks["c/bars/scene/series/1"]), shown[1].answer.mass * counts, rtol=1e-5)
    assert "c/bars/scene/series/2" not in chunks
    assert {"c/scales/bars/0/colors", "c/scales/bars/1/colors"} <= set(chunks)
    said = {
        entity.static["Points2D:labels"][0] for path, entity in chunks.items() if "legend" in path and "text" in path
    }
    assert said == {"truth", "hand", "right"}


def test_a_comparison_names_methods_and_their_nad_and_starts_with_the_truth(comparison):
    shown, chunks = comparison
    found = views(comparison_blueprint("c", shown))
    names = [str(view.name) for view in found]
    assert names[:4] == ["true mass", f"hand: NAD {100 * shown[0].nad:.1f} %", "right: NAD 0.0 %", "silent: no answer"]
    assert all(any(path.startswith(str(view.origin)) for path in chunks) for view in found)
    twelve = [block_estimate(facts={"method": f"m{i}"}) for i in range(12)]
    assert len(views(comparison_blueprint("c", twelve))) == 12 + 3


def test_what_cannot_be_compared_is_refused():
    with pytest.raises(InvalidValueError, match="at least one"):
        comparison_blueprint("c", [])
    other = EstimateShown("hammer", load_object("hammer").shape)
    with pytest.raises(InvalidValueError, match="another shape"):
        comparison_blueprint("c", [block_estimate(), other])


def test_a_mass_that_is_not_known_has_no_interval():
    shape = load_object("I2").shape
    covariance = np.diag([np.inf, *[1e-6] * (shape.n_m - 1)])
    each = MassDistribution(np.full(shape.n_m, 0.02), np.array([0.5]))
    half = EstimateShown("I2", shape, each, each, covariance).half_width
    assert half is not None
    assert np.isnan(half[0])
    assert np.isfinite(half[1:]).all()
