"""Files of absurd sizes: refused with the limit, before they take time or memory, in a message of a few lines."""

import zipfile
from pathlib import Path

import numpy as np
import pytest

from estimators.registry import check_method
from scenarios.config import Scenario, load_scenario
from testbed.errors import HeftError, InvalidValueError
from testbed.objects.files import load_object

BLOCKS = 'name = "x"\n[blocks]\nlayout = {layout}\nmass_kg = {mass}\n'
PART = '[[mesh.parts]]\nname = "p"\nfile = "{file}"\nmass_kg = 1.0\n'
MESH = f'name = "x"\n[mesh]\ncell_m = 0.01\n{PART}'
SIZES = [
    (
        BLOCKS.format(layout=["1" * 1000] * 1000, mass=1.0),
        "1000 rows of up to 1000, .*at most 100 rows of 100",
    ),
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
