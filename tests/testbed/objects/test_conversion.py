"""Mesh files as they come to objects: units, mending, poses, contacts, parts, grasps, and the files written."""

import json
import os
import struct
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from numpy.testing import assert_allclose

from scenarios.cli.main import main
from testbed import InvalidValueError, load_object
from testbed.objects.conversion.convert import convert_mesh, object_name, write_object
from testbed.objects.conversion.parts import cut, labelled
from testbed.objects.conversion.pose import contact_points, stable_poses
from testbed.objects.conversion.surface import as_mesh, read_surface
from tests.helpers.commands import ended, refusal
from tests.helpers.meshes import box, together

TOOLS = Path(os.environ.get("HEFT_TOOLS", Path(__file__).parents[4] / "shared" / "tools"))
HEAD, SHAFT = (0.04, 0.09, 0.03), (0.20, 0.03, 0.02)
RED, GREY = [200, 30, 30, 255], [120, 120, 120, 255]


def mallet(overlap: float = 0.0) -> trimesh.Trimesh:
    """A head and a shaft that abut or overlap, standing on end, m."""
    made = together(box(HEAD, (0, 0, 0), RED), box(SHAFT, (0.12 - overlap, 0, -0.005), GREY))
    return made.apply_transform(trimesh.transformations.rotation_matrix(1.1, [0.3, 1, 0.2]))


def saved(mesh: trimesh.Trimesh, path: Path, scale: float = 1.0) -> Path:
    """File of a mesh, in units of 1 / scale m."""
    mesh.copy().apply_scale(scale).export(path)
    return path


@pytest.mark.parametrize(
    ("name", "scale", "note"),
    [
        ("m.stl", 1.0, "unit m, taken from"),
        ("mm.obj", 1e3, "unit mm, taken from"),
        ("mm.ply", 1e3, "unit mm, taken from"),
        ("m.glb", 1.0, "unit m, as the file says"),
        ("mm.off", 1e3, "unit mm, taken from"),
        ("in.stl", 1 / 0.0254, "unit in, as asked; 229 mm"),
    ],
)
def test_every_format_is_one_object_in_meters(tmp_path: Path, name: str, scale: float, note: str):
    asked = "in" if name == "in.stl" else None
    made = convert_mesh(saved(mallet(), tmp_path / name, scale), unit=asked, parts="bodies")
    assert note in made.notes[0]
    assert_allclose(np.sort(made.volumes), np.sort([np.prod(HEAD), np.prod(SHAFT)]), rtol=1e-3)  # of triangles saved
    assert_allclose(joined_bounds(made.parts), [[-0.12, -0.045, 0], [0.12, 0.045, 0.03]], atol=1e-4)
    assert made.grasps


def joined_bounds(parts) -> np.ndarray:
    """Least and greatest coordinates of several meshes [m]."""
    return np.array([np.min([p.bounds[0] for p in parts], axis=0), np.max([p.bounds[1] for p in parts], axis=0)])


def cut_file(path: Path, how: str) -> None:
    cut(read_surface(path), how)


BAR = trimesh.creation.box((0.2, 0.03, 0.02))
SHEET, LARGE_SHEET = (trimesh.Trimesh([[0, 0, 0], [a, 0, 0], [0, a, 0]], [[0, 1, 2]]) for a in (0.1, 0.3))


@pytest.mark.parametrize(
    ("mesh", "scale", "call", "message"),
    [
        (mallet(), 1e6, read_surface, "file: got 'a longest side of "),
        (mallet(), 1e3, partial(read_surface, unit="m"), "units: got '229.* m long in m'"),
        (mallet(), 1.0, partial(read_surface, unit="ell"), "units: got 'ell'"),
        (together(mallet(), LARGE_SHEET), 1.0, read_surface, r"of which \d+ % of the surface encloses nothing"),
        (SHEET, 1.0, read_surface, "encloses a volume"),
        (BAR, 1.0, partial(convert_mesh, down="²"), "down: got '²'"),
        *((BAR, 1.0, partial(convert_mesh, cell=cell), "cell: .*a finite number > 0") for cell in (0.0, np.nan)),
        (BAR, 1.0, lambda path: convert_mesh(path, most_grasps=0).masses(("0.3",)), "mass: got '0.3'"),  # pyright: ignore[reportArgumentType]
        *((BAR, 1.0, partial(cut_file, how=how), "clusters:2 to") for how in ("clusters:1", "clusters:²")),
        *((BAR, 1.0, partial(cut_file, how=how), "planes as") for how in ("0", "99", "1.5", "color")),
    ],
)
def test_a_file_or_a_word_that_makes_no_object_is_refused(mesh, scale: float, call, message: str, tmp_path: Path):
    with pytest.raises(InvalidValueError, match=message):
        call(saved(mesh, tmp_path / "m.ply", scale))


HEAD_OF_CLOUD = "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\n"
Z, LABEL = "property float z\n", "property uchar label\nend_header\n"


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("solid", "points.ply'; allowed: a PLY of points .*Not a ply file"),
        (HEAD_OF_CLOUD + LABEL + "0 0 1\n1 0 1\n0 1 2\n", "points.ply'; allowed: a PLY of points with x, y and z"),
        (HEAD_OF_CLOUD + Z + LABEL + "0 0 0 1\n", "points.ply of 1 points'; allowed: 3 points, as its header states"),
    ],
)
def test_a_file_that_is_no_whole_cloud_is_refused(content: str, message: str, tmp_path: Path):
    cloud = tmp_path / "points.ply"
    cloud.write_text(content)
    with pytest.raises(InvalidValueError, match=f"parts: got '{message}"):
        convert_mesh(saved(BAR, tmp_path / "bar.stl"), parts=str(cloud))


def test_a_name_of_dots_is_no_name_of_a_file():
    assert [object_name(Path("a/mesh.ply"), name) for name in (None, "..", ".b c")] == ["a", "object", "b_c"]


def test_light_parts_are_written_with_their_masses(tmp_path: Path):
    made = convert_mesh(saved(BAR, tmp_path / "bar.stl"), parts="3", cell=0.01, most_grasps=0)
    assert_allclose(load_object(write_object(made, tmp_path, (1e-6,))).group_mass, 1e-6 / 3)


def with_tree(glb: bytes, change: Callable[[dict[str, Any]], object]) -> bytes:
    """A GLB file with another JSON part."""
    end = 20 + struct.unpack_from("<I", glb, 12)[0]
    tree = json.loads(glb[20:end])
    change(tree)
    text = json.dumps(tree).encode()
    text += b" " * (-len(text) % 4)
    head = glb[:8] + struct.pack("<I", 20 + len(text) + len(glb) - end) + struct.pack("<I", len(text)) + glb[16:20]
    return head + text + glb[end:]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda tree: tree["accessors"][1].update(count=4), "a triangle of vertex 7"),
        (lambda tree: tree["meshes"][0]["primitives"][0].update(mode=0), "no triangles in it"),
        (lambda tree: tree.update(nodes=[{"children": [1 - k], "mesh": 0} for k in (0, 1)]), "Iteration limit"),
        (lambda tree: tree["bufferViews"][0].update(byteLength=2**40), "allowed: a mesh that trimesh reads"),
    ],
    ids=["index", "points", "cycle", "length"],
)
def test_a_mesh_that_cannot_be_is_refused_in_a_line(change, message: str, tmp_path: Path):
    glb = trimesh.Scene(trimesh.creation.box((0.05, 0.05, 0.05))).export(file_type="glb")
    assert isinstance(glb, bytes)
    (tmp_path / "m.glb").write_bytes(with_tree(glb, change))
    with pytest.raises(InvalidValueError, match=message) as error:
        read_surface(tmp_path / "m.glb")
    assert "\n" not in str(error.value)


def split(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """The mesh with corners of its own for each flat face, as exporters split it at hard edges."""
    parts = [trimesh.Trimesh(mesh.vertices, mesh.faces[facet], process=False) for facet in mesh.facets]
    for part in parts:
        part.remove_unreferenced_vertices()
    return trimesh.util.concatenate(parts)  # pyright: ignore[reportReturnType]


@pytest.mark.parametrize("kind", ["glb", "ply", "obj"])
def test_corners_that_are_split_at_hard_edges_are_one_surface(kind: str, tmp_path: Path):
    whole = mallet(overlap=0.01)
    surface = read_surface(saved(split(whole), tmp_path / f"m.{kind}"), "m")
    assert len(split(whole).vertices) == 2 * len(whole.faces)
    assert surface.notes[0].endswith("2 bodies") and surface.notes[1:] == ()
    assert_allclose(surface.whole.volume(), read_surface(saved(whole, tmp_path / "whole.ply")).whole.volume())


@pytest.mark.parametrize("kind", ["stl", "obj", "ply", "glb"])
def test_a_pointer_of_git_lfs_is_named(kind: str, tmp_path: Path):
    path = tmp_path / f"m.{kind}"
    path.write_text("version https://git-lfs.github.com/spec/v1\noid sha256:00\nsize 1\n", encoding="ascii")
    with pytest.raises(InvalidValueError, match="git lfs pull"):
        read_surface(path)


@pytest.mark.slow
def test_a_large_object_has_cells_that_its_grid_can_hold(tmp_path: Path):
    made = convert_mesh(saved(trimesh.creation.box((2.0, 1.5, 0.02)), tmp_path / "plate.stl"))
    assert made.cell > 0.01 and made.model([1.0], 0.5).shape.cell == made.cell
    with pytest.raises(InvalidValueError, match="check the unit"):
        convert_mesh(tmp_path / "plate.stl", cell=0.01).model([1.0], 0.5)


def test_open_inverted_and_doubled_surfaces_are_repaired(tmp_path: Path):
    whole = mallet(overlap=0.01)
    broken = {
        "hole": trimesh.Trimesh(whole.vertices, whole.faces[[0, *range(2, 24)]], process=False),
        "turned": trimesh.Trimesh(whole.vertices, np.vstack([whole.faces[:12, ::-1], whole.faces[12:]]), process=False),
        "one way": trimesh.Trimesh(whole.vertices, np.vstack([whole.faces[:1, ::-1], whole.faces[1:]]), process=False),
        "doubled": trimesh.Trimesh(whole.vertices, np.vstack([whole.faces, whole.faces[:2, ::-1]]), process=False),
    }
    union = np.prod(HEAD) + np.prod(SHAFT) - 0.01 * SHAFT[1] * SHAFT[2]
    for why, mesh in broken.items():
        surface = read_surface(saved(mesh, tmp_path / f"{why}.ply"))
        assert any(why in note or "filled" in note for note in surface.notes[1:]), surface.notes
        assert_allclose(surface.whole.volume(), union, rtol=1e-4)
    assert read_surface(saved(whole, tmp_path / "whole.ply")).notes[1:] == ()


def test_a_cavity_stays_a_cavity(tmp_path: Path):
    inner = trimesh.creation.box((0.02, 0.02, 0.02))
    inner.invert()
    hollow = together(trimesh.creation.box((0.06, 0.06, 0.06)), inner)
    (body,) = read_surface(saved(hollow, tmp_path / "hollow.ply")).bodies
    assert_allclose(body.volume(), 0.06**3 - 0.02**3, rtol=1e-9)


@pytest.mark.parametrize("facets", [24, 48, 64, 256])
def test_a_curved_side_is_one_pose_however_fine_it_is(tmp_path: Path, facets: int):
    """A cylinder rests on its side in five of six falls."""
    mesh = trimesh.creation.cylinder(0.015, 0.045, sections=facets)
    poses = stable_poses(read_surface(saved(mesh, tmp_path / "cylinder.stl")))
    assert_allclose([pose.probability for pose in poses], [0.833, 0.083, 0.083], atol=0.003)
    assert_allclose([abs(pose.matrix[2, 2]) for pose in poses], [0, 1, 1], atol=1e-6)


def test_sides_of_a_prism_are_poses_of_their_own(tmp_path: Path):
    mesh = trimesh.creation.cylinder(0.015, 0.045, sections=6)
    assert len(stable_poses(read_surface(saved(mesh, tmp_path / "prism.stl")))) == 8


def test_a_gap_between_bodies_moves_no_cut(tmp_path: Path):
    """The width changes at 160 mm; nothing lies from 40 to 120 mm."""
    boxes = [
        trimesh.creation.box(bounds=[[begin, -wide / 2, 0], [end, wide / 2, 0.02]])
        for begin, end, wide in ((0.0, 0.04, 0.05), (0.12, 0.16, 0.05), (0.16, 0.2, 0.02))
    ]
    surface = read_surface(saved(together(*boxes), tmp_path / "gap.stl"))
    last = max(cut(surface, "clusters:2")[0], key=lambda part: part.bounding_box()[3])
    assert last.bounding_box()[0] == pytest.approx(0.16, abs=0.004)


def test_parts_by_bodies_colours_planes_and_points_share_the_volume(tmp_path: Path):
    surface = read_surface(saved(mallet(overlap=0.01), tmp_path / "mallet.ply"))
    surface = surface.transformed(stable_poses(surface)[0].matrix)
    whole = surface.whole.volume()
    for how, count in (("bodies", 2), ("colours", 2), ("3", 3), ("0.2,0.5,0.7", 4), ("1", 1), ("auto", 2)):
        parts, _ = cut(surface, how)
        assert len(parts) == count
        assert_allclose(sum(part.volume() for part in parts), whole, rtol=1e-4)
        assert all(as_mesh(part).is_volume for part in parts)
    head, shaft = cut(surface, "clusters:2")[0]  # where the width changes: the slices are 2 mm
    assert_allclose(sorted([head.volume(), shaft.volume()]), [np.prod(HEAD), 0.95 * np.prod(SHAFT)], rtol=0.05)
    # one body alone, whose points have two labels: it is cut where the labels meet
    bar = read_surface(saved(BAR, tmp_path / "bar.ply"))
    left = (bar.points[:, 0] < 0.02).astype(int)
    parts, _ = cut(replace(bar, labels=left), "colours")
    assert_allclose([part.volume() for part in parts], np.array([0.12, 0.08]) * 0.03 * 0.02, rtol=0.02)
    cloud = tmp_path / "cloud.ply"
    rows = [f"{x * 1e3} {y * 1e3} {z * 1e3} {k}" for (x, y, z), k in zip(bar.points[:500], left[:500], strict=True)]
    head = "ply\nformat ascii 1.0\nelement vertex 500\nproperty float x\nproperty float y\nproperty float z\n"
    cloud.write_text(head + "property uchar segmentation\nend_header\n" + "\n".join(rows) + "\n")
    parts, _ = cut(labelled(bar, cloud), "colours")
    assert_allclose([part.volume() for part in parts], np.array([0.12, 0.08]) * 0.03 * 0.02, rtol=0.05)


def test_a_tripod_stands_on_its_three_feet(tmp_path: Path):
    feet = [(0.06, 0.0), (-0.04, 0.05), (-0.04, -0.05)]
    legs = [box((0.004, 0.004, 0.02), (x, y, 0.01), GREY) for x, y in feet]
    disc = trimesh.creation.cylinder(radius=0.08, height=0.02, sections=48)
    stool = together(disc.apply_translation((0, 0, 0.03)), *legs)
    path = saved(stool, tmp_path / "stool.stl", 1e3)
    made = convert_mesh(path, down="-z", parts="1")
    assert len(made.pose.contacts) in range(3, 7)
    near = np.array([np.linalg.norm(made.pose.contacts - c, axis=1).min() for c in made.pose.contacts])
    assert (near < 1e-9).all()
    assert_allclose(np.linalg.norm(made.pose.contacts, axis=1), np.linalg.norm(feet, axis=1).mean(), atol=0.012)
    shape = made.model().shape
    assert shape.is_contact.sum() == len(made.pose.contacts) and not made.model().masses_known
    table = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0.5, 0.5, 1.0], [0.5, 0, 0]])
    assert len(contact_points(table, np.array([0.5, 0.5]))) == 4
    assert_allclose(contact_points(table, np.array([0.1, 0.1])).tolist(), [[0, 0], [1, 0], [0, 1]])  # one foot lifts
    with pytest.raises(InvalidValueError, match="in one line"):
        contact_points(np.array([[0, 0, 0], [1, 0, 0], [0.5, 0.5, 1]]), np.zeros(2))


def test_grasps_are_across_the_shaft_and_spread_over_it(tmp_path: Path):
    made = convert_mesh(saved(mallet(), tmp_path / "mallet.ply"), most_grasps=4)
    grasps = made.model().shape.grasps
    assert len(grasps) == 4
    for grasp in grasps:
        across_shaft = abs(np.sin(grasp.angle)) > 0.99
        assert_allclose(grasp.width, SHAFT[1] if across_shaft else HEAD[0], atol=2e-4)
    apart = [np.linalg.norm(a.position - b.position) for a in grasps for b in grasps if a is not b]
    assert min(apart) > 0.012


def test_a_number_of_grasps_below_zero_is_refused(capsys):
    assert refusal(capsys, "mesh", "any.stl", "--grasps", "-1") == "heft: --grasps: got -1; allowed: an integer >= 0\n"


def test_a_second_file_of_an_objects_name_is_refused(tmp_path: Path, capsys):
    files = [tmp_path / folder / "body.stl" for folder in "ab"]
    for size, file in enumerate(files, start=1):
        file.parent.mkdir()
        trimesh.creation.box((0.1 * size, 0.03, 0.03)).export(file)
    out = tmp_path / "out"
    assert ended("mesh", *map(str, files), "--out", str(out), "--units", "m", "--mass", "0.5") == 1
    assert f"FILE: got '{files[1]}'; allowed: a file of another name" in capsys.readouterr().out
    assert np.ptp(load_object(out / "body.toml").shape.particles[:, 0]) < 0.15, "the first is kept"


@pytest.mark.slow
def test_the_files_are_an_object_that_loads_as_it_was_made(tmp_path: Path, capsys):
    path = saved(mallet(), tmp_path / "my mallet.ply")
    made = convert_mesh(path)
    model = made.model((0.4, 0.2))
    loaded = load_object(write_object(made, tmp_path / "by_hand", (0.4, 0.2)))
    assert loaded.name == "my_mallet"
    assert_allclose(loaded.shape.particles, model.shape.particles, atol=1e-6)
    assert_allclose(loaded.group_mass, [0.4, 0.2])
    main(["mesh", str(path), "--out", str(tmp_path / "out"), "--mass", "0.6"])
    printed = capsys.readouterr().out
    assert "2 parts by colours" in printed and "rests on" in printed
    object_of_command = load_object(tmp_path / "out" / "my_mallet.toml")
    assert_allclose(object_of_command.group_mass, 0.6 * made.volumes / made.volumes.sum(), atol=1e-6)
    assert (tmp_path / "out" / "my_mallet.png").stat().st_size > 10_000
    main(["identify", str(tmp_path / "out" / "my_mallet.toml"), "--pivots", "0"])
    assert "my_mallet, rigid, " in capsys.readouterr().out
    assert ended("mesh", str(path), str(tmp_path / "none.stl"), "--out", str(tmp_path / "out")) == 1
    assert "a mesh file; there is none" in capsys.readouterr().out
    with pytest.raises(InvalidValueError, match="2, one per part"):
        made.masses((1.0, 2.0, 3.0))


@pytest.mark.slow
@pytest.mark.skipif(not TOOLS.is_dir(), reason="no folder of real tools: HEFT_TOOLS names one")
@pytest.mark.parametrize("name", ["Adjustable_Wrench", "Allen_Key", "Bent_Jaw_Pliers", "Ruler", "Socket_Wrench"])
def test_real_tools_are_objects(name: str):
    made = convert_mesh(TOOLS / name / "mesh.ply", most_grasps=0)
    model = made.model((0.3,))
    assert model.name == name and model.shape.n_m > 1
    assert 3 <= model.shape.is_contact.sum() <= 6
    assert_allclose(model.total_mass, 0.3)
    assert_allclose(model.particle_mass @ model.shape.particles / 0.3, model.center_of_mass, atol=1e-9)
