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


def hung(obj: ObjectModel) -> Trajectory:
    """The object lifted, as `testbed.robot.runner.lifted` leaves it."""
    held = analytic_trial(obj, Slide(0, duration=2.5), noise=0.05)
    wrench = held.wrench_on_object_world - held.wrench_on_object_world.mean(axis=0)
    wrench[:, 2] += obj.total_mass * GRAVITY
    figures = {"weight_std_kg": 0.005}
    return replace(held, action=Weigh(), wrench_on_object_world=wrench, tool=None, figures=figures)


def folder_of(root: Path, obj: ObjectModel, change: np.ndarray, runner: str = "robot") -> Path:
    """Trials whose every wrench went through a 6 x 6 matrix, and a scale's reading."""
    moves: tuple[Action, ...] = (Rotate(0, duration=2.5, pivot=(0.1, 0.15), back=True), Slide(0, 0.4, duration=2.5))
    records = [hung(obj), *(analytic_trial(obj, move, noise=0.05) for move in moves)]
    records = [replace(t, wrench_on_object_world=t.wrench_on_object_world @ change.T) for t in records]
    for i, record in enumerate([*records, read_off(obj.total_mass)]):
        request = {"object": object_request(obj), "action": record.action.to_dict(), "support": "own_weight"}
        stored = replace(record, provenance={"runner": runner})
        Store(root).put_trial(f"{i}", Trial(obj, record.action), request, stored)
    return root


@pytest.mark.parametrize(
    ("change", "runner", "code", "finding"),
    [
        (np.eye(6), "robot", 0, "all 8 findings are as they should be"),
        (-np.eye(6), "robot", 1, "it cannot hang upwards: sign is the wrong one"),
        (
            rotate_wrench(Rotation.from_euler("z", 30, degrees=True).as_matrix(), np.eye(6)).T,
            "robot",
            1,
            "turn the sensor's rotation by -30 deg about the vertical",
        ),
        (1.1 * np.eye(6), "robot", 1, "check the gain by a known mass"),
        (np.eye(6), "simulation", 2, "a folder of measured trials"),
    ],
    ids=["right", "negated", "turned", "gain", "simulated"],
)
def test_an_error_of_the_sensor_is_named(tmp_path, capsys, change: np.ndarray, runner: str, code: int, finding: str):
    folder = folder_of(tmp_path / "lab", drawn_object(0), change, runner)
    ended = 0
    try:
        main(["robot", "verify", str(folder)])
    except SystemExit as end:
        ended = int(end.code or 0)
    out, err = capsys.readouterr()
    assert ended == code
    assert finding in out + err
    assert ("wrong" in out) == (code == 1)
