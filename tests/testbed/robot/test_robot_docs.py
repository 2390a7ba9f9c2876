"""The page on the real bench: its tables are the code's."""

from __future__ import annotations

import errno
import json
import re
import sys
from pathlib import Path

import pytest
from pydantic import BaseModel

from scenarios.cli.main import main
from testbed.robot.config import ArmTable, BenchTable, LimitsTable, SensorTable

PAGE = (Path(__file__).parents[3] / "docs" / "hardware.md").read_text(encoding="utf-8")
TABLES: dict[str, type[BaseModel]] = {
    "arm": ArmTable,
    "sensor": SensorTable,
    "bench": BenchTable,
    "limits": LimitsTable,
}


def rows(heading: str) -> list[list[str]]:
    """Cells of the first table under a heading, without its head."""
    found = re.search(rf"^#+ {heading}\n(.*?)(?=^#+ |\Z)", PAGE, re.MULTILINE | re.DOTALL)
    assert found, heading
    lines = [line for line in found[1].splitlines() if line.startswith("|")]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines[2:]]


@pytest.mark.parametrize("heading", TABLES)
def test_a_table_of_fields_is_the_files(heading):
    fields = TABLES[heading].model_fields
    assert [cells[0].strip("`") for cells in rows(heading)] == list(fields)
    for (_, default, meaning), field in zip(rows(heading), fields.values(), strict=True):
        assert default == ("none" if field.default is None else f"`{json.dumps(field.default)}`")
        assert meaning


def test_every_option_of_a_trial_is_told(capsys):
    with pytest.raises(SystemExit):
        main(["robot", "trial", "--help"])
    options = set(re.findall(r"--[a-z][a-z-]+", capsys.readouterr().out)) - {"--help", "--no-back", "--no-dry-run"}
    assert options == {name.strip("`").split()[0] for name, *_ in rows("The commands")}


@pytest.mark.parametrize("command", ["import", "estimate"])
def test_every_option_of_the_commands_for_measured_data_is_told(command, capsys):
    page = (Path(__file__).parents[3] / "docs" / "command_line.md").read_text(encoding="utf-8")
    with pytest.raises(SystemExit):
        main([command, "--help"])
    options = set(re.findall(r"--[a-z][a-z-]+", capsys.readouterr().out)) - {"--help"}
    said = page.split(f"## heft {command}\n")[1].split("\n## ")[0]
    assert options == set(re.findall(r"^\| `(--[a-z-]+)", said, re.MULTILINE))


def test_the_shown_check_is_what_is_printed_without_hardware(tmp_path, monkeypatch, capsys):
    def nobody(*_: object) -> None:
        raise OSError(errno.EHOSTUNREACH, "No route to host")

    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("HEFT_KORTEX_PYTHON", raising=False)
    monkeypatch.setattr("socket.create_connection", nobody)
    monkeypatch.setattr("testbed.robot.robotiq.serial_port.usb_serial_ports", list)
    with pytest.raises(SystemExit, match="1"):
        main(["robot", "check"])
    printed = capsys.readouterr().out.replace(sys.executable, "python")
    shown = (
        PAGE.split("Without any hardware it says:\n\n```\n")[1].split("```")[0].replace(".venv/bin/python3", "python")
    )
    versions = r"(?<=: )\d+\.\d+(\.\d+)?$"
    assert [re.sub(versions, "X", line) for line in printed.splitlines()] == [
        re.sub(versions, "X", line) for line in shown.splitlines()
    ]
