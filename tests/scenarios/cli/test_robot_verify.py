"""heft robot verify: physics alone tells whether the sensor of a measured folder is right."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from estimators.testing.analytic_world import analytic_trial, drawn_object
from scenarios.cli.main import main
from scenarios.results.store import Store, object_request
from testbed.actions.base import Action
from testbed.actions.rotate import Rotate
from testbed.actions.slide import Slide
from testbed.actions.weigh import Weigh
from testbed.frames import rotate_wrench
from testbed.objects.model import GRAVITY, ObjectModel
from testbed.robot.runner import read_off
from testbed.trajectory import Trajectory
from testbed.trial import Trial
from tests.helpers.recorded import put_trial


def hung(obj: ObjectModel) -> Trajectory:
    """The object lifted, as `testbed.robot.runner.lifted` leaves it."""
    held = analytic_trial(obj, Slide(0, duration=2.5), noise=0.05)
    wrench = held.wrench_on_object_world - held.wrench_on_object_world.mean(axis=0)
    wrench[:, 2] += obj.total_mass * GRAVITY
    figures = {"weight_std_kg": 0.005}
    return replace(held, action=Weigh(), wrench_on_object_world=wrench, tool=None, figures=figures)


def folder_of(root: Path, obj: ObjectModel, change: np.ndarray) -> Path:
    """Trials whose every wrench went through a 6 x 6 matrix, and a scale's reading."""
    moves: tuple[Action, ...] = (Rotate(0, duration=2.5, pivot=(0.1, 0.15), back=True), Slide(0, 0.4, duration=2.5))
    records = [hung(obj), *(analytic_trial(obj, move, noise=0.05) for move in moves)]
    records = [replace(t, wrench_on_object_world=t.wrench_on_object_world @ change.T) for t in records]
    for i, record in enumerate([*records, read_off(obj.total_mass)]):
        asked = {"object": object_request(obj), "action": record.action.to_dict(), "support": "own_weight"}
        Store(root).put_trial(f"{i}", Trial(obj, record.action), asked, replace(record, provenance={"runner": "robot"}))
    return root


@pytest.mark.parametrize(
    ("change", "code", "said"),
    [
        (np.eye(6), 0, "all 8 findings are as they should be"),
        (-np.eye(6), 1, "it cannot hang upwards: sign is the wrong one"),
        (
            rotate_wrench(Rotation.from_euler("z", 30, degrees=True).as_matrix(), np.eye(6)).T,
            1,
            "turn the sensor's rotation by -30 deg about the vertical",
        ),
        (1.1 * np.eye(6), 1, "check the gain by a known mass"),
    ],
    ids=["right", "negated", "turned", "gain"],
)
def test_what_is_wrong_with_a_sensor_is_named(tmp_path: Path, capsys, change: np.ndarray, code: int, said: str):
    folder = folder_of(tmp_path / "lab", drawn_object(0), change)
    ended = 0
    try:
        main(["robot", "verify", str(folder)])
    except SystemExit as end:
        ended = int(end.code or 0)
    told = capsys.readouterr().out
    assert ended == code
    assert said in told
    assert ("wrong" in told) == bool(code)


def test_simulated_trials_tell_nothing(tmp_path: Path, capsys):
    put_trial(tmp_path, "L2", Slide(1, duration=1.5))
    with pytest.raises(SystemExit, match="2"):
        main(["robot", "verify", str(tmp_path)])
    assert "a folder of measured trials" in capsys.readouterr().err
