"""The documentation holds: its files load, its code runs, its links lead somewhere, its tables are the code's."""

import json
import math
import re
from collections.abc import Callable, Iterator
from functools import wraps
from pathlib import Path
from typing import Any, get_args

import annotated_types
import numpy as np
import pyarrow.parquet as pq
import pytest
from pydantic import BaseModel

import scenarios.cli.main as commands
import scenarios.results.estimates
from estimators import METHODS, Estimate, Trace
from scenarios.cli.main import main
from scenarios.config import Grid, Meshes, Policy, Scenario, Simulation, Sweep, Truth, WorldTable, load_scenario
from scenarios.results.store import Store
from testbed.importers.columns import CameraMap, HandMap, JointMap, PartMap, SensorMap, TimeMap, ToolMap, VelocityMap
from testbed.importers.logs import FACTORS
from testbed.importers.mapping import LogMap, Mapping, PhaseWindow
from testbed.objects.files import Blocks, HingeTable, Mesh, MeshGrasp, MeshPart, ObjectFile, load_object
from testbed.objects.model import MassDistribution
from testbed.objects.random import Family
from testbed.robot.calibration.file import CalibrationFile
from testbed.robot.config import RobotFile
from testbed.sensing.presets import PRESETS
from testbed.toml import load_toml
from testbed.trajectory import SCHEMA_VERSION, Phase, save_trajectory
from testbed.worlds.presets import QUANTITIES, UNSTATED, WORLDS
from tests.helpers.pages import (
    BLOCKS,
    DOCS,
    FENCE,
    PAGES,
    README,
    ROOT,
    TUTORIAL,
    blocks_of,
    headings,
    names,
    options,
    run_file,
    table,
    write_tutorial,
)
from tests.helpers.records import record

SECTIONS: dict[str, type[BaseModel]] = {
    "Top of an object file": ObjectFile,
    "blocks": Blocks,
    "mesh": Mesh,
    "mesh.parts": MeshPart,
    "mesh.grasps": MeshGrasp,
    "Top of a scenario file": Scenario,
    "hinges": HingeTable,
    "meshes": Meshes,
    "random": Family,
    "grid": Grid,
    "policy": Policy,
    "simulation": Simulation,
    "truth": Truth,
    "world": WorldTable,
    "sweep": Sweep,
    "Fields of a calibration": CalibrationFile,
    "Top of a mapping file": Mapping,
    "mapping.time": TimeMap,
    "mapping.sensor": SensorMap,
    "mapping.hand": HandMap,
    "mapping.tool": ToolMap,
    "mapping.velocity": VelocityMap,
    "mapping.joints": JointMap,
    "mapping.camera": CameraMap,
    "mapping.camera.parts": PartMap,
    "mapping.phases": PhaseWindow,
    "mapping.logs": LogMap,
}
OTHER_FILES: dict[str, type[BaseModel]] = {"robot": RobotFile, "mapping": Mapping}
"""Kinds of file, by the mark of a block."""
SHELL = [line for b in (*BLOCKS, *blocks_of(README)) if b.language == "sh" for line in b.text.splitlines()]
COMMANDS = sorted(
    {found[1].split("  #")[0].rstrip() for line in SHELL if (found := re.match(r"(?:\S*/)?(heft .*)", line))}
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    return write_tutorial(tmp_path_factory.mktemp("tutorial"))


@pytest.fixture
def inside(folder, monkeypatch) -> Path:
    """The tutorial's folder as the current one, its modules and the conformance suite importable."""
    monkeypatch.chdir(folder)
    monkeypatch.syspath_prepend(str(folder))
    run_file("make_mallet.py")
    return folder


@pytest.mark.parametrize("block", [b for b in BLOCKS if b.language == "toml"], ids=lambda b: f"{b.page}-{b.title}")
def test_every_toml_block_loads(block, inside, tmp_path):
    path = (inside if block.mark == "object" else tmp_path) / block.title
    path.write_text(block.text, encoding="utf-8")
    if block.mark == "object":
        assert load_object(path).name == path.stem
    elif block.mark in OTHER_FILES:
        load_toml(path, OTHER_FILES[block.mark])
    else:
        assert block.mark == "scenario", f"mark the block as object, scenario or one of {[*OTHER_FILES]}"
        for name in load_scenario(str(path))[1].objects:
            load_object(name)


QUICK = [b.title for b in TUTORIAL if b.language == "python" and b.mark != "slow"]


@pytest.mark.parametrize("name", QUICK)
def test_every_quick_python_block_runs(name, inside, capsys):
    run_file(name)
    assert capsys.readouterr().out in ["", *(b.text for b in TUTORIAL if not b.language)]


@pytest.mark.parametrize("line", COMMANDS)
def test_every_command_is_understood(line, inside, monkeypatch):
    called, words = [], line.split()[1:]

    def silenced(path: str, load: Callable[[str], Callable[..., None]] = commands.load) -> Callable[..., None]:
        return wraps(load(path))(lambda *_, **__: called.append(path))

    monkeypatch.setattr(commands, "load", silenced)
    if words[0].startswith("--tyro-"):
        words[-1] = str(inside / "completion")
        with pytest.raises(SystemExit) as end:
            main(words)
        assert not end.value.code
    else:
        main(words)
        assert len(called) == 1


def test_a_shown_run_of_a_part_does_not_replace_the_whole_runs_report():
    parts = [line for line in COMMANDS if re.match(r"heft run .*--(objects|methods|seeds)", line)]
    assert len(parts) > 4
    assert [line for line in parts if "--out" not in line] == []


def anchors(page: Path) -> set[str]:
    text = FENCE.sub("", page.read_text(encoding="utf-8"))
    heads = re.findall(r"^#+ (.+)$", text, re.MULTILINE)
    return {re.sub(r"[-\s]+", "-", re.sub(r"[^\w\s-]", "", head).strip().lower()) for head in heads}


def links() -> Iterator[tuple[str, str]]:
    for page in (*PAGES, *sorted(DOCS.glob("api/*.md")), README, ROOT / "CONTRIBUTING.md"):
        for target in re.findall(r"\]\(([^)\s]+)\)", FENCE.sub("", page.read_text(encoding="utf-8"))):
            if not re.match(r"[a-z]+:", target):
                yield str(page.relative_to(ROOT)), target


@pytest.mark.parametrize(("page", "target"), list(links()))
def test_every_link_leads_somewhere(page, target):
    path, _, anchor = target.partition("#")
    there = (ROOT / page).parent / path if path else ROOT / page
    assert there.exists()
    assert not anchor or anchor in anchors(there)


def bounds(kind: Any, metadata: list[Any]) -> str:
    """Bounds of a number as the tables write them; empty where there are none."""
    for part in get_args(kind):  # X | None keeps the bounds of X within
        metadata = metadata + [m for inner in getattr(part, "__metadata__", ()) for m in getattr(inner, "metadata", ())]
    signs = {annotated_types.Gt: "> {0.gt}", annotated_types.Ge: ">= {0.ge}"}
    signs |= {annotated_types.Lt: "< {0.lt}", annotated_types.Le: "<= {0.le}"}
    return ", ".join(signs[type(m)].format(m) for m in metadata if type(m) in signs)


def as_written(default: Any) -> str:
    if default is None:
        return "none"
    if default == UNSTATED:
        return "modest"
    return "defaults" if isinstance(default, BaseModel) else f"`{json.dumps(default)}`"


def defaults_in(row: list[str]) -> list[str]:
    """Default of each field in a row, which may hold several fields: one for all, or one each."""
    count = len(names([row]))
    found = re.findall(r"`[^`]+`|\w+", row[1]) if count > 1 else [row[1]]
    return found * count if len(found) == 1 else found


@pytest.mark.parametrize("heading", SECTIONS)
def test_a_table_of_fields_is_the_models(heading):
    rows, model = table("formats.md", heading), SECTIONS[heading]
    assert names(rows) == list(model.model_fields)
    one_each = [(default, *row[2:]) for row in rows for default in defaults_in(row)]
    for (default, meaning), field in zip(one_each, model.model_fields.values(), strict=True):
        assert meaning
        assert default == ("required" if field.is_required() else as_written(field.default))
        union = "list" in str(field.annotation)  # words give the bounds of "a number or a list"
        assert union or bounds(field.annotation, field.metadata) in meaning


def test_every_method_is_listed():
    assert names(table("formats.md", "methods")) == list(METHODS)


def test_sensors_are_the_presets():
    rows = table("formats.md", "Sensors")
    assert names(rows) == list(PRESETS)
    for row, preset in zip(rows, PRESETS.values(), strict=True):
        for listed, noise in zip(row[1:3], (preset.force_noise, preset.torque_noise), strict=True):
            assert listed == ", ".join(f"{x:g}" for x in (noise if len(set(noise)) > 1 else noise[:1]))
        assert row[3:] == [f"{preset.force_bias:g}", f"{preset.torque_bias:g}"]


def test_worlds_are_the_presets():
    units = {"%": 0.01, "mm": 1e-3, "deg": math.pi / 180, "mrad": 1e-3, "ms": 1e-3, "g": 1e-3, "N": 1, "N m": 1, "": 1}
    rows = table("worlds.md", "Quantities")
    listed = [re.findall(r"`(\w+)`", row[0])[0] for row in rows]
    assert sorted(listed) == sorted(QUANTITIES)
    for quantity, row in zip(listed, rows, strict=True):
        for name, cell in zip(("lab", "rough"), row[1:3], strict=True):
            value, _, unit = cell.partition(" ")
            assert getattr(WORLDS[name], quantity) == pytest.approx(float(value) * units[unit])
        assert (row[3] == "S") == hasattr(WORLDS["lab"].stated, quantity)
        assert row[4]


def test_units_are_the_known_ones():
    rows = table("formats.md", "Units")
    assert {row[0]: re.findall(r"`([^`]+)`", row[1]) for row in rows} == {q: [*units] for q, units in FACTORS.items()}


def test_columns_of_results_are_those_of_the_docstring():
    lines = [line for line in (scenarios.results.estimates.__doc__ or "").splitlines() if line.startswith("| ")]
    listed = [name.strip() for line in lines[1:] for name in line.split("|")[1].split(",")]
    assert sorted(names(table("results.md", "results.parquet"))) == sorted(listed)


def test_columns_and_header_of_a_trajectory(tmp_path):
    save_trajectory(record(), tmp_path / "trajectory.parquet")
    schema = pq.read_schema(tmp_path / "trajectory.parquet")
    assert names(table("results.md", "trajectory.parquet")) == schema.names
    assert names(table("results.md", "Header")) == list(json.loads(schema.metadata[b"heft"]))
    assert [row[:2] for row in table("results.md", "Phases")] == [[str(int(p)), p.name.lower()] for p in Phase]
    assert f"The version of the trajectory schema is **{SCHEMA_VERSION}**" in (DOCS / "results.md").read_text("utf-8")


def test_arrays_of_an_estimate(tmp_path):
    trace = Trace("adam", (1.0,), (0.1,), 1.0, np.ones((1, 2)))
    answer = Estimate(MassDistribution(np.ones(2), np.ones(1)), "ok", covariance=np.eye(2), traces=(trace,))
    Store(tmp_path).put_estimate("key", {}, answer, load_object("L2").shape)
    with np.load(tmp_path / "estimates/key/estimate.npz") as arrays:
        written = [name.replace("adam", "<optimizer>") for name in arrays.files]
    assert names(table("results.md", "estimate.npz")) == written


COMMANDS_OF = {("command_line.md", head): head.split(", ") for head in headings("command_line.md") if "heft " in head}
COMMANDS_OF["hardware.md", "The commands"] = ["heft robot sensor", "heft robot trial"]


@pytest.mark.parametrize(("page", "heading"), COMMANDS_OF)
def test_every_named_option_exists(page, heading, capsys):
    for command in COMMANDS_OF[page, heading]:
        with pytest.raises(SystemExit):
            main([*command.split()[1:], "--help"])
    assert options(page, heading) <= set(re.findall(r"--[a-z][a-z-]+", capsys.readouterr().out))


def test_every_command_has_its_section(capsys):
    with pytest.raises(SystemExit):
        main(["--help"])
    listed = {f"heft {name}" for name in re.findall(r"^  (\w+)", capsys.readouterr().out, re.MULTILINE)}
    assert listed == {name for (page, _), names in COMMANDS_OF.items() if page == "command_line.md" for name in names}
