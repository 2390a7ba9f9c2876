"""Estimates and comparisons in Rerun: the logged values, entity by entity."""

import re
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
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
from testbed import GRAVITY, InvalidValueError, MassDistribution, ObjectShape, Trajectory, Weigh, load_object
from testbed.frames import transform_point
from tests.helpers.chunks import Entity, logged
from tests.helpers.records import turn_record
from viz.recordings.bars import filled
from viz.recordings.comparison import comparison_blueprint, log_comparison
from viz.recordings.estimate import HORIZONS, estimate_blueprint, friction_load, log_estimate
from viz.recordings.mass_map import Raster
from viz.recordings.page import ITERATION, Page
from viz.style import BACKGROUND, DIFFERENCE_COLORS, MASS_COLORS, difference_scale, mapped, mass_scale, rgb
from viz.values import MOST_FRAMES, EstimateView, evenly

pytestmark = pytest.mark.slow

ITERATIONS = 500
OFF = np.array([1.013, 1.217, 0.731, 0.977, 1.411, 0.893])
DEVIATION = 1e-3 * np.array([1.0, 2.0, 3.0, 4.0, np.inf, np.nan])
PACK = np.array([1 << 24, 1 << 16, 1 << 8], dtype=np.int64)


@pytest.fixture(autouse=True)
def _strict() -> Iterator[None]:
    """Rerun's warnings are errors here."""
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


def block_estimate(**changes: Any) -> EstimateView:
    """L2: two runs of an optimiser, a covariance, a turn."""
    model = load_object("L2")
    answer = MassDistribution(model.truth.mass * OFF, np.array([0.45]))
    uniform = np.full(6, model.truth.mass.mean())
    traces = trace("adam", uniform, 1.01 * answer.mass), trace("plain", uniform, uniform, 7)
    view = EstimateView(
        "L2: by hand", model.shape, model.truth, answer, np.diag(DEVIATION**2), traces, turn(model.shape),
        {"method": "hand", "status": "ok"},
    )  # fmt: skip
    return replace(view, **changes)


def recorded(path: Path, log: Callable[..., None], blueprint: Callable[..., Any], values: Any) -> dict[str, Entity]:
    """Entities of a recording of `values` below "e"."""
    return logged(Page("e", "e", lambda stream: log(stream, "e", values), blueprint("e", values), ITERATION), path)


@pytest.fixture(scope="module")
def blocks(tmp_path_factory: pytest.TempPathFactory) -> tuple[EstimateView, dict[str, Entity]]:
    """An estimate and its recording."""
    view = block_estimate()
    return view, recorded(tmp_path_factory.mktemp("view") / "e.rrd", log_estimate, estimate_blueprint, view)


def pixels(entity: Entity, buffer: list) -> np.ndarray:
    """An image, (H, W, 3), the lowest row first."""
    look = entity.static["Image:format"][0]
    return np.array(buffer[0], dtype=np.uint8).reshape(look["height"], look["width"], 3)


def colors_of_groups(shape: ObjectShape, entity: Entity, buffer: list) -> np.ndarray:
    """Color of each mass group in an image, (n_m, 3), where all its particles have the same; else fails."""
    image = pixels(entity, buffer)
    place = entity.static["Transform3D:translation"][0], entity.static["Transform3D:scale"][0]
    found: dict[int, set] = {}
    for (x, y), group in zip(shape.particles, shape.mass_group, strict=True):
        column, row = (int((value - p) // s) for value, p, s in zip((x, y), *place, strict=False))
        found.setdefault(int(group), set()).add(tuple(image[row, column]))
    assert all(len(colors) == 1 for colors in found.values())
    return np.array([next(iter(found[group])) for group in range(shape.n_m)])


def at_end(entities: dict[str, Entity], path: str, timeline: str | None = "iteration") -> np.ndarray:
    """Colors of the groups of L2 at the end of a timeline; None for a static image."""
    entity = entities[f"{path}/cells"]
    buffer = entity.at_end("Image:buffer", timeline) if timeline else entity.static["Image:buffer"]
    return colors_of_groups(load_object("L2").shape, entity, buffer)


MAP = ("cells", "outlines", "bar/colors", "bar/ticks", "bar/outline", "bar/title", "groups/names", "groups/masses")
ENTITIES = {
    *(f"e/{name}/object/{part}" for name in ("true_mass", "estimated_mass", "difference") for part in MAP),
    *(f"e/bars/scene/{part}" for part in ("truth", "series/0", "intervals/0", "names", "ticks", "grid", "legend/0")),
    *(f"e/loads/scene/{part}" for part in ("particles", "true_load", "outlines", "bar/colors", "key")),
    *(f"e/turn/scene/object/{part}" for part in ("outline", "particles", "velocity", "object_velocity", "pads")),
    "e/facts", "e/loss/0", "e/loss/1", "e/mass_by_iteration", "e/turn/scene/key",
}  # fmt: skip


def test_every_entity_is_static_or_on_both_timelines(blocks):
    _, entities = blocks
    assert set(entities) >= ENTITIES
    assert {timeline for entity in entities.values() for timeline in entity.times} == {"iteration", "sim_time"}
    for path, entity in entities.items():
        if entity.times and not path.startswith("e/loss"):
            assert set(entity.times) == {"iteration", "sim_time"}, f"{path} would vanish on the other timeline"
        for components in entity.times.values():
            for component, times in components.items():
                assert len(times) <= (ITERATIONS if path.startswith("e/loss") else MOST_FRAMES), component
                assert (np.diff(times) > 0).all()


WITHOUT = [
    ({"traces": (), "covariance": None, "trajectory": None}, {"e/loss", "e/turn", "e/bars/scene/intervals"}),
    (
        {"answer": None, "traces": (), "covariance": None},
        {"e/loss", "e/loads", "e/mass_by_iteration", "e/bars/scene/series", "e/bars/scene/intervals"},
    ),
    ({"truth": None}, {"e/true_mass", "e/difference", "e/bars/scene/truth", "e/loads/scene/true_load"}),
    ({"trajectory": replace(turn(load_object("L2").shape), action=Weigh())}, {"e/turn"}),
]


@pytest.mark.parametrize(("changes", "absent"), WITHOUT, ids=["answer alone", "no answer", "no truth", "weighing"])
def test_parts_that_are_not_known_are_left_out(tmp_path, changes, absent):
    view = block_estimate(facts={"why": "too few turns"}, **changes)
    entities = recorded(tmp_path / "a.rrd", log_estimate, estimate_blueprint, view)
    assert not {path for path in entities if path.startswith(tuple(absent))}
    kept = {path for path in ENTITIES if not path.startswith(tuple(absent))}
    gone = {path for path in kept if "/groups/" in path} if view.answer is None else set()
    assert kept - gone <= set(entities)
    assert "too few turns" in entities["e/facts"].static["TextDocument:text"][0]
    moving = {path for path, entity in entities.items() if entity.times}
    assert bool(moving) == bool(view.traces or view.trajectory), "without iterations and time all is static"
    if view.answer is None:
        assert entities["e/estimated_mass/object/groups"].static["Points2D:labels"] == ["no answer"]
    for each in views(estimate_blueprint("e", view)):
        assert any(path.startswith(str(each.origin)) for path in entities), each.origin


def test_maps_go_from_the_first_guess_to_the_answer_on_one_scale(blocks):
    view, entities = blocks
    counts = view.shape.particles_per_group
    top, off_top = mass_scale([view]).top, difference_scale([view]).top
    assert top == pytest.approx((view.answer.mass * counts).max())
    assert off_top == pytest.approx(np.abs((view.answer.mass - view.truth.mass) * counts).max())
    truth = at_end(entities, "e/true_mass/object", None)
    assert_array_equal(truth, mapped(view.truth.mass * counts, top, MASS_COLORS))
    estimate, difference = (entities[f"e/{name}/object/cells"] for name in ("estimated_mass", "difference"))
    times, frames = estimate.times["iteration"]["Image:buffer"], estimate.values["iteration"]["Image:buffer"]
    assert_array_equal(times[[0, -2, -1]], [0, ITERATIONS - 1, ITERATIONS])
    for index in (0, 57, len(times) - 2, len(times) - 1):
        at = int(times[index])
        mass = counts * (view.traces[0].mass[at] if at < ITERATIONS else view.answer.mass)
        off = np.abs(mass - view.truth.mass * counts)
        read = colors_of_groups(view.shape, estimate, frames[index])
        assert_array_equal(read, mapped(mass, top, MASS_COLORS))
        read = colors_of_groups(view.shape, difference, difference.values["iteration"]["Image:buffer"][index])
        assert_array_equal(read, mapped(off, off_top, DIFFERENCE_COLORS))
    assert estimate.values["sim_time"]["Image:buffer"] == frames[-1:], "on the other timeline the answer stands"
    assert_array_equal(pixels(estimate, frames[-1])[-1, -1], rgb(BACKGROUND))


def test_cells_have_names_and_numbers_and_y_is_up(blocks):
    view, entities = blocks
    root = "e/estimated_mass/object"
    object_frame = entities[root].static["Transform3D:mat3x3"][0]
    assert_allclose(np.array(object_frame).reshape(3, 3), np.diag([1, -1, 1]))  # Rerun's planar views have y down
    names, masses = entities[f"{root}/groups/names"], entities[f"{root}/groups/masses"]
    assert names.static["Points2D:labels"] == list(view.shape.group_names)
    expected = [f"{value:.2f}" for value in view.answer.mass * view.shape.particles_per_group]
    assert masses.at_end("Points2D:labels") == expected
    heights = dict(zip(view.shape.group_names, np.array(names.static["Points2D:positions"])[:, 1], strict=True))
    assert heights["A4"] > heights["A1"]
    ticks = entities[f"{root}/bar/ticks"].static
    assert ticks["Points2D:labels"][-1].startswith("≥"), "iterates were larger than the answer"
    at = np.array([float(text.removeprefix("≥ ")) for text in ticks["Points2D:labels"]])
    x = np.array(ticks["Points2D:positions"])[:, 0]
    bar = entities[f"{root}/bar/outline"].static["LineStrips2D:strips"][0]
    left, right = np.min(bar, axis=0)[0], np.max(bar, axis=0)[0]
    assert_allclose((x - left) / (right - left), at / mass_scale([view]).top, atol=0.01)
    assert "kg" in entities[f"{root}/bar/title"].static["Points2D:labels"][0]


def bar_heights(entity: Entity, timeline: str | None = None, frame: int = -1) -> np.ndarray:
    """Heights of the strokes' outer edges [kg]."""
    at = entity.static if timeline is None else {k: v[frame] for k, v in entity.values[timeline].items()}
    strips, radii = at["LineStrips2D:strips"], at["LineStrips2D:radii"]
    return np.array([max(y for _, y in strip) + radius for strip, radius in zip(strips, radii, strict=True)])


def test_bars_are_the_masses_and_intervals_the_covariance(blocks):
    view, entities = blocks
    counts = view.shape.particles_per_group
    bars = entities["e/bars/scene/series/0"]
    for timeline, frame, mass in (
        ("iteration", -1, view.answer.mass),
        ("sim_time", -1, view.answer.mass),
        ("iteration", 0, view.traces[0].mass[0]),
    ):
        assert_allclose(bar_heights(bars, timeline, frame), mass * counts, rtol=1e-5)
    assert_allclose(bar_heights(entities["e/bars/scene/truth"]), view.truth.mass * counts, rtol=1e-5)
    lines = np.array(entities["e/bars/scene/intervals/0"].static["LineStrips2D:strips"])
    upright = lines[np.abs(lines[:, 0, 0] - lines[:, 1, 0]) < 1e-9]
    assert len(upright) == 4, "a variance that is infinite or not known has no interval"
    assert_allclose(np.diff(upright[:, :, 1]).ravel(), 2 * 1.645 * DEVIATION[:4] * counts[:4], rtol=1e-4)
    assert_allclose(upright[:, :, 1].mean(axis=1), (view.answer.mass * counts)[:4], rtol=1e-5)


@given(st.floats(0, 3), st.floats(0.01, 1), st.floats(0.001, 0.02))
def test_a_filled_bar_covers_its_rectangle_and_no_more(height: float, width: float, stroke: float):
    lines, radii = filled(np.array([1.0]), np.array([1.0 + width]), np.array([[height]]), stroke)
    line, radius = lines[0, 0], float(radii[0, 0])
    low, high = line.min(axis=0) - radius, line.max(axis=0) + radius
    assert_allclose((*low, *high), (1.0, 0.0, 1.0 + width, height), atol=1e-9)
    assert np.diff(np.unique(line[:, 0])).max(initial=0.0) <= 2 * max(radius, stroke) + 1e-9


def test_losses_and_masses_can_be_read_back(blocks):
    view, entities = blocks
    for index, each in enumerate(view.traces):
        entity = entities[f"e/loss/{index}"]
        assert entity.static["SeriesLines:names"] == [each.method]
        loss = np.array(entity.values["iteration"]["Scalars:scalars"], dtype=float).ravel()
        assert_allclose(10 ** loss[:-1], each.loss[:-1], rtol=1e-9)
        assert np.isnan(loss[-1]), "no logarithm of 0"
        assert_array_equal(entity.times["iteration"]["Scalars:scalars"], np.arange(len(each.loss)))
    masses = entities["e/mass_by_iteration"]
    assert masses.static["SeriesLines:names"] == list(view.shape.group_names)
    assert_allclose(masses.at_end("Scalars:scalars"), view.answer.mass * view.shape.particles_per_group)


def test_discs_are_as_large_as_friction_loads(blocks):
    view, entities = blocks
    particles, rings = entities["e/loads/scene/particles"], entities["e/loads/scene/true_load"]
    assert_allclose(particles.static["Points2D:positions"], view.shape.particles, atol=1e-6)
    load, true_load = (
        each.friction[0] * each.mass[view.shape.mass_group] * GRAVITY for each in (view.answer, view.truth)
    )
    area = np.array(particles.at_end("Points2D:radii")) ** 2
    true_area = np.array(rings.static["Ellipses2D:half_sizes"])[:, 0] ** 2
    big = load > 0.1 * load.max()  # the smallest discs are drawn larger, so that their color is visible
    assert_allclose(area[big] / area.max(), load[big] / load.max(), rtol=1e-5)
    assert_allclose(true_area / area.max(), true_load / load.max(), rtol=1e-5)
    top = max(view.answer.mass.max(), view.truth.mass.max())
    packed = mapped(view.answer.mass[view.shape.mass_group], top, MASS_COLORS).astype(np.int64) @ PACK + 255
    assert_array_equal(particles.at_end("Points2D:colors"), packed)


FEET = """name = "feet"
[blocks]
layout = ["111"]
mass_kg = [0.2, 0.3, 0.4]
friction = 0.4
[feet]
under_each_m = [[-0.015, -0.015], [0.015, -0.015], [0.0, 0.015]]
"""


@pytest.mark.parametrize("name", ["L2", "hammer", "wrench", "feet"])
def test_loads_add_up_to_those_of_the_groups(name, tmp_path):
    (path := tmp_path / "feet.toml").write_text(FEET, encoding="utf-8")
    obj = load_object(path if name == "feet" else name)
    found = friction_load(obj.shape, obj.truth.mass, obj.truth.friction)
    of_group = np.bincount(obj.shape.mass_group, found, obj.shape.n_m)
    of = [obj.shape.friction_group[obj.shape.mass_group == group].max() for group in range(obj.shape.n_m)]
    friction = obj.truth.friction[of]
    assert_allclose(of_group, friction * obj.group_mass * GRAVITY)


def test_arrows_are_the_particles_velocities(blocks):
    view, entities = blocks
    trajectory, body = view.trajectory, entities["e/turn/scene/object"]
    times = body.times["sim_time"]["Transform3D:translation"]
    at = np.searchsorted(trajectory.time_s, times - 1e-6)
    assert_allclose(trajectory.time_s[at], times, atol=1e-9)
    assert_array_equal(at[[0, -1]], [0, len(trajectory.time_s) - 1])
    place = np.array(body.values["sim_time"]["Transform3D:translation"])[:, 0]
    turned = np.array(body.values["sim_time"]["Transform3D:quaternion"])[:, 0]
    yaw = 2 * np.arctan2(turned[:, 2], turned[:, 3])
    assert_allclose(place[:, :2], trajectory.object_pose[at, :2], atol=1e-6)
    assert_allclose(yaw, trajectory.object_pose[at, 2], atol=1e-5)
    arrows = entities["e/turn/scene/object/velocity"]
    points = np.array(arrows.static["Arrows2D:origins"])
    ways = np.array(arrows.values["sim_time"]["Arrows2D:vectors"])
    # an arrow, in the world, is a round multiple of the rate at which the particle's place in the world changes
    places = transform_point(trajectory.object_pose[:, None], points[None])
    fast = np.gradient(places, trajectory.time_s, axis=0)[at]
    drawn = transform_point(np.column_stack([np.zeros((len(at), 2)), yaw])[:, None], ways)
    horizon = float((drawn * fast).sum() / (fast**2).sum())
    round_one = min(HORIZONS, key=lambda each: abs(each - horizon))
    assert horizon == pytest.approx(round_one, rel=1e-3)
    assert f"motion in {round_one:g} s" in entities["e/turn/scene/key"].static["Points2D:labels"][0]
    assert_allclose(drawn[2:-2], horizon * fast[2:-2], atol=2e-4)
    still = np.linalg.norm(points - view.shape.grasps[1].position, axis=1).argmin()
    assert np.linalg.norm(ways[:, still], axis=-1).max() < 0.1 * np.linalg.norm(ways, axis=-1).max()


def test_an_object_of_a_hundred_particles_with_a_mass_each(tmp_path):
    hammer = load_object("hammer").shape
    count = len(hammer.particles)
    shape = ObjectShape(hammer.particles, np.arange(count), np.zeros(count, int), hammer.cell, hammer.height)
    truth = MassDistribution(np.linspace(0.01, 0.02, count), np.array([0.5]))
    answer = MassDistribution(truth.mass[::-1], np.array([0.5]))
    view = EstimateView("hammer", shape, truth, answer, traces=(trace("adam", truth.mass, answer.mass, 50),))
    entities = recorded(tmp_path / "h.rrd", log_estimate, estimate_blueprint, view)
    cells = entities["e/estimated_mass/object/cells"]
    read = colors_of_groups(shape, cells, cells.at_end("Image:buffer"))
    assert_array_equal(read, mapped(answer.mass, mass_scale([view]).top, MASS_COLORS))
    assert "e/estimated_mass/object/groups/masses" not in entities, "there is no room for a hundred numbers"
    assert len(entities["e/bars/scene/names"].static["Points2D:labels"]) <= 40


SHIFTED = ObjectShape(np.array([[0.0, 0.0], [0.01, 0.005]]), np.arange(2), np.zeros(2, int), 0.01, 0.03)


@pytest.mark.parametrize("name", ["L2", "I1", "hammer", "wrench", "shifted"])
def test_a_raster_has_every_particle_once_and_outlines_only_at_borders(name):
    shape = SHIFTED if name == "shifted" else load_object(name).shape
    raster = Raster.of(shape)
    pixels_a_cell = round(shape.cell / raster.pixel) ** 2
    assert pixels_a_cell == (16 if name == "shifted" else 1)
    assert_array_equal(np.bincount(raster.group[raster.group >= 0]), pixels_a_cell * shape.particles_per_group)
    length = sum(float(np.abs(line[1] - line[0]).sum()) for line in raster.outlines())
    inside = np.pad(raster.group, 1, constant_values=-1)
    borders = (inside[1:] != inside[:-1]).sum() + (inside[:, 1:] != inside[:, :-1]).sum()
    assert length == pytest.approx(borders * raster.pixel)


def views(part: Any) -> list[Any]:
    """Every view of a container."""
    return [part] if isinstance(part, rrb.View) else [view for each in part.contents for view in views(each)]


def test_facts_are_text_whatever_they_hold(tmp_path):
    view = block_estimate(title="a|b *c*", facts={"why": "x | y <script>", "empty": ""})
    entities = recorded(tmp_path / "f.rrd", log_estimate, estimate_blueprint, view)
    text = entities["e/facts"].static["TextDocument:text"][0]
    assert view.nad is not None
    for part in ("a\\|b \\*c\\*", "x \\| y \\<script\\>", f"| NAD | {100 * view.nad:.2f} % |"):
        assert part in text
    assert "empty" not in text


@pytest.mark.parametrize(
    ("call", "field"),
    [
        *(
            (partial(block_estimate, **{field.partition(".")[0]: value}), rf"EstimateView\.{re.escape(field)}")
            for field, value in (
                ("truth.mass", MassDistribution(np.ones(5), np.ones(1))),
                ("answer.friction", MassDistribution(np.ones(6), np.ones(2))),
                ("covariance", np.eye(5)),
                ("traces.adam", (trace("adam", np.ones(5), np.ones(5)),)),
            )
        ),
        (lambda: comparison_blueprint("e", []), "views.*at least one"),
        (
            lambda: comparison_blueprint("e", [block_estimate(), EstimateView("h", load_object("hammer").shape)]),
            "views.*another shape",
        ),
    ],
)
def test_values_and_shapes_that_do_not_fit_are_refused(call, field):
    with pytest.raises(InvalidValueError, match=rf"^{field}"):
        call()


@given(st.integers(1, 3000), st.integers(2, 200))
def test_few_of_many_have_the_first_and_the_last(count: int, most: int):
    kept = evenly(count, most)
    assert (kept[0], kept[-1]) == (0, count - 1)
    assert len(kept) <= most
    assert (np.diff(kept) > 0).all()


@pytest.fixture(scope="module")
def comparison(tmp_path_factory: pytest.TempPathFactory) -> tuple[list[EstimateView], dict[str, Entity]]:
    """Three methods: one with iterations, one without, one without an answer."""
    right = block_estimate(answer=block_estimate().truth, traces=(), facts={"method": "right"})
    silent = block_estimate(answer=None, traces=(), facts={"method": "silent"})
    methods = [block_estimate(), right, silent]
    path = tmp_path_factory.mktemp("view") / "comparison.rrd"
    return methods, recorded(path, log_comparison, comparison_blueprint, methods)


def test_a_comparison_has_every_method_on_the_same_scales(comparison):
    methods, entities = comparison
    counts = methods[0].shape.particles_per_group
    hand, truth = methods[0].answer.mass * counts, methods[0].truth.mass * counts
    top = max(truth.max(), np.percentile([hand, truth], 95))
    for path, timeline, values, end, colors in (
        ("truth/mass", None, truth, top, MASS_COLORS),
        ("methods/0/mass", "iteration", hand, top, MASS_COLORS),
        ("methods/1/mass", None, truth, top, MASS_COLORS),
        ("methods/1/difference", None, np.zeros(6), 1.0, DIFFERENCE_COLORS),
    ):
        assert_array_equal(at_end(entities, f"e/{path}", timeline), mapped(values, end, colors))
    assert entities["e/methods/2/mass/groups"].static["Points2D:labels"] == ["no answer"]
    assert_allclose(bar_heights(entities["e/bars/scene/series/0"], "iteration"), hand, rtol=1e-5)
    assert_allclose(bar_heights(entities["e/bars/scene/series/1"]), truth, rtol=1e-5)
    assert "e/bars/scene/series/2" not in entities
    assert {"e/scales/bars/0/colors", "e/scales/bars/1/colors"} <= set(entities)
    legend = [f"e/bars/scene/legend/{index}/text" for index in range(3)]
    assert [entities[path].static["Points2D:labels"][0] for path in legend] == ["truth", "hand", "right"]


def test_a_comparison_names_methods_and_their_nad_and_starts_with_the_truth(comparison):
    methods, entities = comparison
    found = views(comparison_blueprint("e", methods))
    names = [str(view.name) for view in found]
    hand = f"hand: NAD {100 * methods[0].nad:.1f} %"
    assert names[:4] == ["true mass", hand, "right: NAD 0.0 %", "silent: no answer"]
    assert all(any(path.startswith(str(view.origin)) for path in entities) for view in found)
    twelve = [block_estimate(facts={"method": f"m{i}"}) for i in range(12)]
    assert len(views(comparison_blueprint("e", twelve))) == 12 + 3
