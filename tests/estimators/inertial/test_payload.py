"""Payloads: a simulated lift gives the object in the sensor's frame; each robot's form; calibrations."""

import json
from pathlib import Path

import numpy as np
import pytest

from estimators.inertial import true_body
from estimators.inertial.body import InertialParameters
from estimators.inertial.payload import Payload, as_franka, as_json, as_kortex, as_ur
from scenarios.cli.main import main
from testbed.actions.lift import Lift
from testbed.errors import InvalidValueError
from testbed.frames import rotation_matrix, rotation_z
from testbed.objects.files import load_object
from testbed.robot.calibration.file import save_calibration
from testbed.robot.calibration.static_poses import Calibration
from testbed.sensing.noise import draw_sensing
from testbed.sensing.presets import preset
from testbed.simulation.runner import SimulationRunner
from testbed.trajectory import Phase, Trajectory
from testbed.trial import RIGID, Trial

L2 = load_object("L2")
CALIBRATION = Calibration(
    sign=1,
    sensor_in_hand=np.array([1.0, 0.0, 0.0, 0.0]),
    sensor_in_hand_std=np.full(3, 1e-3),
    bias=np.zeros(6),
    bias_std=np.full(6, 0.1),
    mass=1.2,
    mass_std=0.01,
    com=np.array([0.0, 0.01, 0.06]),
    com_std=np.array([0.001, 0.001, 0.002]),
    misfit=1.0,
    poses=12,
)


@pytest.fixture(scope="module")
def lift() -> Trajectory:
    """A lift of L2 as one rigid body, with a perfect sensor."""
    with SimulationRunner(secret="payload") as simulation:
        clean = simulation.run(Trial(L2, Lift(2), support=RIGID, sensing="ideal"))
    return draw_sensing(clean, preset("ideal"), 0)


def in_sensor(trajectory: Trajectory) -> InertialParameters:
    """True body in the sensor's frame, from the poses as the object lies flat in the hand."""
    flat = np.flatnonzero(trajectory.mask(Phase.SETTLE))[-1]
    axes = rotation_matrix(trajectory.sensor_orientation)[flat].T @ rotation_z(float(trajectory.object_pose[flat, 2]))
    assert trajectory.tool is not None
    lies = np.append(trajectory.object_pose[flat, :2], 0.0)
    lever = rotation_matrix(trajectory.sensor_orientation)[flat].T @ (lies - trajectory.tcp_position[flat])
    corner = lever + trajectory.tool.tcp
    return true_body(L2).moved(axes.T, -axes.T @ corner)


def test_a_lift_gives_the_object_in_the_sensors_frame(lift):
    found, true = Payload.of_lifts(L2.shape, [lift]), in_sensor(lift)
    assert found.parameters.mass == pytest.approx(true.mass, rel=2e-3)
    off = found.parameters.center_of_mass - true.center_of_mass
    assert np.allclose(off[:2], 0, atol=3e-4)
    assert 0 < off[2] < lift.figures["slip_m"] + 3e-4, "the object creeps down between the pads"
    assert np.allclose(found.parameters.inertia, true.inertia, atol=0.1 * true.inertia.max())
    low, high = found.interval("mass")
    assert low <= true.mass <= high and high - low < 0.05 * true.mass
    assert found.parameters.consistent and found.undetermined == []


def test_the_tool_is_added(lift):
    alone, both = (Payload.of_lifts(L2.shape, [lift], with_tool=added).parameters for added in (False, True))
    assert lift.tool is not None
    assert both.mass == pytest.approx(alone.mass + lift.tool.mass)
    moment = alone.mass * alone.center_of_mass + lift.tool.mass * lift.tool.com
    assert np.allclose(both.center_of_mass, moment / both.mass)
    assert both.consistent


def test_a_flange_beside_the_sensor():
    body = InertialParameters(2.0, np.array([0.1, 0.0, 0.05]), np.diag([1e-3, 2e-3, 2.5e-3]))
    turned = Payload(body, (body,)).on_flange(rotation_z(np.pi / 2), np.array([0.0, 0.0, 0.02]))
    assert np.allclose(turned.parameters.center_of_mass, [0.0, 0.1, 0.07])
    assert np.allclose(turned.parameters.inertia, np.diag([2e-3, 1e-3, 2.5e-3]))
    assert np.allclose(turned.interval("center_of_mass"), turned.parameters.center_of_mass)


def test_forms_of_controllers():
    inertia = np.array([[4.0, 0.1, 0.2], [0.1, 5.0, 0.3], [0.2, 0.3, 6.0]]) * 1e-3
    body = InertialParameters(1.5, np.array([0.01, 0.02, 0.03]), inertia)
    payload = Payload(body, (body,))
    assert as_ur(payload) == (
        "set_target_payload(1.5, [0.01, 0.02, 0.03], [0.004, 0.005, 0.006, 0.0001, 0.0002, 0.0003])\n"
    )
    assert json.loads(as_franka(payload)) == {
        "mass": 1.5,
        "center_of_mass": [0.01, 0.02, 0.03],
        "load_inertia": pytest.approx(inertia.flatten(order="F")),
    }
    assert json.loads(as_kortex(payload)) == {"tool_mass": 1.5, "tool_mass_center": {"x": 0.01, "y": 0.02, "z": 0.03}}
    assert json.loads(as_json(payload))["inertia_90_kg_m2"] == [inertia.tolist()] * 2


def test_a_calibration_shows_no_inertia(tmp_path: Path, capsys):
    save_calibration(tmp_path / "c.toml", CALIBRATION, "7", "today")
    main(["payload", str(tmp_path / "c.toml"), "--format", "json", "--out", str(tmp_path / "p.json")])
    said = capsys.readouterr().out
    assert said.startswith("mass 1.2000 kg [1.18") and "not determined: Ixx, Iyy, Izz" in said
    written = json.loads((tmp_path / "p.json").read_text(encoding="utf-8"))
    assert written["inertia_kg_m2"] == [[None] * 3] * 3
    assert written["center_of_mass_m"] == [0.0, 0.01, 0.06]
    main(["payload", str(tmp_path / "c.toml"), "--format", "ur", "--flange", "0", "0", "0.0127", "0"])
    assert "set_target_payload(1.2, [0, 0.01, 0.0727])\n" in capsys.readouterr().out


def test_what_has_no_payload_is_refused(tmp_path: Path):
    with pytest.raises(InvalidValueError, match="one or more lifts that ended well"):
        Payload.of_lifts(L2.shape, [])
    (tmp_path / "trials").mkdir()
    with pytest.raises(SystemExit):
        main(["payload", str(tmp_path)])
