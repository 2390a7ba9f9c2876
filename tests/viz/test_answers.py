"""Pages of an object, of answers side by side, of their maps and of a plan."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from estimators.base import Estimate
from scenarios.cli.main import main
from scenarios.views.answers import support_verdict
from testbed import Action, Lift, MassDistribution, Rotate, Slide, load_object
from tests.helpers.chunks import read_chunks, verify
from viz.figures.plan import plan_figure
from viz.report.answer_maps import answer_maps
from viz.report.answers import Answer, answer_fields, answer_rows, answer_table
from viz.report.mass_map import WIDEST, mass_map
from viz.values import PlanView

WRENCH = load_object("wrench")
"""Its particles are filled unevenly."""
COUNT = WRENCH.shape.particles_per_group
L2 = load_object("L2")


def answer(covariance: np.ndarray | None, mass: np.ndarray = WRENCH.truth.mass) -> Answer:
    found = MassDistribution(mass, np.array([0.4]))
    return Answer("wrench", "own_weight", "m", "ok", "", WRENCH.shape, found, covariance, 1.2, "own weight", "")


def right(covariance: np.ndarray | None) -> Answer:
    """The true masses of L2."""
    return Answer("L2", "own_weight", "hidden_states", "ok", "", L2.shape, L2.truth, covariance, 1.0, "own weight", "")


def test_center_and_sum_have_the_errors_that_the_masses_give_them():
    rng = np.random.default_rng(0)
    root = 1e-3 * WRENCH.truth.mass * rng.standard_normal((len(COUNT), len(COUNT)))
    named = {q.name: q for q in answer(root @ root.T).quantities}
    particle_center = WRENCH.particle_mass @ WRENCH.shape.particles / WRENCH.particle_mass.sum()
    assert_allclose([named["center x"].value, named["center y"].value], particle_center, atol=1e-12)
    draws = WRENCH.truth.mass + rng.standard_normal((400, len(COUNT))) @ root.T
    each = [{q.name: q.value for q in answer(None, mass).quantities} for mass in draws]
    for name, quantity in named.items():
        assert_allclose(np.std([one[name] for one in each]), quantity.error, rtol=0.15, err_msg=name)


def test_what_is_not_known_is_said():
    none, open_ = answer(None), answer(np.diag([np.inf, *np.full(len(COUNT) - 1, 1e-9)]))
    cells = {labels[0]: [cell.text for cell in row] for labels, row in answer_table([none, open_]).rows}
    first, second = WRENCH.shape.group_names[:2]
    assert cells[first][1] == cells["total"][1] == cells["center x"][1] == "not observed"
    assert "[" not in cells[second][0]
    assert "[" in cells[second][1]
    fields = answer_fields(open_)["quantities"][first]
    assert (fields["low"], fields["high"]) == (None, None)
    rows = answer_rows([answer(np.eye(len(COUNT)))])
    assert min(row["low"] for row in rows if row["unit"] == "kg") == 0.0  # no mass is negative
    assert answer_rows([replace(none, distribution=None)]) == []


def test_the_map_shows_every_mass_in_its_place():
    made = right(np.diag([np.inf, *np.full(L2.shape.n_m - 1, 1e-9)]))
    lines = mass_map(made).plain.splitlines()[1:]
    assert len(lines) == 12
    assert max(map(len, lines)) == 18
    for name, mass in list(zip(L2.shape.group_names, L2.group_mass, strict=True))[1:]:
        assert sum(f"{mass:.3f}" in line for line in lines) >= 1
        assert sum(name in line for line in lines) == 1
    middle = lines[-2].split("0.100")  # A1, not observed, left of B1 and C1
    assert "?" in middle[0] and len(middle) == 3
    fine = replace(made, shape=load_object("L2", grid=30).shape, covariance=None)
    assert max(map(len, mass_map(fine).plain.splitlines())) <= WIDEST
    with pytest.raises(ValueError, match="without masses"):
        mass_map(replace(made, distribution=None))


@pytest.mark.parametrize(
    ("status", "bayes", "verdict", "evidence"),
    [
        ("ok", 5.0, "own weight", "every group rests on its own weight (Bayes factor 10^5.0"),
        ("underdetermined", 1.0, "undecided", "cannot be told apart"),
        ("assumption_violated", -9.0, "not own weight", "as under one rigid body"),
    ],
)
def test_the_support_is_named(status, bayes: float, verdict: str, evidence: str):
    numbers = {"rigid_share": 0.1, "rigid_share_error": 0.2}
    masses = MassDistribution(np.array([0.1]), np.array([0.5]))
    found = Estimate(masses, status, "as under one rigid body", diagnostics=numbers | {"log10_bayes_factor": bayes})
    assert support_verdict(found)[0] == verdict
    assert evidence in support_verdict(found)[1]
    assert support_verdict(Estimate(None, "no_data", assumes="own weight")) == ("assumed", "")
    assert support_verdict(Estimate(None, "no_data")) == ("not tested", "")


def test_methods_with_intervals_are_drawn_and_where_none_has_one_it_is_hatched():
    sure = right(1e-8 * np.eye(6))
    bare = replace(sure, method="random_search", covariance=None)
    nothing = replace(sure, method="diff_lcp", distribution=None)
    for answers, method, hatched in (
        ([bare, nothing, sure], "hidden_states", 0),
        ([bare, nothing], "random_search", 6),
    ):
        figure = answer_maps(answers)
        labels = [axis.get_ylabel() for axis in figure.axes if axis.get_ylabel()]
        assert labels[0] == f"{method}\nok"
        written = [text.get_text() for axis in figure.axes for text in axis.texts]
        assert written.count("0.400") == 4 and written.count("-") + written.count("not observed") == hatched


@pytest.mark.parametrize("name", ["L2", pytest.param("hammer", marks=pytest.mark.slow)])
def test_parts_contacts_and_grasps_are_recorded(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    file, shape = tmp_path / "object.rrd", load_object(name).shape
    main(["show", name, "--record", str(file)])
    assert f"recording: {file}" in capsys.readouterr().out
    verify(file)
    found = set(read_chunks(file))
    wanted = {f"object/parts/{part}" for part in shape.group_names} | {"object/contacts", "object/center_of_mass"}
    assert wanted | {f"object/grasps/{grasp.name}" for grasp in shape.grasps} <= found


def shown_plan(name: str, *actions: Action) -> PlanView:
    """A plan of actions whose errors fall from 250 g to 1, 2, ... g."""
    shape = load_object(name).shape
    after = 1e-3 * np.arange(1, shape.n_m + 1)
    errors = np.array([np.full(shape.n_m, 0.25), *([after] * len(actions))])
    return PlanView(shape, actions, errors, "a plan")


SHOWN = {
    "long": shown_plan("I2", Rotate(0, speed=-0.2, pivot=(-0.115, 0.005)), Rotate(1, speed=-0.2, pivot=(0.009, 0.006)),
                       Rotate(1, pivot=(0.061, -0.022)), Slide(5, direction=-1.45)),
    "square": shown_plan("L2", Rotate(4, pivot=(-0.006, 0.074)), Rotate(3, pivot=(-0.015, -0.05)), Lift(1), Lift(1)),
}  # fmt: skip


@pytest.mark.parametrize("name", SHOWN)
def test_numbers_of_a_plan_stand_clear_of_arrows_marks_and_each_other(name: str):
    view = SHOWN[name]
    places = np.array([view.number_places[i + 1] for i in range(len(view.actions))])
    drawn = np.vstack([arrow.strokes for arrow in view.arrows.values()])
    size = float(np.ptp(view.bounds, axis=0).max())
    assert np.linalg.norm(places[:, None] - drawn, axis=-1).min() > 0.02 * size
    apart = np.linalg.norm(places[:, None] - places, axis=-1) + np.eye(len(places))
    assert apart.min() > 0.02 * size
    marks = [view.arrows[i + 1].label if i + 1 in view.arrows else view.lifts[i + 1] for i in range(len(places))]
    assert np.linalg.norm(places - marks, axis=1).max() < 0.06 * size


@pytest.mark.parametrize("name", SHOWN)
def test_the_panels_of_a_plan_are_in_line_and_on_one_scale(name: str):
    figure = plan_figure(SHOWN[name])
    figure.draw_without_rendering()
    *panels, bar = figure.axes
    assert len(panels) == 3
    boxes = [axis.get_window_extent() for axis in panels]
    edges = "x0" if name == "long" else "y0"
    assert np.ptp([getattr(box, edges) for box in boxes]) < 1.0
    cells = [np.ptp(axis.transData.transform([(0, 0), (1, 0)])[:, 0]) for axis in panels]
    assert cells == pytest.approx([cells[0]] * 3, rel=0.01)
    maps = [patches for axis in panels[1:] for patches in axis.collections if patches.get_array() is not None]
    np.testing.assert_allclose([patches.get_clim() for patches in maps], [[0.0, 6.0]] * 2)
    assert bar.get_xlabel() == "expected standard error, g"
    assert [text.get_text() for text in panels[1].texts] == ["250"] * 6
