"""Grasps across rows of blocks, as far as the hand opens: where they are, and turns by them in simulation."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from estimators import HiddenStates
from estimators.particles.wrench import predicted_wrenches
from scenarios.cli.main import main
from testbed.actions.accelerate import Accelerate
from testbed.actions.rotate import Rotate
from testbed.errors import InvalidValueError
from testbed.importers.columns import HandMap
from testbed.importers.mapping import MappedAction
from testbed.objects.blocks import block_object, parse_layout
from testbed.objects.files import load_object
from testbed.objects.model import GRAVITY, ROBOTIQ_2F85, Hand, ObjectModel
from testbed.sensing.windows import steady_samples, wrench_in_object
from testbed.simulation.runner import SimulationRunner
from testbed.trial import Trial
from tests.helpers.answers import nad

MASS = [0.1, 0.3, 0.2, 0.15, 0.25, 0.1]
TWO_BY_THREE = """
name = "two_by_three"
[blocks]
layout = ["11", "11", "11"]
mass_kg = [0.1, 0.3, 0.2, 0.15, 0.25, 0.1]
friction = 0.4
size_m = 0.04
"""


def rows(layout: list[str], size: float, hand: Hand | None = None) -> ObjectModel:
    cells = parse_layout(layout)
    mass = MASS if len(cells) == len(MASS) else [0.2] * len(cells)
    groups = [0] * len(cells)
    return block_object(
        "rows",
        cells,
        size=size,
        height=0.03,
        mass=mass,
        friction=[0.4],
        friction_group=groups,
        grid=3,
        hand=hand or ROBOTIQ_2F85,
    )


def names(layout: list[str], size: float, hand: Hand | None = None) -> list[str]:
    return [grasp.name for grasp in rows(layout, size, hand).shape.grasps]


def test_rows_are_taken_across_where_the_hand_opens_that_far():
    shape = rows(["11", "11", "11"], 0.04).shape
    assert [g.name for g in shape.grasps] == ["A1-B1", "A2-B2", "A3-B3"]
    assert_allclose([g.position for g in shape.grasps], [[0, -0.04], [0, 0], [0, 0.04]], atol=1e-15)
    assert {(g.angle, g.width, g.length) for g in shape.grasps} == {(0.0, 0.08, 0.04)}
    assert [shape.pressed(g) for g in shape.grasps] == [(0, 1), (2, 3), (4, 5)]
    assert names(["11", "11", "11"], 0.05) == names(["11", "11", "11"], 0.04, Hand(0.06)) == []
    assert names(["11", "11", "11"], 0.05, Hand(0.105)) == ["A1-B1", "A2-B2", "A3-B3"]
    up = rows(["111", "111"], 0.04).shape.grasps
    assert [(g.name, g.angle) for g in up] == [(f"{c}1-{c}2", np.pi / 2) for c in "ABC"]


def test_single_blocks_come_first_and_keep_their_names():
    assert names(["11"], 0.04) == ["A1", "B1", "A1-B1"]
    assert names(["1", "11"], 0.03) == ["B1", "A2", "A1-B1", "A1-A2"]
    assert names(["1111"], 0.02)[4:] == ["A1-D1"]


def test_the_open_fingers_need_room_beside_a_row():
    """Fingers end 50.5 mm from the middle of the 2F-85: a block 15 mm behind the row is in their way, 45 mm is not."""
    gap = ["11011", "10001", "11111"]
    assert "A3-B3" not in names(gap, 0.015)
    assert "A3-B3" in names(["1100011", "1000001", "1111111"], 0.02, Hand(0.05))
    # A finger wider than its block meets a neighbor that stands out
    stair = ["111", "110", "110"]
    assert "A1-B1" in names(stair, 0.03, Hand(finger_width=0.02))
    assert {"A1-B1", "A2-B2"} & set(names(stair, 0.03, Hand(finger_width=0.04))) == {"A1-B1"}


def test_a_hand_too_small_is_said(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "two_by_three.toml").write_text(TWO_BY_THREE)
    said = "have room for the fingers of a hand that opens to 60 mm"
    hand = HandMap(topic="/pose", stroke_m=0.06).size
    shape = load_object("two_by_three.toml", hand=hand).shape
    asked = MappedAction(Rotate(0), "A1-B1")
    with pytest.raises(InvalidValueError, match=said):
        asked.on(shape, hand)
    assert asked.on(load_object("two_by_three.toml").shape).grasp == 0
    (tmp_path / "robot.toml").write_text("[gripper]\nstroke_m = 0.06\n")
    for words, error in ((("two_by_three.toml",), said), (("two_by_three.toml", "--action", "slide"), said)):
        with pytest.raises(SystemExit, match="2"):
            main(["robot", "trial", *words, "--dry-run"])
        assert error in capsys.readouterr().err
    (tmp_path / "robot.toml").write_text("[gripper]\nstroke_m = 0.05\n")
    with pytest.raises(SystemExit, match="2"):
        main(["robot", "trial", "L2", "--grasp", "A2", "--dry-run"])
    assert "grasp: got 'A2, 50 mm across'; allowed: 5 mm less than the hand's 50 mm" in capsys.readouterr().err
    main(["show", "two_by_three.toml"])
    row = next(line for line in capsys.readouterr().out.splitlines() if "A2-B2" in line)
    assert row.split("│")[1].strip() == "A2-B2" and row.split("│")[-2].strip() == "x, 80 mm"


@pytest.mark.slow
def test_turns_by_rows_show_every_mass():
    model = rows(["11", "11", "11"], 0.04)
    drag = 0.4 * model.total_mass * GRAVITY
    with SimulationRunner() as bench:
        turns = [bench.run(Trial(model, Rotate(grasp, duration=4.0, back=True))) for grasp in range(3)]
        turns += [bench.run(Trial(model, Accelerate(grasp))) for grasp in (0, 2)]
    assert [turn.status for turn in turns] == ["ok"] * 5
    for turn in turns[:3]:
        (predicted,) = predicted_wrenches(model.shape, model.truth, [turn])
        off = predicted - wrench_in_object(turn)[:, [0, 1, 5]]
        for kept in steady_samples(turn):
            assert (np.abs(off[kept].mean(axis=0)) < 0.005 * drag * np.array([1, 1, 0.05])).all()
    found = HiddenStates().estimate(model.shape, model.total_mass, turns, seed=0)
    assert nad(model, found) < 0.01
