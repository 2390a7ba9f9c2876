"""Figures for papers: drawn values, units on every axis, and whole files."""

import re
import resource
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure
from numpy.testing import assert_allclose, assert_array_equal

from estimators.base import Trace
from scenarios.results.estimates import load_results
from scenarios.results.table import rows_of
from scenarios.views.figures import figures, file_name
from testbed import InvalidValueError, MassDistribution, load_object
from viz import EstimateView, WrenchFit, estimate_bars
from viz.figures.loss import estimate_losses
from viz.figures.maps import MeanAnswer, estimate_maps, map_scales, mass_maps, save_figure
from viz.figures.nad import MANY, axis_label, nad_distribution, nad_sweep
from viz.figures.wrench import wrench_fit_figure
from viz.style import DIFFERENCE_COLORS, MASS_COLORS, series_color, text_color

UNITS = re.compile(r", (kg|kg per group|N|N m|N/m|m|s|%)$")
WITHOUT_UNIT = {"iteration", "loss", "group", "loss over first loss", "truth.friction", "k"}


def test_colors_differ_and_text_is_legible():
    assert len({series_color(i) for i in range(12)}) == 12
    assert_array_equal(text_color(np.array([[255, 255, 255], [0, 0, 80]], dtype=np.uint8)), [[0] * 3, [255] * 3])
    for name in (MASS_COLORS, DIFFERENCE_COLORS):
        light = np.diff(mpl.colormaps[name](np.linspace(0, 1, 64))[:, :3] @ [0.299, 0.587, 0.114])
        assert abs(np.sign(light).sum()) == len(light), "lightness goes one way"


def check_units(figure: Figure) -> None:
    """Raises where an axis with numbers does not say what they are."""
    figure.draw_without_rendering()
    for axis in figure.axes:
        for each in (axis.xaxis, axis.yaxis):
            numbers = [t.get_text() for t in each.get_ticklabels() if t.get_visible() and t.get_text()]
            drawn = each.get_visible() and axis.get_visible() and any(re.search(r"\d", text) for text in numbers)
            if drawn and any(tick.label1.get_visible() or tick.label2.get_visible() for tick in each.get_major_ticks()):
                label = each.get_label_text()
                assert UNITS.search(label) or label in WITHOUT_UNIT, f"{label!r} beside {numbers}"


def estimate(**changes: Any) -> EstimateView:
    """L2 with a covariance and two traces."""
    model = load_object("L2")
    answer = MassDistribution(model.truth.mass * [1.0, 1.2, 0.7, 1.0, 1.4, 0.9], np.array([0.45]))
    traces = tuple(
        Trace(name, tuple(np.geomspace(1, 1e-4, count).tolist()), tuple(range(count)), 1.0, np.zeros((0, 0)))
        for name, count in (("adam", 50), ("plain", 20))
    )
    deviation = 1e-3 * np.arange(1, 7)
    view = EstimateView("L2: by hand", model.shape, model.truth, answer, np.diag(deviation**2), traces)
    return replace(view, **changes)


def test_maps_have_the_truth_the_answer_and_the_difference():
    view = estimate()
    assert view.mass is not None and view.true_mass is not None
    figure = estimate_maps(view)
    check_units(figure)
    titles = ("true mass", "estimated mass", "absolute difference")
    expected = (view.true_mass, view.mass, np.abs(view.mass - view.true_mass))
    tops = (view.mass.max(), view.mass.max(), expected[2].max())
    colors = (MASS_COLORS, MASS_COLORS, DIFFERENCE_COLORS)
    for axis, title, values, top, color in zip(figure.axes[:3], titles, expected, tops, colors, strict=True):
        assert axis.get_title() == title
        (cells,) = axis.collections
        assert_allclose(np.asarray(cells.get_array()), values[view.shape.mass_group])
        assert [float(text.get_text()) for text in axis.texts] == pytest.approx(values, abs=0.006)
        assert (cells.get_clim(), cells.get_cmap().name) == ((0.0, pytest.approx(top)), color)
        assert axis.get_ylim()[0] < axis.get_ylim()[1], "y is up"
    assert [axis.get_xlabel() for axis in figure.axes[3:]] == ["mass, kg per group", "|difference|, kg per group"]


def test_maps_without_a_truth_or_an_answer():
    alone = estimate_maps(estimate(truth=None))
    assert [axis.get_title() for axis in alone.axes] == ["estimated mass", ""]
    silent = estimate_maps(estimate(answer=None, covariance=None))
    assert [[text.get_text() for text in axis.texts] for axis in silent.axes[1:3]] == [["no answer"]] * 2
    check_units(silent)


def test_bars_are_the_masses_with_their_intervals():
    view = estimate()
    figure = estimate_bars(view)
    check_units(figure)
    truth, answer = (container for container in figure.axes[0].containers if hasattr(container, "patches"))
    assert view.true_mass is not None and view.mass is not None
    for bars, mass in ((truth, view.true_mass), (answer, view.mass)):
        assert_allclose([bar.get_height() for bar in bars.patches], mass)
    lines = np.array(figure.axes[0].collections[0].get_segments())  # pyright: ignore[reportAttributeAccessIssue]
    deviation = 1e-3 * np.arange(1, 7) * view.shape.particles_per_group
    assert_allclose(lines[:, 1, 1] - lines[:, 0, 1], 2 * 1.645 * deviation)
    assert [tick.get_text() for tick in figure.axes[0].get_xticklabels()] == list(view.shape.group_names)


def test_losses_are_the_traces():
    view = estimate()
    figure = estimate_losses(view)
    assert figure is not None
    check_units(figure)
    for line, trace in zip(figure.axes[0].lines, view.traces, strict=True):
        assert line.get_label() == trace.method
        assert_allclose(np.asarray(line.get_ydata(), dtype=float), trace.loss)
    assert estimate_losses(estimate(traces=())) is None


def fit(label: str, offset: float, count: int = 400) -> WrenchFit:
    """A trial in which the second and third quarter are steady, and measured `offset` beside the prediction."""
    time = np.arange(count) / 100
    steady = (np.arange(count) // (count // 4) % 3) > 0
    level = np.array([3.0, -2.0, 0.5])
    predicted = np.where(steady[:, None], level, np.nan)
    measured = np.where(steady[:, None], level + offset, 0.1)
    return WrenchFit(label, time, measured, steady, predicted, np.full((count, 3), 0.2))


@pytest.mark.slow
def test_wrench_fits_show_measured_predicted_band_and_what_is_off():
    fits = [fit("turn about A1", 0.05), fit("slide", -0.1, 4000)]
    figure = wrench_fit_figure(fits)
    check_units(figure)
    axes = np.array(figure.axes).reshape(6, 2)
    for column, each in enumerate(fits):
        assert axes[0, column].get_title() == each.label
        for row in range(3):
            values, off = axes[2 * row, column], axes[2 * row + 1, column]
            rest, steady, predicted = values.lines
            assert_array_equal(np.unique(steady.get_ydata()), [each.measured[each.steady][0, row]])
            assert_array_equal(np.unique(rest.get_ydata()), [0.1])
            drawn = np.asarray(predicted.get_ydata(), dtype=float)
            assert_array_equal(np.isfinite(drawn), each.steady)
            assert_allclose(off.lines[0].get_ydata(), 0.05 if column == 0 else -0.1)
            band = values.collections[0].get_datalim(values.transData)
            assert (band.y0, band.y1) == pytest.approx(each.predicted[each.steady][0, row] + np.array([-0.2, 0.2]))
            low, high = values.get_ylim()
            assert low < each.measured[each.steady][0, row] < high
    for row in axes:
        assert row[0].get_ylim() == row[1].get_ylim()
    with pytest.raises(InvalidValueError, match="at least one"):
        wrench_fit_figure([])
    check_units(wrench_fit_figure([replace(fits[0], predicted=np.full((400, 3), np.nan))]))


def test_nad_against_a_setting_alone():
    rows = [
        {
            "object": "L2",
            "method": m,
            "kind": m,
            "nad": base * k * (1 + 0.01 * seed),
            "seed": seed,
            "axis.truth.friction": k / 10,
        }
        for m, base in (("a", 0.01), ("b", 0.2))
        for k in (1, 2, 4)
        for seed in (0, 1, 2)
    ]
    figure = nad_sweep(rows, "axis.truth.friction")
    check_units(figure)
    for line, base in zip(figure.axes[0].lines, (0.01, 0.2), strict=True):
        assert_allclose(np.asarray(line.get_xdata(), dtype=float), [0.1, 0.2, 0.4])
        assert_allclose(np.asarray(line.get_ydata(), dtype=float), 100 * base * 1.01 * np.array([1, 2, 4]))
    check_units(nad_distribution(rows))
    for count in (MANY, MANY + 1):
        (points,) = nad_distribution([rows[0]] * count).axes[0].collections[:1]
        assert ((points.get_alpha() or 1.0) < 0.5) == points.get_rasterized() == (count > MANY)
    for name, unit in {"support": ", N/m", "simulation.grip_N": ", N", "policy.duration": ", s", "feet": ""}.items():
        assert axis_label(f"axis.{name}") == f"{name}{unit}"


def test_nad_at_each_of_many_words_has_a_line_a_word():
    words = [f"source {k}" for k in range(12)]
    rows = [
        {"object": "L2", "method": m, "kind": m, "nad": base * (k + 1), "seed": 0, "axis.world.only": word}
        for m, base in (("a", 0.01), ("b", 0.02))
        for k, word in enumerate(words)
    ]
    (axis,) = nad_sweep(rows, "axis.world.only").axes
    assert [label.get_text() for label in axis.get_yticklabels()] == words
    for line, base in zip(axis.lines, (0.01, 0.02), strict=True):
        assert_allclose(np.asarray(line.get_xdata(), dtype=float), 100 * base * np.arange(1, 13))
    assert_allclose([patch.get_width() for patch in axis.patches], np.arange(1, 13))


@pytest.mark.slow
def test_files_are_whole_and_the_same_again(tmp_path, monkeypatch):
    first = save_figure(estimate_bars(estimate()), tmp_path / "a.b" / "bars.v1")
    assert [path.name for path in first] == ["bars.v1.pdf", "bars.v1.png"]
    pdf, png = (path.read_bytes() for path in first)
    assert pdf.startswith(b"%PDF")
    assert b"/FontFile2" in pdf, "text stays text, in a font that a publisher takes"
    assert png.startswith(b"\x89PNG")
    again = save_figure(estimate_bars(estimate()), tmp_path / "again.png")
    assert [path.name for path in again] == ["again.pdf", "again.png"]
    assert [path.read_bytes() for path in again] == [pdf, png]
    broken = estimate_bars(estimate())
    monkeypatch.setattr(broken, "savefig", lambda content, **_: content.write(b"half") and 1 / 0)
    with pytest.raises(ZeroDivisionError):
        save_figure(broken, tmp_path / "deep" / "broken")
    assert not (tmp_path / "deep").exists()
    assert file_name("nad_against support 10 N/m, ft300s/..") == "nad_against_support_10_N_per_m_ft300s_per"


def test_a_figure_that_finds_no_room_says_so(tmp_path: Path):
    limit = resource.getrlimit(resource.RLIMIT_FSIZE)
    figure = estimate_bars(estimate())
    resource.setrlimit(resource.RLIMIT_FSIZE, (2000, limit[1]))
    try:
        with pytest.raises(OSError, match="File too large") as error:
            save_figure(figure, tmp_path / "bars")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limit)
    assert error.value.filename == str(tmp_path / "bars.pdf")
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_figures_of_a_folder_and_of_an_estimate(finished_run, tmp_path):
    folder = shutil.copytree(finished_run, tmp_path / "out")
    written = figures(folder)
    names = {"nad_own_weight_ft300s", "absolute_difference_own_weight_ft300s", "loss_explicit_state"}
    assert {path.stem for path in written} == names
    row = next(row for row in rows_of(load_results(folder)) if row["kind"] == "explicit_state")
    of_one = figures(folder, row)
    start = f"I2_explicit_state_{row['key'][:8]}"
    pages = {"maps", "bars", "loss", "wrenches_1", "wrenches_2"}
    assert {path.stem for path in of_one} == {f"{start}_{page}" for page in pages}
    for path in written + of_one:
        assert path.parent == folder / "figures"
        assert path.read_bytes().startswith(b"%PDF" if path.suffix == ".pdf" else b"\x89PNG")
    assert not list(folder.rglob("*.part"))


def test_maps_of_all_objects_share_one_scale_that_a_heavy_group_does_not_bleach():
    light, heavy = np.full(40, 0.4), np.array([1.3, 0.1])
    answers = [MeanAnswer("a", truth * 1.1, truth * 0.1) for truth in (light, heavy)]
    mass, off = map_scales([light, heavy], answers)
    assert (mass.top, off.top) == (pytest.approx(0.44), pytest.approx(0.04))
    shape = load_object("L2").shape
    for truth in (np.full(6, 0.4), np.full(6, 0.1)):
        figure = mass_maps(shape, truth, {"own weight": [MeanAnswer("a", truth, 0 * truth)]}, (mass, off))
        drawn = [cells for axis in figure.axes for cells in axis.collections if isinstance(cells, PolyCollection)]
        limits = [cells.get_clim() for cells in drawn if cells.get_array() is not None]
        np.testing.assert_allclose(limits, [(0, mass.top), (0, mass.top), (0, off.top)])
