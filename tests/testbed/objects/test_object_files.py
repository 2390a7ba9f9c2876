"""Object files: contents of the library, refusals of wrong files, and files of absurd sizes."""

import json
import shutil
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from estimators.registry import check_method
from scenarios.config import Scenario, load_scenario
from testbed.errors import HeftError, InvalidValueError
from testbed.objects.files import asset_folder, load_object, object_names
from testbed.toml import InvalidFileError

HEAD = 'name = "X"\n[blocks]\n'
PAIR = HEAD + 'layout = ["11"]\n'


@pytest.fixture
def written(tmp_path: Path):
    """Writes an object file beside the mesh of the hammer's head, and returns its path."""
    shutil.copy(asset_folder("objects") / "hammer_head.stl", tmp_path)

    def write(text: str) -> Path:
        path = tmp_path / "thing.toml"
        path.write_text(text, encoding="utf-8")
        return path

    return write


def test_every_object_of_the_library_can_be_loaded():
    assert {"I1", "I2", "L1", "L2", "F1", "F2", "hammer", "wrench"} <= set(object_names())
    made = {name: load_object(name) for name in object_names()}
    assert [obj.name for obj in made.values()] == list(made)
    for name in ("I2", "L2", "F2"):
        assert_allclose(made[name].group_mass, [0.4, 0.1, 0.1, 0.4, 0.4, 0.4], rtol=1e-12)


@pytest.mark.parametrize("grid", [1, 2, 4])
def test_the_grid_changes_particles_but_not_the_object(grid: int):
    reference, made = load_object("L2"), load_object("L2", grid)
    assert made.shape.particles_per_group.tolist() == [grid**2] * 6
    assert_allclose(made.shape.particles.mean(axis=0), 0, atol=1e-15)
    assert_allclose(len(made.shape.particles) * made.shape.cell**2, 6 * 0.05**2, rtol=1e-12)
    assert_allclose(made.center_of_mass, reference.center_of_mass, atol=1e-15)
    assert_allclose(made.inertia_cm, reference.inertia_cm, rtol=1e-12)


@pytest.mark.parametrize(
    ("lines", "mass", "friction", "groups"),
    [
        ("mass_kg = [0.2, 0.3]\nfriction = [0.4, 0.6]\nfriction_group = [1, 0]", [0.2, 0.3], [0.4, 0.6], [1, 0]),
        ("mass_kg = 0.2", [0.2, 0.2], [0.5], [0, 0]),
        ("mass_kg = 0.2\nfriction_group = [0, -1]", [0.2, 0.2], [0.5], [0, -1]),  # hangs clear of the table
        ("mass_kg = [1, 2]\nfriction = 1", [1.0, 2.0], [1.0], [0, 0]),
    ],
)
def test_a_file_by_path_with_defaults(written, lines: str, mass, friction, groups):
    made = load_object(written(PAIR + lines), grid=2)
    assert_allclose(made.group_mass, mass, rtol=1e-12)
    assert made.truth.friction.tolist() == friction
    assert made.shape.friction_group.tolist() == np.repeat(groups, 4).tolist()
    assert (made.shape.cell, made.shape.height) == (0.025, 0.03)


@pytest.mark.parametrize(
    ("name", "grid", "message"),
    [
        *(
            (given, 3, rf"object: got '{given}'; .*F1, F2, I1.*nearest: {nearest}\)")
            for given, nearest in (("l2", "L2"), ("f1", "F1"), ("i2", "I2"), ("L3", "L2"), ("F12", "F2"))
        ),
        ("no.toml", 3, r"no\.toml'; allowed: a path to an existing \.toml file"),
        *(("I1", bad, f"grid: got {bad}; allowed: an integer >= 1") for bad in (0, -1, True, 1.5)),
    ],
)
def test_an_unknown_object_or_a_wrong_grid_is_refused(name: str, grid: Any, message: str, tmp_path: Path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InvalidValueError, match=message):
        load_object(name, grid)


@pytest.mark.parametrize("content", [b"name = ", b"\xff\xfe", b"[blocks]\n[blocks]\n"])
def test_a_file_that_is_not_toml_is_named(tmp_path: Path, content: bytes):
    path = tmp_path / "thing.toml"
    path.write_bytes(content)
    with pytest.raises(InvalidFileError, match=r"thing\.toml: cannot be read as TOML"):
        load_object(path)


WRONG_BLOCKS = [
    ("mass_kg = -0.4", "mass_kg: got -0.4; allowed: greater than 0"),
    ("mass_kg = 0", "mass_kg: got 0"),
    ("mass_kg = [0.4, -0.1]", "mass_kg.1: got -0.1"),
    ("mass_kg = nan", "mass_kg: got nan; allowed: a finite number"),
    ("mass_kg = [0.4, inf]", "mass_kg.1: got inf"),
    ('mass_kg = "0.4"', "mass_kg: got '0.4'; allowed: a valid number"),
    ("mass_kg = true", "mass_kg: got True"),
    ('mass_kg = ["0.4", 0.1]', "mass_kg.0: got '0.4'"),
    ("mass_kg = [0.4]", "mass_kg: got [0.4]; allowed: 2 numbers >= 0, one per block, bottom row first"),
    ("mass_kg = [0, 0]", "mass_kg: got [0.0, 0.0]"),
    ("mass_kg = 0.4\nfriction = -0.5", "friction: got -0.5"),
    ("mass_kg = 0.4\nfriction = nan", "friction: got nan"),
    ("mass_kg = 0.4\nfriction = []", "friction: got []"),
    ("mass_kg = 0.4\nfriction = [true]", "friction.0: got True"),
    ("mass_kg = 0.4\nfriction = [0.4, 0.5]", "friction_group: got None; allowed: 2 integers, one per block"),
    *((f"mass_kg = 0.4\nfriction_group = {bad}", f"friction_group: got {bad}; allowed: 2 integers")
      for bad in ([0], [0, 7], [0, 1], [0, -2], [-1, -1])),
    ('mass_kg = 0.4\nfriction_group = ["0", 0]', "friction_group.0: got '0'"),
    ("mass_kg = 0.4\nfriction_group = [0, true]", "friction_group.1: got True"),
    ('mass_kg = 0.4\nsize_m = "0.05"', "size_m: got '0.05'"),
    ("mass_kg = 0.4\nsize_m = 0", "size_m: got 0"),
    ("mass_kg = 0.4\nheight_m = true", "height_m: got True"),
    ("mass_kg = 0.4\nheight_m = inf", "height_m: got inf"),
    ("mass_kg = [9, 20]", "mass_kg: got 20.0; allowed: at most 15 kg in a block of 0.05 x 0.05 x 0.03 m"),
    ("mass_kg = 0.4\nweight = 3", "weight: no such field; got 3"),
    ('mass_kg = 0.4\nlayout = ["1", "0", "1"]', "layout: got 'A3 apart from A1'"),
    ('mass_kg = 0.4\nlayout = ["1x"]', "layout: got 'x'"),
    ("mass_kg = 0.4\nlayout = []", "layout: got []"),
]  # fmt: skip


def test_masses_may_be_left_out_where_trials_are_measured(written):
    path = written(PAIR)
    with pytest.raises(HeftError, match=r"mass_kg: got None; allowed: masses: only what a real robot measures"):
        load_object(path)
    unknown, known = load_object(path, measured=True), load_object(written(PAIR + "mass_kg = 0.4"), measured=True)
    assert (unknown.masses_known, known.masses_known) == (False, True)
    assert np.array_equal(unknown.shape.particles, known.shape.particles)


PARTS = '[[mesh.parts]]\nname = "head"\nfile = "hammer_head.stl"\nmass_kg = 1.2\n'
GRASP = '[[mesh.grasps]]\nname = "middle"\nat_m = [0.02, 0.0]\nclosing_deg = 0\n'
MESH_FILE = 'name = "X"\n[mesh]\ncell_m = 0.01\n' + PARTS + GRASP
HINGED = PAIR + "mass_kg = 1\n[[hinges]]\nat_m = [0.0, 0.0]\nlink = ['B1']\n"


def test_a_mesh_file_with_defaults(written):
    made = load_object(written(MESH_FILE))
    assert made.truth.friction.tolist() == [0.5]
    assert made.shape.group_names == ("head",)
    assert [g.name for g in made.shape.grasps] == ["middle"]
    assert_allclose(made.group_mass, [1.2], rtol=1e-12)
    assert_allclose(made.shape.cell, 0.01)


WRONG_MESHES = [
    ("", PARTS, "mesh.cell_m: missing"),
    ("cell_m = 0\n", PARTS, "mesh.cell_m: got 0"),
    ("cell_m = 0.5\n", PARTS, "mesh.cell_m: got 0.5; allowed: less than or equal to 0.1"),
    ("cell_m = nan\n", PARTS, "mesh.cell_m: got nan"),
    ('cell_m = "0.01"\n', PARTS, "mesh.cell_m: got '0.01'; allowed: a valid number"),
    ("cell_m = 0.01\nfriction = -1\n", PARTS, "mesh.friction: got -1; allowed: greater than or equal to 0"),
    ("cell_m = 0.01\nfriction = []\n", PARTS, "mesh.friction: got []; allowed: a number >= 0, or a list of one"),
    ("cell_m = 0.01\nfriction = [0.3, 0.4]\n", PARTS, "mesh.parts.friction_group: got [None]; allowed: an integer"),
    ("cell_m = 0.01\n", PARTS + "friction_group = 1", "mesh.parts.friction_group: got [1]; allowed: an integer"),
    ("cell_m = 0.01\n", PARTS + "friction_group = -1", "mesh.parts.0.friction_group: got -1"),
    ("cell_m = 0.01\n", PARTS + "friction_group = true", "mesh.parts.0.friction_group: got True"),
    ("cell_m = 0.01\nsize = 3\n", PARTS, "mesh.size: no such field; got 3"),
    ("cell_m = 0.01\n", "parts = []", "mesh.parts: got []"),
    ("cell_m = 0.01\n", "", "mesh.parts: missing"),
    ("cell_m = 0.01\n", PARTS.replace("1.2", "0"), "mesh.parts.0.mass_kg: got 0; allowed: greater than 0"),
    ("cell_m = 0.01\n", PARTS.replace("1.2", "inf"), "mesh.parts.0.mass_kg: got inf"),
    ("cell_m = 0.01\n", PARTS + "weight = 1", "mesh.parts.0.weight: no such field; got 1"),
    ("cell_m = 0.01\n", PARTS * 2, "mesh.parts: got ['head', 'head']; allowed: names that differ"),
    ("cell_m = 0.01\n", PARTS.replace("head.stl", "tail.stl"), "mesh.parts.0.file: got 'hammer_tail.stl'"),
    ("cell_m = 0.01\n", PARTS + GRASP.replace(", 0.0", ""), "mesh.grasps.0.at_m: got [0.02]"),
    ("cell_m = 0.01\n", PARTS + GRASP.replace("0.02", "nan"), "mesh.grasps.0.at_m.0: got nan"),
    ("cell_m = 0.01\n", PARTS + GRASP.replace("0\n", "true\n"), "mesh.grasps.0.closing_deg: got True"),
    ("cell_m = 0.01\n", PARTS + GRASP * 2, "mesh.grasps: got ['middle', 'middle']; allowed: names that differ"),
    ("cell_m = 0.01\n", PARTS + GRASP.replace("0.02", "0.2"), "mesh.grasps.0.at_m: got [0.2, 0.0]"),
    ("cell_m = 0.01\n", PARTS + GRASP.replace("= 0\n", "= 90\n"), "mesh.grasps.0.at_m: got '110 mm across'"),
]  # fmt: skip


RULE = 'name = "rule"\n[blocks]\nlayout = ["111111"]\nsize_m = 0.03\nheight_m = 0.02\nmass_kg = 0.1\n'
WRONG_HINGES = [
    ([(-0.03, ["A1", "B1"]), (0.03, ["E1", "F1"])], "hinges.1.at_m: .* A1, B1 is 65 mm away"),
    ([(-9.0, ["D1", "E1", "F1"])], "hinges.0.at_m: .* a place at both its links"),
    ([(-0.03, ["C1", "D1"]), (0.03, ["D1", "E1", "F1"])], "hinges.1.link: got .*D1.*: a block or part is in one link"),
    ([(0.0, ["A1", "B1", "C1", "D1", "E1", "F1"])], "one or more that no hinge names, the first link"),
    ([(0.0, ["G1"])], "some of A1, B1"),
]
ONE_KIND = "blocks or mesh: got '{}'; allowed: exactly one of [blocks] and [mesh]"


def joined(hinges: list[tuple[float, list[str]]]) -> str:
    return RULE + "".join(f"[[hinges]]\nat_m = [{x}, 0.0]\nlink = {json.dumps(link)}\n" for x, link in hinges)


@pytest.mark.parametrize(
    ("text", "messages"),
    [
        *(((HEAD if "layout" in line else PAIR) + line, [f"{{path}}: blocks.{part}"]) for line, part in WRONG_BLOCKS),
        *((f'name = "X"\n[mesh]\n{mesh}{rest}', [f"{{path}}: {part}"]) for mesh, rest, part in WRONG_MESHES),
        (HINGED.replace("X", "link_1"), ["{path}: name: got ['link_1']"]),
        (MESH_FILE.replace(PARTS, PARTS + PARTS.replace("head", "head_0", 1)), ["{path}: name: got ['head_0']"]),
        ('name = "X"', [ONE_KIND.format("neither")]),
        (MESH_FILE + "[blocks]\nlayout = ['1']\nmass_kg = 1", [ONE_KIND.format("both")]),
        (
            HEAD + "size_m = -1\ncolor = 3",  # all errors at once
            ["blocks.layout: missing", "blocks.size_m: got -1", "blocks.color: no such field"],
        ),
    ],
)
def test_a_wrong_field_is_refused_with_file_field_and_value(written, text: str, messages: list[str]):
    path = written(text)
    with pytest.raises(HeftError) as refused:
        load_object(path)
    for message in messages:
        assert message.replace("{path}", str(path)) in str(refused.value)


@pytest.mark.parametrize(("hinges", "message"), WRONG_HINGES)
def test_hinges_that_join_nothing_are_refused(written, hinges, message: str):
    with pytest.raises(InvalidValueError, match=message):
        load_object(written(joined(hinges)))


BLOCKS = 'name = "x"\n[blocks]\nlayout = {layout}\nmass_kg = {mass}\n'
PART = '[[mesh.parts]]\nname = "p"\nfile = "{file}"\nmass_kg = 1.0\n'
MESH = f'name = "x"\n[mesh]\ncell_m = 0.01\n{PART}'
SIZES = [
    (BLOCKS.format(layout=["1" * 1000] * 1000, mass=1.0), "1000 rows of up to 1000, .*at most 100 rows of 100"),
    (BLOCKS.format(layout=["11"], mass="1e300"), "1e.300 is larger than 1e.15"),
    (BLOCKS.format(layout=["11"], mass="9" * 5000), "limit"),
    (MESH.format(file="x.stl") + PART.format(file="x.stl") * 100, "at most 64 items"),
    ("a = " + "[" * 5000 + "]" * 5000, "nested deeper than 32"),
    (".".join(["a"] * 100) + " = 1", "nested deeper than 32"),
    ('"a"."a". ' * 20_000 + "a = 1", "nested deeper than 32"),
    (BLOCKS.format(layout=["11"], mass="[0.3, 300]"), r"blocks.mass_kg.1: got 300 kg; allowed: at most 50 kg"),
    ("[[hinges]]\nat_m = [-30.0, 0.0]", r"hinges.0.at_m.0: got -30 m; allowed: at most 10 m"),
    ("[camera]\nsettings = { in_base_m = [450, 0, 800] }", r"camera.settings.in_base_m.2: got 800 m"),
    ("size_m = 1e9", r"size_m: got 1e.09 m; allowed: at most 10 m"),
    ("a = [" + "1," * 110_000 + "]", "more than 100000 values"),
    ("#" * 2_000_000, "2 MiB, more than the 1"),
    ("a" * 100_000 + " = 1", "aaa[.]{3}: no such field"),
    ("".join(f"k{i} = 1\n" for i in range(1000)), "and 981 more"),
    (BLOCKS.format(layout=["x" * 50] * 90, mass=1.0), "layout: got 'x'"),
    (MESH.format(file="bomb.zip"), "a mesh file: stl, obj, ply, off"),
    (MESH.format(file="many.stl"), "101000 triangles'; allowed: at most 100000"),
    (MESH.format(file="large.stl"), "9 MiB, more than the 8"),
    (MESH.format(file="lies.stl"), "a mesh"),
    (MESH.format(file="far.stl"), "with a coordinate of 1e.03 m'; allowed: meters, below 10"),
]


def triangles(count: int, scale: float = 0.1) -> bytes:
    """Binary STL of loose triangles."""
    shape = [("normal", "<3f4"), ("corners", "<9f4"), ("attribute", "<u2")]
    table = np.zeros(count, dtype=shape)
    table["corners"] = np.random.default_rng(0).uniform(0, scale, size=(count, 9))
    table["corners"][:1] = scale
    return bytes(80) + np.uint32(count).tobytes() + table.tobytes()


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("sizes")
    with zipfile.ZipFile(path / "bomb.zip", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("a.stl", bytes(10_000_000))
    (path / "many.stl").write_bytes(triangles(101_000))
    (path / "large.stl").write_bytes(bytes(9 * 2**20))
    (path / "lies.stl").write_bytes(bytes(80) + np.uint32(4_000_000_000).tobytes())
    (path / "far.stl").write_bytes(triangles(4, 1e3))
    return path


@pytest.mark.parametrize(("text", "said"), SIZES, ids=[said for _, said in SIZES])
def test_an_object_of_absurd_size_is_refused_with_the_limit(folder, text, said):
    path = folder / "x.toml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(HeftError, match=said) as refused:
        load_object(path)
    assert len(str(refused.value)) < 3000


def test_a_scenario_of_absurd_size_is_refused_with_the_limit(tmp_path):
    axes = {"seeds": list(range(1, 1001)), "policy.seed": list(range(1000))}
    path = tmp_path / "s.toml"
    path.write_text(f'objects = ["I1"]\n[sweep.axes]\nseeds = {axes["seeds"]}\n"policy.seed" = {axes["policy.seed"]}\n')
    with pytest.raises(HeftError, match="1000000 points'; allowed: at most 10000 combinations"):
        load_scenario(str(path))
    for name, settings, said in (
        ("diff_lcp", {"directions": 10**9}, ">= 4 and <= 256"),
        ("random_search", {"iterations": 10**9}, "<= 1000000"),
    ):
        with pytest.raises(InvalidValueError, match=said):
            check_method(name, settings)
        with pytest.raises(ValueError, match=said):
            Scenario.model_validate({"objects": ["I1"], "methods": {name: settings}})


def test_a_long_value_is_cut_in_a_message():
    text = str(InvalidValueError("f" * 1000, "g" * 10_000, "less"))
    assert len(text) < 300 and "f..." in text and "g..." in text
