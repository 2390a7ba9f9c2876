"""The page on the real bench: its tables are the code's."""

import errno
import inspect
import json
import re
import sys
from typing import Any, get_args, get_type_hints

import pytest
from pydantic import BaseModel

from testbed.robot.config import ArmTable, BenchTable, CameraTable, GripperTable, LimitsTable, SensorTable
from testbed.robot.kinova.arm import KortexArm
from testbed.robot.robotiq.ft300s import Ft300s
from testbed.validation import Range
from tests.helpers.commands import ended
from tests.helpers.pages import DOCS, names, table

PAGE = (DOCS / "hardware.md").read_text(encoding="utf-8")
TABLES: dict[str, type[BaseModel]] = {
    "arm": ArmTable,
    "sensor": SensorTable,
    "gripper": GripperTable,
    "camera": CameraTable,
    "bench": BenchTable,
    "limits": LimitsTable,
}


@pytest.mark.parametrize("heading", TABLES)
def test_a_table_of_fields_is_the_files(heading):
    fields = TABLES[heading].model_fields
    rows = table("hardware.md", heading)
    assert names(rows) == list(fields)
    hints = get_type_hints(TABLES[heading], include_extras=True)
    for (_, default, allowed, meaning), (name, field) in zip(rows, fields.items(), strict=True):
        assert default == ("none" if field.default is None else f"`{json.dumps(field.default)}`")
        assert allowed == range_in(hints[name])
        assert meaning


def range_in(annotation: Any) -> str:
    """Range of the numbers in an annotation, in words; empty without one."""
    inner = [*get_args(annotation), *getattr(annotation, "__metadata__", ())]
    return next((str(one) for one in inner if isinstance(one, Range)), "") or "; ".join(
        dict.fromkeys(filter(None, map(range_in, inner)))
    )


def test_the_table_of_device_settings_is_the_classes():
    arguments = {**inspect.signature(KortexArm).parameters, **inspect.signature(Ft300s).parameters}
    hints = get_type_hints(KortexArm, include_extras=True) | get_type_hints(Ft300s.__init__, include_extras=True)
    rows = table("hardware.md", "Device settings")
    assert names(rows) == ["silence", "watchdog", "turn_speed", "stale_after", "repeats", "noise"]
    for name, default, allowed, _ in rows:
        assert json.loads(default.strip("`")) == pytest.approx(arguments[name.strip("`")].default, rel=1e-3)
        assert allowed == range_in(hints[name.strip("`")])


def test_the_shown_check_is_what_is_printed_without_hardware(tmp_path, monkeypatch, capsys):
    def nobody(*_: object) -> None:
        raise OSError(errno.EHOSTUNREACH, "No route to host")

    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("HEFT_KORTEX_PYTHON", raising=False)
    monkeypatch.setattr("socket.create_connection", nobody)
    monkeypatch.setattr("testbed.robot.robotiq.serial_port.usb_serial_ports", list)
    assert ended("robot", "check") == 1
    printed = capsys.readouterr().out.replace(sys.executable, "python")
    shown = (
        PAGE.split("Without any hardware it says:\n\n```\n")[1].split("```")[0].replace(".venv/bin/python3", "python")
    )
    versions = r"(?<=: )\d+\.\d+(\.\d+)?$"
    lines = iter([re.sub(versions, "X", line) for line in printed.splitlines()])
    for line in shown.splitlines():
        assert line == "..." or re.sub(versions, "X", line) in lines  # in this order
