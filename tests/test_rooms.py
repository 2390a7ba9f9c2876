"""The rooms and who may import whom."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
ROOMS = ("testbed", "estimators", "scenarios", "viz")
# What a module of testbed may import from its own room; packages are listed by their folder
TESTBED = {
    "errors": set(),
    "arrays": {"errors"},
    "resources": {"errors"},
    "objects": {"errors", "arrays"},
    "blocks": {"errors", "arrays", "objects"},
    "rigid_body": {"arrays", "objects"},
    "export": {"errors", "objects", "rigid_body"},
    "gripper": set(),
    "meshes": {"errors", "gripper", "objects"},
    "object_files": {"errors", "objects", "blocks", "meshes", "resources"},
    "actions": {"errors", "arrays", "objects"},
    "frames": set(),
    "profile": {"actions"},
    "lift_profile": {"actions"},
    "tool_path": {"actions", "frames", "objects"},
    "table": {"objects", "tool_path"},
    "trajectory": {"errors", "arrays", "actions"},
    "foot_forces": {"errors", "arrays", "trajectory"},
    "trial": {"errors", "objects", "actions", "trajectory"},
    "sensing": {"errors", "arrays", "objects", "frames", "trajectory"},
    "reduction": {"errors", "arrays", "objects", "actions", "frames", "sensing", "trajectory"},
    "lift_reduction": {
        "errors",
        "arrays",
        "objects",
        "actions",
        "frames",
        "sensing",
        "trajectory",
        "reduction",
    },
    "drift": {"arrays", "sensing", "trajectory"},
    "replay": {"errors", "actions", "sensing", "trajectory", "trial"},
    "lab_logs": {
        "errors",
        "actions",
        "object_files",
        "objects",
        "frames",
        "trajectory",
        "sensing",
        "drift",
        "lab_logs",
    },
}
MODULES = sorted(path for room in ROOMS for path in (ROOT / room).rglob("*.py"))


def imports(path: Path) -> set[str]:
    """Every module that a file imports, anywhere in it."""
    found: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            found.add(node.module)
    return found


def name_of(path: Path) -> str:
    return ".".join(path.relative_to(ROOT).with_suffix("").parts)


@pytest.mark.parametrize("path", MODULES, ids=name_of)
def test_a_room_imports_only_what_it_may(path: Path):
    room, name, used = path.relative_to(ROOT).parts[0], name_of(path), imports(path)
    tops = {module.split(".")[0] for module in used}
    in_simulation, in_robot = (name.startswith(f"testbed.{part}") for part in ("simulation", "robot"))
    assert in_simulation or not tops & {"mujoco", "mink", "dm_control"}, "MuJoCo lives in testbed/simulation alone"
    assert in_robot or not tops & {"serial", "pymodbus", "kortex_api"}, "drivers live in testbed/robot alone"
    if room == "testbed":
        assert not tops & {"estimators", "scenarios", "viz"}
        inside = {m.split(".")[1] for m in used if m.startswith("testbed.")}
        assert not (in_robot and "simulation" in inside), "the real bench needs no simulator"
        if not (in_simulation or in_robot) and name != "testbed.__init__":
            assert "robot" not in inside, "a record says the same whoever made it"
            assert inside <= TESTBED[name.split(".")[1]], f"{name} may import {TESTBED[name.split('.')[1]]} of testbed"
    if room == "estimators":
        assert not tops & {"scenarios", "viz"}
        assert not any(m.startswith(("testbed.simulation", "testbed.robot")) for m in used)
    if room == "viz":
        assert not tops & {"estimators"} or all(m == "estimators.protocol" for m in used if m.startswith("estimators"))
    if room == "scenarios":
        assert not any(m.startswith("viz._") for m in used)


def test_the_table_has_every_module_of_testbed():
    modules = {path.stem for path in (ROOT / "testbed").glob("*.py")} - {"__init__"}
    folders = {path.parent.name for path in (ROOT / "testbed").glob("*/__init__.py")} - {"simulation", "robot"}
    assert modules | folders == set(TESTBED)


def test_no_pickle_and_no_bare_except():
    for path in MODULES:
        text = path.read_text(encoding="utf-8")
        assert "pickle" not in imports(path), path
        assert "except:" not in text, path
