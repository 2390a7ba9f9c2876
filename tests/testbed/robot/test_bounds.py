"""Units and signs mistaken in the robot's files: refused by a bound on every number, before anything is connected."""

from dataclasses import replace
from pathlib import Path
from typing import get_args

import numpy as np
import pytest

from testbed.errors import InvalidValueError
from testbed.robot.calibration.file import CalibrationFile, load_calibration, save_calibration
from testbed.robot.calibration.static_poses import Calibration, calibrate
from testbed.robot.config import RobotFile
from testbed.robot.interfaces import ArmIdentity
from testbed.robot.raw_record import RawRecord
from testbed.robot.registry import load_robot_file
from testbed.robot.robotiq.gripper import data_sheet
from testbed.toml import InvalidFileError, toml_text
from tests.fakes.static_hand import DOWN, readings

TABLES = {name: getattr(RobotFile(), name) for name in ("arm", "sensor", "gripper", "bench", "limits")}
NUMBERS = [(name, key) for name, table in TABLES.items() for key, v in table if isinstance(v, float | list)]
GOOD = replace(calibrate(readings(DOWN)), bias_walk=np.full(6, 0.1))


@pytest.mark.parametrize(("table", "key"), NUMBERS)
@pytest.mark.parametrize("value", [1e12, -1e12, float("nan"), float("inf")])
def test_every_number_of_the_robot_file_is_bounded(table, key, value, tmp_path):
    path = tmp_path / "robot.toml"
    usual = getattr(TABLES[table], key)
    path.write_text(toml_text({table: {key: [value] * 3 if isinstance(usual, list) else value}}), encoding="utf-8")
    with pytest.raises(InvalidFileError, match=key):
        load_robot_file(path)


@pytest.mark.parametrize(
    ("table", "key", "value"),
    [
        ("sensor", "to_tcp_m", 174),
        ("arm", "tool_length_m", 211.5),
        ("bench", "table_height_m", -12),
        ("bench", "grip_height_m", 22),
        ("bench", "travel_speed_m_s", 100),
        ("limits", "speed_m_s", 150),
        ("limits", "force_N", 6000),
        ("limits", "low_m", [300, -250, 15]),
    ],
)
def test_millimeters_for_meters_are_refused(table, key, value, tmp_path):
    path = tmp_path / "robot.toml"
    path.write_text(toml_text({table: {key: value}}), encoding="utf-8")
    with pytest.raises(InvalidFileError, match=key):
        load_robot_file(path)


def numbers_of_a_calibration() -> list[str]:
    return [n for n, f in CalibrationFile.model_fields.items() if n.startswith(("bias", "tool")) and "std" not in n]


@pytest.mark.parametrize("key", numbers_of_a_calibration())
def test_every_number_of_a_calibration_is_bounded(key, tmp_path):
    path = tmp_path / "calibration.toml"
    save_calibration(path, GOOD, "1", "today")
    load_calibration(path)
    lines = path.read_text(encoding="utf-8").splitlines()
    value = "1e6" if get_args(CalibrationFile.model_fields[key].annotation) == () else "[0.0, 0.0, 1e6]"
    path.write_text("\n".join(f"{key} = {value}" if s.startswith(f"{key} =") else s for s in lines), encoding="utf-8")
    with pytest.raises(InvalidFileError, match=key):
        load_calibration(path)


@pytest.mark.parametrize(
    ("changes", "field"),
    [
        ({"com": -GOOD.com}, "tool_com_m"),
        ({"com": 4 * GOOD.com}, "tool_com_m"),
        ({"com": GOOD.com + 0.06}, "tool_com_m"),
        ({"mass": 0.1}, "tool_mass_kg"),
        ({"mass": 3.5}, "tool_mass_kg"),
    ],
)
def test_a_tool_that_cannot_hang_on_the_sensor_is_refused(changes, field):
    calibration: Calibration = replace(GOOD, **changes)
    RobotFile().settings(GOOD, data_sheet(0.05))
    with pytest.raises(InvalidValueError, match=field):
        RobotFile().settings(calibration, data_sheet(0.05))


def test_another_arm_than_the_file_names_is_refused(tmp_path: Path):
    path = tmp_path / "robot.toml"
    path.write_text('[arm]\nserial = "AC1"\nfirmware = "0x20600"\n', encoding="utf-8")
    file = load_robot_file(path)
    file.check_arm(ArmIdentity("GEN3", "AC1", "0x20600"))
    for other in (ArmIdentity("GEN3", "AC2", "0x20600"), ArmIdentity("GEN3", "AC1")):
        with pytest.raises(InvalidValueError, match="which the arm reports"):
            file.check_arm(other)


def test_a_record_that_cannot_be_written_is_refused_before_motion(tmp_path: Path):
    (tmp_path / "file").touch()
    with pytest.raises(Exception, match="the record cannot be written"):
        RawRecord(tmp_path / "file")
