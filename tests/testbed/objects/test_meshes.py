"""Objects made of meshes: partition into particles, solids, and what a gripper's pads find."""

import io
import runpy
from collections.abc import Sequence
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import trimesh
from numpy.testing import assert_allclose

from testbed.errors import InvalidValueError
from testbed.frames import cross_2d
from testbed.objects.faces import faces, room_at
from testbed.objects.files import asset_folder, load_object
from testbed.objects.grasps import GraspPlace
from testbed.objects.meshes import Part, mesh_object, read_mesh
from testbed.objects.model import ObjectModel, Solid
from testbed.objects.rays import RayGrid, grid_hits
from tests.helpers.meshes import together

OBJECTS = asset_folder("objects")
TOOLS = {"hammer": ("hammer_head", "hammer_handle"), "wrench": ("wrench_jaw", "wrench_ring")}


@cache
def tool(name: str, grid: int = 3) -> ObjectModel:
    return load_object(name, grid)


def box(size: tuple[float, float, float], corner: tuple[float, float, float] = (0, 0, 0)) -> trimesh.Trimesh:
    """Box with its lowest corner at `corner`, m."""
    mesh = trimesh.creation.box(size)
    mesh.apply_translation(np.array(corner) + np.array(size) / 2)
    return mesh


def cut(
    *meshes: trimesh.Trimesh,
    mass: float = 0.4,
    cell: float = 0.01,
    grid: int = 3,
    places: list[GraspPlace] | None = None,
    contacts: Sequence[tuple[float, float]] = (),
) -> ObjectModel:
    """Meshes as an object, a part each, all of one friction."""
    parts = [Part(f"p{i}", mesh, mass, 0) for i, mesh in enumerate(meshes)]
    return mesh_object("X", parts, places or [], friction=[0.5], cell=cell, grid=grid, contacts=contacts)


def across(x: float, y: float, degrees: float = 90.0) -> list[GraspPlace]:
    """One place to grip."""
    return [GraspPlace("here", (x, y), np.radians(degrees))]


def test_a_box_is_cut_into_the_cells_of_its_footprint():
    made = cut(box((0.06, 0.04, 0.02), (0.3, -0.1, 0)))
    assert len(made.shape.particles) == 24
    assert_allclose(made.shape.particles.mean(axis=0), 0, atol=1e-15)
    assert_allclose(np.ptp(made.shape.particles, axis=0), [0.05, 0.03], atol=1e-12)
    assert (made.shape.friction_group == 0).all()
    assert_allclose(made.shape.height, 0.02)
    assert_allclose(made.total_mass, 0.4, rtol=1e-15)
    assert_allclose(made.center_of_mass, 0, atol=1e-12)
    assert_allclose(made.inertia_cm, 0.4 * (0.06**2 + 0.04**2) / 12, rtol=1e-9)
    assert_allclose(made.truth.mass, [0.4 / 24])


@pytest.mark.parametrize(("grid", "side"), [(1, 0.03), (2, 0.015), (3, 0.01), (6, 0.005)])
def test_the_grid_sets_the_cell_against_the_files_at_three(grid: int, side: float):
    made = cut(box((0.06, 0.06, 0.02)), grid=grid)
    assert_allclose(made.shape.cell, side)
    assert len(made.shape.particles) == (2 * grid) ** 2


def test_cells_touch_only_where_the_underside_is_at_the_table():
    table = together(
        box((0.02, 0.03, 0.02)), box((0.02, 0.03, 0.02), (0.08, 0, 0)), box((0.06, 0.02, 0.01), (0.02, 0.005, 0.01))
    )
    made = cut(table)
    column = np.round((made.shape.particles[:, 0] - made.shape.particles[:, 0].min()) / 0.01).astype(int)
    touches = made.shape.friction_group >= 0
    assert set(column[touches]) == {0, 1, 8, 9}
    assert set(column[~touches]) == {2, 3, 4, 5, 6, 7}


def test_a_cell_belongs_to_the_part_with_most_material_in_it():
    # the middle cells hold 4 mm of the first part, 6 mm of the second along x, but the first is thrice as high
    first, second = box((0.024, 0.02, 0.03)), box((0.026, 0.02, 0.01), (0.024, 0, 0))
    assert cut(first, second).shape.mass_group.tolist() == [0] * 6 + [1] * 4
    first, second = box((0.024, 0.02, 0.01)), box((0.026, 0.02, 0.01), (0.024, 0, 0))
    assert cut(first, second).shape.mass_group.tolist() == [0] * 4 + [1] * 6


def test_finer_cells_come_nearer_to_the_area_and_the_moments_of_a_disc():
    disc = trimesh.creation.cylinder(radius=0.03, height=0.02, sections=90)
    disc.apply_translation([0, 0, 0.01])
    errors = []
    for grid in (3, 9):
        shape = cut(disc, grid=grid).shape
        area = len(shape.particles) * shape.cell**2 / (np.pi * 0.03**2)
        inertia = np.mean(np.sum(shape.particles**2, axis=1)) / (0.03**2 / 2)
        errors.append(max(abs(area - 1), abs(inertia - 1)))
    assert errors[0] < 0.15
    assert errors[1] < 0.02


@pytest.mark.parametrize("name", [part for parts in TOOLS.values() for part in parts])
def test_a_solid_has_the_moments_that_trimesh_finds(name: str):
    mesh = read_mesh(OBJECTS / f"{name}.stl")
    solid = Solid(mesh.vertices, mesh.faces, 0.7)
    assert_allclose(solid.volume, mesh.volume, rtol=1e-9)
    assert_allclose(solid.center_of_mass, mesh.center_mass, atol=1e-9)
    assert_allclose(solid.inertia_z, 0.7 * mesh.moment_inertia[2, 2] / mesh.volume, rtol=1e-6)


@pytest.mark.parametrize("name", TOOLS)
def test_a_tool_has_its_parts_masses_and_nearly_their_area(name: str):
    made, fine = tool(name), tool(name, 6).shape
    assert made.shape.n_m == 2
    assert_allclose(made.group_mass, [solid.mass for solid in made.solids], rtol=1e-12)
    assert_allclose(made.total_mass, {"hammer": 1.361, "wrench": 0.516}[name])
    density = made.group_mass / [solid.volume for solid in made.solids]
    assert_allclose(density, [7850, 700] if name == "hammer" else [7850, 7850], rtol=0.03)
    assert_allclose(len(made.shape.particles) * made.shape.cell**2, len(fine.particles) * fine.cell**2, rtol=0.05)
    assert len(made.shape.grasps) >= 5


@pytest.mark.parametrize("name", list(TOOLS))
@pytest.mark.parametrize("grid", [3, 6])
def test_particles_weigh_as_the_material_in_their_cells_does(name: str, grid: int):
    made = tool(name, grid)
    shape = made.shape
    for group, solid in enumerate(made.solids):
        inside = shape.mass_group == group
        part, places = shape.fill[inside] / inside.sum(), shape.particles[inside]
        middle = part @ places
        assert_allclose(middle, solid.center_of_mass[:2], atol=shape.cell / 15)
        squares = part @ (np.sum((places - middle) ** 2, axis=1) + shape.cell**2 / 6)
        assert_allclose(squares, solid.inertia_z / solid.mass, rtol=0.015)
    assert_allclose(made.particle_mass.sum(), made.total_mass)
    assert_allclose(shape.per_group(np.ones(len(shape.particles))), shape.particles_per_group)


def test_what_a_part_has_in_cells_of_another_is_counted_to_its_own():
    thick, thin = box((0.045, 0.02, 0.02)), box((0.035, 0.02, 0.02), (0.045, 0, 0))
    shape = cut(thick, thin).shape
    rays = 3 / 7  # of the fifth cell's that meet the first part; the second has the cell
    assert_allclose(shape.particles_per_group, [8, 8])
    columns = [shape.fill[np.isclose(shape.particles[:, 0], x)] for x in (-0.035, -0.005, 0.005, 0.035)]
    assert_allclose(columns[1], (1 + rays) * columns[0])
    assert_allclose(columns[2], (1 - rays) * columns[3])


def test_thin_parts_and_parts_in_the_air_have_cells():
    rod, pin, lid = THREAD, box((0.004, 0.004, 0.02), (0.05, 0, 0)), box((0.03, 0.02, 0.01), (0.06, 0, 0.01))
    made = cut(rod, pin, lid)
    assert_allclose(made.group_mass, 0.4)
    assert (made.shape.particles_per_group >= [5, 1, 6]).all()
    touches = np.bincount(made.shape.mass_group, made.shape.friction_group >= 0)
    assert touches[0] > 0 and touches[2] == 0
    middle = np.array([made.particle_mass[made.shape.mass_group == g].sum() for g in range(3)])
    assert_allclose(middle, 0.4)


def test_a_body_on_points_rests_on_particles_without_material():
    corners = [(0.01, 0.005), (0.09, 0.005), (0.05, 0.035)]
    made, on_cells = cut(BAR, contacts=corners), cut(BAR)
    assert made.shape.is_contact.sum() == 3 and not on_cells.shape.is_contact.any()
    assert_allclose(made.shape.particles[made.shape.is_contact], np.array(corners) - [0.05, 0.02], atol=1e-12)
    assert (made.shape.friction_group[~made.shape.is_contact] == -1).all()
    assert_allclose(made.center_of_mass, on_cells.center_of_mass, atol=1e-12)
    assert_allclose(made.particle_mass.sum(), on_cells.particle_mass.sum())
    uneven = cut(box((0.093, 0.037, 0.02)), contacts=corners)  # cells do not divide it
    assert_allclose(uneven.particle_mass @ uneven.shape.particles / 0.4, uneven.center_of_mass, atol=1e-12)


def test_the_outline_of_two_parts_is_that_of_their_union():
    """Two boxes that touch, one with a lug high over the table, which no fingertip meets."""
    lug = box((0.02, 0.06, 0.01), (0.04, 0.0, 0.03))
    shape = cut(box((0.06, 0.03, 0.02)), together(box((0.02, 0.03, 0.04), (0.06, 0, 0)), lug)).shape
    sides = faces(shape)
    begin, end = (np.array([getattr(side, name) for side in sides]) for name in ("begin", "end"))
    assert cross_2d(begin, end).sum() / 2 == pytest.approx(0.08 * 0.03, rel=0.01)
    assert sum(side.length for side in sides) == pytest.approx(0.22, rel=0.01)
    middle = (begin.max(axis=0) + begin.min(axis=0)) / 2
    assert room_at(shape, middle) == pytest.approx(-0.015, abs=2e-4)
    assert room_at(shape, middle + np.array([0.0, 0.025])) == pytest.approx(0.01, abs=2e-4)
    for side in sides:
        out = (side.begin + side.end) / 2 + 1e-3 * side.normal
        assert room_at(shape, out) == pytest.approx(1e-3, abs=1e-6)
    assert [max(sides, key=lambda side: way * side.begin[0] + way * side.end[0]).group for way in (-1, 1)] == [0, 1]


def test_rays_leave_a_closed_surface_as_often_as_they_enter_it():
    ball = trimesh.creation.icosphere(subdivisions=2, radius=0.02)
    grid = RayGrid(np.array([-0.02, -0.02, 0.0]), np.array([0.0005, 0, 0]), np.array([0, 0.0005, 0]), (81, 81))
    height, ray, out = grid_hits(ball, grid)  # through its corners and along its edges
    assert (np.bincount(ray, out) == 0).all()
    assert_allclose((out * height).sum() * 0.0005**2, ball.volume, rtol=2e-3)


def test_a_hammer_lies_on_its_head_and_on_the_end_of_its_handle():
    shape = tool("hammer").shape
    head, touches = shape.mass_group == 0, shape.friction_group >= 0
    assert touches[head].mean() > 0.9
    assert set(shape.friction_group[head]) <= {0, -1}
    assert set(shape.friction_group[~head]) == {1, -1}
    x = shape.particles[:, 0]
    assert x[touches & ~head].min() > x.max() - 0.1
    assert x[~touches & ~head].min() < x[head].max() + shape.cell * 1.01


@pytest.mark.parametrize("grid", [2, 6])
def test_a_body_on_points_cut_finer_stays_in_its_frame(grid):
    parts = [
        Part("thick", box((0.093, 0.037, 0.02)), 0.4, 0),
        Part("thin", trimesh.creation.icosphere(radius=0.01).apply_translation((0.11, 0.02, 0.02)), 0.1, 0),
    ]
    points = [(0.01, 0.005), (0.09, 0.005), (0.05, 0.035)]
    made = [mesh_object("x", parts, [], friction=[0.4], cell=0.01, grid=g, contacts=points) for g in (3, grid)]
    first, other = (each.shape.particles[each.shape.is_contact] for each in made)
    assert_allclose(first, other, atol=1e-12)


def test_a_tool_cut_finer_stays_in_its_frame():
    coarse, fine = tool("wrench"), tool("wrench", 6)
    assert_allclose(fine.center_of_mass, coarse.center_of_mass, atol=1e-12)
    assert_allclose(fine.inertia_cm, coarse.inertia_cm, rtol=1e-12)
    for a, b in zip(coarse.shape.grasps, fine.shape.grasps, strict=True):
        assert_allclose(a.position, b.position, atol=1e-12)
    assert_allclose(coarse.shape.particles.mean(axis=0), 0, atol=1e-15)


def test_the_script_makes_the_meshes_that_are_there():
    made = runpy.run_path(str(OBJECTS / "make_meshes.py"))["meshes"]()
    assert set(made) == {path.name for path in OBJECTS.glob("*.stl")}
    for name, mesh in made.items():
        again = trimesh.load_mesh(io.BytesIO(mesh.export(file_type="stl")), file_type="stl", process=False)
        there = trimesh.load_mesh(OBJECTS / name, process=False)
        assert_allclose(again.triangles, there.triangles, rtol=0, atol=1e-7)


@pytest.mark.parametrize(("name", "hinges"), [("shears", 1), ("folding_rule", 2), ("saw", 1)])
def test_links_of_meshes_are_joined_where_their_plates_overlap(name: str, hinges: int):
    obj, chain = load_object(name), load_object(name).shape.chain
    assert chain is not None and len(chain.hinges) == hinges
    link = chain.link[obj.shape.mass_group]
    for index, hinge in enumerate(chain.hinges):
        for side in (index, index + 1):  # each link has material all around its hinge, over or under the other's
            near = obj.shape.particles[link == side] - hinge
            around = np.degrees(np.arctan2(*near[np.linalg.norm(near, axis=1) < 0.012].T[::-1]))
            assert np.diff(np.sort(np.append(around, around.min() + 360))).max() < 100
    for group, solid in enumerate(obj.solids):
        own = obj.shape.mass_group == group
        center = obj.shape.fill[own] @ obj.shape.particles[own] / own.sum()
        assert_allclose(center, solid.center_of_mass[:2], atol=5e-4)


def test_a_grasps_faces_are_measured_on_the_mesh():
    made = cut(box((0.2, 0.03, 0.02), (0, 0, 0)), places=across(0.05, 0.012))
    (grasp,) = made.shape.grasps
    assert_allclose(grasp.position, [-0.05, 0], atol=1e-9)
    assert_allclose([grasp.width, grasp.length], [0.03, 0.022], rtol=1e-9)
    assert grasp.top is not None
    assert_allclose([grasp.bottom, grasp.top], [0.003, 0.020], atol=1e-9)


def test_round_sides_are_held_where_they_are_widest():
    bar = trimesh.creation.cylinder(radius=0.015, height=0.2, sections=180)
    bar.apply_transform(trimesh.transformations.rotation_matrix(np.pi / 2, [0, 1, 0], [0, 0, 0]))
    bar.apply_translation([0, 0, 0.015])
    (grasp,) = cut(together(bar, box((0.02, 0.03, 0.002), (0.1, -0.015, 0))), places=across(0, 0)).shape.grasps
    assert grasp.top is not None
    assert_allclose(grasp.width, 0.03, atol=1e-4)
    assert_allclose([grasp.bottom, grasp.top], 0.015 + np.array([-1, 1]) * np.sqrt(0.015**2 - 0.014**2), atol=1.5e-3)


def moved(mesh: trimesh.Trimesh, by: tuple[float, float, float], degrees: float = 0.0) -> trimesh.Trimesh:
    """Mesh turned about z, then moved [m]."""
    mesh.apply_transform(trimesh.transformations.rotation_matrix(np.radians(degrees), [0, 0, 1]))
    return mesh.apply_translation(by)


BAR_20 = box((0.1, 0.02, 0.02))
FORK = together(box((0.1, 0.02, 0.02)), box((0.1, 0.02, 0.02), (0, 0.05, 0)))
NARROW = together(box((0.1, 0.02, 0.02)), box((0.1, 0.02, 0.02), (0, 0.03, 0)))
RING = moved(trimesh.creation.annulus(r_min=0.012, r_max=0.022, height=0.014), (0, 0, 0.007))
SLANTED = moved(box((0.1, 0.03, 0.02), (-0.05, -0.015, 0)), (0, 0, 0), degrees=30)
BAR, SLAB, THREAD = box((0.1, 0.04, 0.02)), box((0.04, 0.04, 0.02)), box((0.05, 0.004, 0.02))


def test_the_hand_opens_as_far_as_there_is_room():
    (alone,), (beside,) = (cut(mesh, places=across(0.05, 0.01)).shape.grasps for mesh in (BAR_20, FORK))
    assert alone.opening is None
    # its neighbor is 40 mm off the middle, a finger 8 mm thick; 25 mm are needed
    assert beside.opening == pytest.approx((2 * 0.032 + 0.025) / 2, abs=1e-6)


@pytest.mark.parametrize(
    ("meshes", "options", "field", "said"),
    [
        ([NARROW], {"places": across(0.05, 0.01)}, "mesh.grasps.0.at_m", "'the object again 20 mm .*20\\.5 mm free"),
        ([BAR], {"places": across(0.05, 0.2)}, "mesh.grasps.0.at_m", "a point of the mesh, which spans x 0 to 0.1"),
        ([BAR], {"places": across(3.0, 0.0)}, "mesh.grasps.0.at_m", "a point of the mesh, which spans x 0 to 0.1"),
        ([BAR], {"places": across(0.05, 0.02, 0.0)}, "mesh.grasps.0.at_m", "'100 mm across'; .*it opens to 85 mm"),
        ([RING], {"places": across(0, 0), "cell": 0.005}, "mesh.grasps.0.at_m", "a point of the object"),
        ([SLANTED], {"places": across(0, 0)}, "mesh.grasps.0.at_m", "two faces across from each other"),
        *(
            ([box((0.05, 0.05, 0.02), (0, 0, z))], {}, "mesh.parts", f"z = {z} m'; allowed: resting on z = 0, to 1 mm")
            for z in (0.002, -0.002)
        ),
        ([SLAB, box((0.02, 0.0005, 0.01), (0.04, 0, 0))], {}, "mesh.parts.1", "'p1 without a particle'"),
        ([box((0.1, 0.02, 0.001))], {"places": across(0.05, 0.01)}, "mesh.grasps.0.at_m", "1.0 mm high.*lower edge"),
        ([BAR], {"contacts": [(0, 0), (0.1, 0), (0.05, 0.1)]}, "mesh.contacts_m.2", "y -0.001 to 0.041 m"),
        ([box((40, 40, 20))], {}, "mesh.cell_m", "'4000 x 4000 cells of 0\\.01 m'.*unit of the mesh"),
    ],
)
def test_meshes_that_make_no_object_are_refused(meshes, options, field: str, said: str):
    with pytest.raises(InvalidValueError, match=said) as refused:
        cut(*meshes, **options)
    assert refused.value.field == field


def test_a_mesh_that_is_open_or_no_mesh_is_refused(tmp_path: Path):
    trimesh.Trimesh(BAR.vertices, BAR.faces[1:]).export(tmp_path / "open.stl")
    (tmp_path / "text.stl").write_text("not a mesh")
    (tmp_path / "text.xyz123").write_text("not a mesh")
    for name, said in (
        ("open.stl", "file: got 'open.stl'; allowed: a watertight mesh"),
        ("text.stl", "file: got 'text.stl'; allowed: a mesh"),
        ("text.xyz123", "file: got 'text.xyz123'; allowed: a mesh"),
        ("none.stl", f"file: got 'none.stl'; allowed: a mesh file beside the object's; there is none in {tmp_path}"),
    ):
        with pytest.raises(InvalidValueError) as refused:
            read_mesh(tmp_path / name)
        assert str(refused.value).startswith(said)


def mutant(content: bytes, rng: np.random.Generator) -> bytes:
    """Some bytes changed, left out or doubled, and perhaps the end cut off."""
    data = bytearray(content)
    for at in rng.integers(len(content) - 64, size=rng.integers(1, 20)):
        piece = [b"\xff\xff\xff\x7f", b"9", b"", bytes(data[at : at + 60]), rng.bytes(4)]
        data[at : at + 4] = piece[rng.integers(len(piece))]
    return bytes(data[: len(data) if rng.random() < 0.8 else rng.integers(1, len(data))])


@pytest.mark.parametrize("kind", ["stl", "obj", "ply", "off"])
def test_a_damaged_mesh_is_read_or_refused(kind: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]):
    path, rng, refused = tmp_path / f"m.{kind}", np.random.default_rng(0), 0
    box((0.05, 0.05, 0.05)).export(path)
    content = path.read_bytes()
    for _ in range(60):
        path.write_bytes(mutant(content, rng))
        try:
            assert read_mesh(path).is_volume
        except InvalidValueError:
            refused += 1
    assert refused > 20
    assert capfd.readouterr().err == ""
