"""Direction of imports: testbed, then estimators, then viz, then scenarios; and where MuJoCo and drivers may be."""

import ast
from functools import cache
from pathlib import Path

ROOT = Path(__file__).parent.parent
PACKAGES = ("testbed", "estimators", "viz", "scenarios", "heft")
MODULES = sorted(path for package in PACKAGES for path in (ROOT / package).rglob("*.py"))
MOST_LINES = 500
MOST_MODULES = 12
MUJOCO = {"mujoco", "mink", "dm_control"}
DRIVERS = {"serial", "pymodbus", "kortex_api"}


def name_of(path: Path) -> str:
    return ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")


NAMES = {name_of(path): path for path in MODULES}


@cache
def imports(path: Path) -> frozenset[str]:
    """Modules that a file imports, in functions and for types too; `from package import module` counts."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    found: set[str] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            inner = {f"{node.module}.{alias.name}" for alias in node.names}
            found |= {name if name in NAMES else node.module for name in inner}
    return frozenset(found)


def test_a_package_imports_only_what_comes_before_it():
    for name, path in NAMES.items():
        tops = {module.split(".")[0] for module in imports(path)}
        later = set(PACKAGES[PACKAGES.index(name.split(".")[0]) + 1 :])
        assert not tops & later, f"{name} imports against the arrow {' -> '.join(PACKAGES)}"
        assert name.startswith("testbed.simulation") or not tops & MUJOCO, f"{name}: MuJoCo beside testbed/simulation"
        assert name.startswith("testbed.robot") or not tops & DRIVERS, f"{name}: drivers beside testbed/robot"
        if name.startswith("testbed.robot"):
            used = [module for module in imports(path) if module.startswith("testbed.simulation")]
            assert not used, f"{name}: the robot needs no simulator"


def test_no_imports_in_a_circle():
    graph = {name: imports(path) & set(NAMES) for name, path in NAMES.items()}
    done: set[str] = set()

    def follow(name: str, way: tuple[str, ...]) -> None:
        assert name not in way, f"imports in a circle: {' -> '.join((*way[way.index(name) :], name))}"
        if name not in done:
            for other in graph[name]:
                follow(other, (*way, name))
            done.add(name)

    for name in graph:
        follow(name, ())


def test_modules_are_short_and_folders_small():
    long = {name: n for name, path in NAMES.items() if (n := path.read_text(encoding="utf-8").count("\n")) > MOST_LINES}
    folders = {path.parent for path in MODULES}
    full = {
        str(folder.relative_to(ROOT)): n
        for folder in folders
        if (n := len([path for path in folder.glob("*.py") if path.name != "__init__.py"])) > MOST_MODULES
    }
    assert (long, full) == ({}, {})


def test_no_pickle_and_no_bare_except():
    for path in MODULES:
        assert "pickle" not in imports(path), path
        assert "except:" not in path.read_text(encoding="utf-8"), path
