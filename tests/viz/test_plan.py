"""The picture of a plan: panels in line, one scale, numbers beside the arrows."""

import numpy as np
import pytest

from testbed.actions.base import Action
from testbed.actions.lift import Lift
from testbed.actions.rotate import Rotate
from testbed.actions.slide import Slide
from testbed.objects.files import load_object
from viz.figures.plan import plan_figure
from viz.values import PlanView


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
