"""`heft identify`: the actions it plans, what it prints, what it draws."""

import numpy as np
import pytest

from estimators.action_selection.pushes import random_pushes
from scenarios.cli.main import main
from scenarios.cli.plan import actions_of
from testbed.actions.accelerate import Accelerate
from testbed.actions.lift import Lift
from testbed.actions.rotate import Rotate
from testbed.actions.slide import Slide
from testbed.actions.weigh import Weigh
from testbed.errors import InvalidValueError
from testbed.objects.files import load_object
from viz.figures.maps import error_figure


def test_the_plan_is_the_policys():
    actions = actions_of(load_object("L2"), slides=3, duration=9.0)
    kinds = [type(action) for action in actions]
    assert [kinds.count(kind) for kind in (Weigh, Accelerate, Rotate, Slide)] == [1, 6, 6, 3]
    assert all(a.back and a.duration == 9.0 for a in actions if isinstance(a, Rotate))
    directions = [a.direction for a in actions if isinstance(a, Slide)]
    assert len(set(directions)) == 3


def test_only_the_grasps_that_are_named_are_used():
    model = load_object("L2")
    name = model.shape.grasps[1].name
    actions = actions_of(model, grasps=(name,))
    assert {a.grasp for a in actions if a.moves} == {1}
    with pytest.raises(InvalidValueError, match="grasps of L2: "):
        actions_of(model, grasps=("nose",))


LINKS = "scenarios/library/objects/fold_2.toml"


def test_links_are_slid_and_turned_and_their_hinges_told(capsys):
    actions = actions_of(load_object(LINKS), pivots=2, slides=3)
    assert [type(action) for action in actions] == [Weigh, Rotate, Rotate, Slide, Slide, Slide]
    with pytest.raises(InvalidValueError, match="no pushes of an object with hinges"):
        actions_of(load_object(LINKS), pushes=2)
    main(["identify", LINKS, "--pivots", "2", "--slides", "2"])
    assert "friction of hinges: standard error" in " ".join(capsys.readouterr().out.split())


def test_pushes_are_the_published_ones():
    model = load_object("L2")
    assert actions_of(model, pivots=0, pushes=5)[1:] == random_pushes(model.shape, 5, 0)
    with pytest.raises(InvalidValueError, match="pushes"):
        actions_of(model, pushes=-1)


def test_lifts_are_of_inner_grasps_and_of_rigid_bodies_alone():
    model = load_object("I2")
    actions = actions_of(model, support="rigid", lifts=3)
    assert [a.grasp for a in actions if isinstance(a, Lift)] == [2, 3, 1]
    for support, lifts in (("rigid", -1), ("own_weight", 1)):
        with pytest.raises(InvalidValueError, match="lifts"):
            actions_of(model, support, lifts=lifts)


def test_a_lift_shows_two_more_of_an_f_and_leaves_one_way_open(capsys):
    main(["identify", "F2", "--assumed-support", "rigid", "--lifts", "1"])
    said = " ".join(capsys.readouterr().out.split())
    assert "6 of 7 masses and frictions are observed" in said


def test_it_says_what_is_seen(capsys):
    main(["identify", "L2"])
    said = capsys.readouterr().out
    assert "L2, own_weight, ft300s: 1 weigh, 6 accelerate, 6 rotate" in said
    assert "all 7 masses and frictions are observed" in said
    main(["identify", "F2", "--assumed-support", "rigid"])
    said = " ".join(capsys.readouterr().out.split())
    assert "the combination A1 - B1 - A3 + B3" in said
    assert said.count("not observed") == 12


def test_a_group_without_mass_is_seen_but_has_no_part_of_it(tmp_path, capsys):
    blocks = '[blocks]\nlayout = ["11"]\nmass_kg = [0.3, 0.0]\nfriction = 0.35\n'
    (tmp_path / "hollow.toml").write_text('name = "hollow"\n' + blocks, encoding="utf-8")
    main(["identify", str(tmp_path / "hollow.toml")])
    (line,) = [line for line in capsys.readouterr().out.splitlines() if "0.000" in line]
    *_, error, part, _ = (cell.strip() for cell in line.split("│"))
    assert float(error) > 0 and part == "-"


def test_a_weighing_alone_shows_one_direction(capsys):
    main(["identify", "I1", "--pivots", "0"])
    assert "1 of 7 masses and frictions are observed" in capsys.readouterr().out


def test_a_sensor_that_is_not_there_is_refused(capsys):
    with pytest.raises(SystemExit) as end:
        main(["identify", "L2", "--sensing", "nose"])
    assert end.value.code == 2
    assert "one of ideal, ft300s" in capsys.readouterr().err


def test_the_heatmap_shows_the_standard_errors_of_the_table(tmp_path, capsys, monkeypatch):
    drawn = []
    monkeypatch.setattr("viz.figures.maps.save_figure", lambda figure, _: drawn.append(figure) or [])
    main(["identify", "L2", "--out", str(tmp_path / "errors")])
    said = capsys.readouterr().out
    assert "standard error, g" in said and drawn[0].axes[1].get_xlabel() == "standard error, g"
    rows = [line.split("│") for line in said.splitlines() if line.startswith("│")]
    printed = [float(row[3]) for row in rows if row[3].strip()]
    assert [float(text.get_text()) for text in drawn[0].axes[0].texts] == pytest.approx(printed, abs=0.006)


def test_the_heatmap_is_written_whole(tmp_path, capsys):
    main(["identify", "L2", "--out", str(tmp_path / "errors")])
    assert sorted(path.name for path in tmp_path.iterdir()) == ["errors.pdf", "errors.png"]
    assert "errors.png" in capsys.readouterr().out


def test_what_is_not_seen_is_hatched_and_said():
    model = load_object("L2")
    figure = error_figure(model, np.array([0.01, np.inf, 0.02, 0.03, 0.01, 0.01]), "some trials")
    axis, bar = figure.axes
    assert [text.get_text() for text in axis.texts] == ["10.0", "not observed", "20.0", "30.0", "10.0", "10.0"]
    assert "standard error" in bar.get_xlabel()
    hatched = [patches for patches in axis.collections if patches.get_hatch()]
    assert len(hatched) == 1 and len(hatched[0].get_paths()) == 9
    assert len(error_figure(model, np.full(6, np.inf), "nothing").axes) == 1
