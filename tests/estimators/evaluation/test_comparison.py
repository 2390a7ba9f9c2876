"""Means, intervals and marks of the comparison; tables and the heatmap made of them."""

from itertools import pairwise

import numpy as np
import pytest
from numpy.testing import assert_allclose
from rich.console import Console

from estimators.evaluation import paper
from estimators.evaluation.statistics import Claims, draws_of, select, significantly_best, summarize
from testbed.objects.files import load_object
from tests.helpers.rows import row
from viz.figures.maps import absolute_difference
from viz.report.tables import METRICS, NAD, Table, claims_table, metric_table
from viz.report.terminal import rich_table

NAMES = ("L2", "hammer")


def test_a_summary_is_mean_spread_and_an_interval_that_holds_the_mean():
    rng = np.random.default_rng(0)
    covered = 0
    for _ in range(200):
        summary = summarize(dict(enumerate(rng.normal(3.0, 1.0, 30).tolist())))
        assert summary is not None
        covered += summary.low <= 3.0 <= summary.high
    assert 0.88 < covered / 200 < 0.99
    exact = summarize({0: 1.0, 1: 3.0, 2: np.nan})
    assert exact is not None
    assert (exact.count, exact.mean, exact.spread, exact.missing) == (2, 2.0, pytest.approx(2**0.5), 1)
    assert summarize({0: np.nan}) is None


@pytest.mark.parametrize(("draws", "enough"), [(1, False), (2, False), (4, False), (5, True), (8, True)])
def test_no_interval_and_no_mark_below_five_draws(draws, enough):
    best, other = ({s: mean * (1 + 0.01 * s) for s in range(draws)} for mean in (1.0, 2.0))
    summary = summarize(best | {99: np.nan})
    assert summary is not None and summary.count == draws
    assert np.isfinite([summary.low, summary.high]).all() == enough
    assert significantly_best({"a": best, "b": other}) == ("a" if enough else None)
    rows = [row(m, s, x / 100) for m, of in (("a", best), ("b", other)) for s, x in of.items()]
    text = text_of(metric_table(rows, NAD, "NAD", ["L2"]))
    assert f"NAD; {draws} draw" in " ".join(text.split())
    assert ("[1" in text) == ("*" in text) == enough


def test_the_best_is_marked_only_where_it_is_sure():
    rng = np.random.default_rng(1)
    common = rng.normal(0, 5, 8)
    draws = lambda mean, noise: dict(enumerate((20 + mean + common + noise * rng.normal(size=8)).tolist()))  # noqa: E731
    # paired: a difference of 1 stands out although each method scatters by 5
    assert significantly_best({"a": draws(0, 0.1), "b": draws(1, 0.1), "c": draws(3, 0.1)}) == "a"
    assert significantly_best({"a": draws(0, 3.0), "b": draws(0.1, 3.0)}) is None
    assert significantly_best({"a": draws(0, 0.1)}) is None
    assert significantly_best({"a": {0: 1.0}, "b": {0: 2.0}}) is None, "one draw tells nothing"
    assert significantly_best({"a": {0: 1.0, 1: 1.0}, "b": {0: 1.0, 1: 1.0}}) is None
    assert significantly_best({"a": {0: 1.0, 1: 1.5}, "b": {0: np.nan, 1: np.nan}}) is None


@pytest.mark.slow
def test_false_marks_are_rare():
    rng = np.random.default_rng(2)
    tables = [{name: dict(enumerate(rng.normal(size=6).tolist())) for name in "abc"} for _ in range(400)]
    assert sum(significantly_best(table) is not None for table in tables) < 0.1 * len(tables)


def test_rows_are_selected_and_scaled():
    rows = [row("a", 0, 0.1), row("b", 0, None), row("a", 1, 0.2)]
    assert len(select(rows, method="a", seed=1)) == 1
    assert draws_of(select(rows, method="a"), "nad", 100) == {0: 10.0, 1: 20.0}
    assert np.isnan(draws_of(select(rows, method="b"), "nad")[0])


def text_of(table: Table) -> str:
    console = Console(width=120)
    with console.capture() as captured:
        console.print(rich_table(table))
    return captured.get()


def test_a_table_has_ours_the_papers_and_the_truths():
    rows = [row("hidden_states", s, 0.01 + 0.001 * s) for s in range(5)]
    rows += [row("hidden_states_published", s, 0.1 + 0.002 * s) for s in range(5)]
    rows += [row("random_search", s, 0.4 + 0.01 * s) for s in range(5)]
    rows += [row("random_search_M", s, None) for s in range(5)]
    text = text_of(metric_table(rows, NAD, "NAD", ["L2"]))
    assert "1.2±0.2*" in text
    lines = [words for line in text.splitlines() if (words := line.split()) and words[0][0] != "["]
    figures = [(above[0], line[-1]) for above, line in pairwise(lines) if line[:2] == ["paper,", "real"]]
    assert figures == [("hidden_states_published", "7.3"), ("random_search", "46.4")], "rows of their own"
    assert "underdetermined" in text
    distance = text_of(metric_table(rows, METRICS[1], "MPD", ["L2"]))
    assert "the true masses" in distance
    assert "0.3±0.0" in distance


def test_the_papers_tables_are_whole():
    assert {name: len(row) for name, row in paper.NAD.items()} == dict.fromkeys(paper.NAD, 6)
    assert {name: len(row) for name, row in paper.MPD.items()} == dict.fromkeys(paper.NAD, 8)
    assert_allclose(sum(paper.NAD["diff_lcp"].values()), 283.3)
    assert_allclose(sum(paper.MPD["hidden_states_published"].values()), 11.6)


def test_where_m_leaves_one_unknown_the_table_of_masses_says_so():
    rows = [row("hidden_states", 0, 0.01, name) for name in NAMES]
    assert "hammer: two masses, so one unknown where M is given" in text_of(metric_table(rows, NAD, "NAD"))
    assert "unknown" not in text_of(metric_table(rows, METRICS[1], "MPD"))
    assert "unknown" not in text_of(metric_table(rows[:1], NAD, "NAD"))


@pytest.mark.slow
def test_the_heatmap_shows_every_group_of_every_object_and_method():
    rows = [row(m, s, e, name) for name in NAMES for m, e in (("good", 0.01), ("bad", 0.5)) for s in (0, 1)]
    rows += [row("silent", 0, None, name) for name in NAMES]
    shapes = {name: load_object(name).shape for name in NAMES}
    figure = absolute_difference(rows, shapes, "own weight, ft300s")
    whole, bar = figure.axes
    texts = [t.get_text() for t in whole.texts]
    assert texts[0] == "L2" and texts[7] == f"{0.5 * load_object('L2').group_mass[0]:.2f}"
    assert len(texts) == 2 + (6 + 6 + 1) + (2 + 2 + 1) + 3 and texts.count("no answer") == 2
    assert "kg" in bar.get_ylabel()
    colors = whole.collections[1].get_array()
    assert colors is not None
    assert_allclose(np.unique(colors), np.unique(0.5 * load_object("L2").group_mass))
    norms = [drawn.norm for drawn in whole.collections if drawn.get_array() is not None]
    assert len(norms) == 4 and len({(norm.vmin, norm.vmax) for norm in norms}) == 1


def test_claims_are_errors_over_claimed_ones_and_an_answer_is_silent_where_ok_and_far_off():
    true = [0.1, 0.2, 0.3]
    answers = (
        {"mass_kg": [0.1, 0.2, 0.34], "mass_error_kg": [0.01] * 3, "misfit": 0.5},
        {"mass_kg": [0.11, 0.2, 0.3], "mass_error_kg": [0.01] * 3},
        {"mass_kg": [0.1, 0.2, 0.9], "mass_error_kg": [0.1] * 3, "status": "unexplained", "misfit": 4.5},
    )
    rows = [row("a", seed, 0.1, true_mass_kg=true, **answer) for seed, answer in enumerate(answers)]
    rows += [row("a", 3, None, mass_error_kg=None), row("b", 0, 0.1)]
    found = Claims.of(rows)
    assert found is not None
    assert_allclose(found.ratio, np.sqrt((16 + 1 + 36) / 9))
    assert_allclose([found.held, found.silent], [7 / 9, 1 / 3])
    assert Claims.of(rows[3:]) is None
    unseen = Claims.of([row("a", 0, 0.1, mass_kg=[0.2, 0.1], true_mass_kg=[0.1, 0.2], mass_error_kg=[None, 0.1])])
    assert unseen is not None and unseen.held == 1 and unseen.ratio == pytest.approx(0.5**0.5)
    table = claims_table(rows)
    assert table is not None and claims_table(rows[3:]) is None
    ((labels, cells),) = table.rows
    assert labels == ("a",) and [cell.text for cell in cells] == ["2.43", "78 %", "50 %", "33 %", "2.5"]
