"""Block objects as particles: layouts, grasps, and the moments of a solid slab."""

import dataclasses
from collections.abc import Callable

import numpy as np
import pytest
from numpy.testing import assert_allclose

from testbed.errors import InvalidValueError
from testbed.objects.blocks import parse_layout
from testbed.objects.files import load_object
from testbed.objects.model import Grasp, MassDistribution, ObjectModel, ObjectShape, Solid
from tests.helpers.blocks import blocks

SIZE = 0.05
ROW_MASS = [0.4, 0.1, 0.1, 0.4, 0.4, 0.4]


def shape(**changes: object) -> ObjectShape:
    groups = {"mass_group": [0, 1], "friction_group": [0, 0]}
    values = {"particles": [[0.0, 0.0], [0.1, 0.0]], "cell": 0.1, "height": 0.03}
    return ObjectShape(**values | groups | changes)  # type: ignore[arg-type]


def test_blocks_are_named_bottom_row_first_and_left_to_right():
    assert [cell.name for cell in parse_layout(["1", "1", "1", "111"])] == ["A1", "B1", "C1", "A2", "A3", "A4"]

    assert [cell.name for cell in parse_layout(["1" * 28])][25:] == ["Z1", "AA1", "AB1"]


@pytest.mark.parametrize("nothing", ["0", ".", " "])
def test_zero_dot_and_space_are_all_empty(nothing: str):
    assert parse_layout([f"1{nothing}", "11"]) == parse_layout(["1", "11"])


@pytest.mark.parametrize(
    ("rows", "said"),
    [
        (["1", "0", "1"], "A3 apart from A1.*joined edge to edge"),
        (["101"], "C1 apart from A1"),
        (["01", "10"], "B2 apart from A1"),
        *((empty, 'at least one "1"') for empty in ([], [""], ["00", ". "])),
        (["1x1", "121"], "'2x'.*none"),
    ],
)
def test_a_layout_that_is_no_object_is_refused(rows: list[str], said: str):
    with pytest.raises(InvalidValueError, match=said) as refused:
        parse_layout(rows)
    assert refused.value.field == "layout"


@pytest.mark.parametrize(
    ("name", "grippable"),
    [
        ("I1", ["A1", "B1", "C1", "D1", "E1", "F1"]),
        ("L1", ["B1", "C1", "A2", "A3", "A4"]),
        ("F1", ["B1", "A2", "B3", "A4"]),
    ],
)
def test_a_block_can_be_gripped_only_where_two_opposite_faces_are_free(name: str, grippable: list[str]):
    assert [grasp.name for grasp in load_object(name).shape.grasps] == grippable


def test_inner_blocks_of_a_row_are_gripped_across_it():
    grasps = blocks(["111111"]).shape.grasps
    assert [grasp.angle for grasp in grasps] == [np.pi / 2] * 6
    assert_allclose([grasp.position for grasp in grasps], [[(i - 2.5) * SIZE, 0] for i in range(6)], atol=1e-15)
    assert blocks(["11", "11"]).shape.grasps == ()


@pytest.mark.parametrize("grid", [1, 2, 3, 5])
@pytest.mark.parametrize(("columns", "rows"), [(1, 1), (6, 1), (3, 2)])
def test_a_uniform_slab_has_the_moments_of_a_solid_rectangle(columns: int, rows: int, grid: int):
    slab = blocks(["1" * columns] * rows, grid=grid)
    mass = 0.4 * columns * rows
    assert_allclose(slab.total_mass, mass, rtol=1e-12)
    assert_allclose(slab.center_of_mass, 0, atol=1e-15)
    assert_allclose(slab.inertia_cm, mass * SIZE**2 * (columns**2 + rows**2) / 12, rtol=1e-12)


@pytest.mark.parametrize("grid", [1, 2, 4])
def test_an_uneven_row_has_the_moments_of_its_blocks(grid: int):
    row = blocks(["111111"], mass=ROW_MASS, grid=grid)
    mass, x = np.array(ROW_MASS), (np.arange(6) - 2.5) * SIZE
    center = mass @ x / mass.sum()
    assert_allclose(row.center_of_mass, [center, 0], atol=1e-15)
    assert_allclose(row.inertia_cm, mass @ ((x - center) ** 2 + SIZE**2 / 6), rtol=1e-12)
    assert_allclose(row.group_mass, mass, rtol=1e-12)


@pytest.mark.parametrize("grid", [1, 3])
def test_particles_fill_their_blocks_about_a_common_origin(grid: int):
    made = blocks(["1", "1", "1", "111"], grid=grid).shape
    assert_allclose(made.particles.mean(axis=0), 0, atol=1e-15)
    assert_allclose(len(made.particles) * made.cell**2, 6 * SIZE**2, rtol=1e-12)
    assert made.particles_per_group.tolist() == [grid**2] * 6


def test_groups_are_named_after_blocks_and_numbered_without_names():
    assert blocks(["11"]).shape.group_names == ("A1", "B1")
    assert shape().group_names == ("m0", "m1")


def test_values_are_frozen_and_do_not_follow_the_arrays_they_were_made_from():
    mass = np.array([0.4, 0.1])
    of_mass, made = MassDistribution(mass, np.array([0.5])), shape()
    mass[0] = 9.0
    assert of_mass.mass.tolist() == [0.4, 0.1]
    with pytest.raises(dataclasses.FrozenInstanceError):
        made.cell = 1.0  # type: ignore[misc]
    for array in (made.particles, made.mass_group, made.friction_group, of_mass.mass):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 0


def test_a_particle_weighs_as_its_cell_is_filled():
    uneven = shape(particles=[[0.0, 0.0], [0.1, 0.0], [0.2, 0.0]], mass_group=[0, 1, 1], friction_group=[0, 0, 0])
    uneven = dataclasses.replace(uneven, fill=np.array([1.0, 0.5, 1.5]))
    made = ObjectModel("X", uneven, MassDistribution(np.array([0.2, 0.1]), np.array([0.5])))
    assert_allclose(made.particle_mass, [0.2, 0.05, 0.15])
    assert_allclose(made.group_mass, [0.2, 0.2])
    assert_allclose(made.center_of_mass, [(0.05 * 0.1 + 0.15 * 0.2) / 0.4, 0])
    assert_allclose(uneven.per_group(uneven.particles[:, 0]), [0, 0.35])
    assert_allclose(shape().fill, 1)


CORNERS = [[0.0, 0, 0], [0.1, 0, 0], [0, 0.1, 0], [0, 0, 0.1]]
OUTWARDS = [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]


def solid(**changes: object) -> Solid:
    return Solid(**{"vertices": CORNERS, "faces": OUTWARDS, "mass": 0.6} | changes)  # type: ignore[arg-type]


def test_a_tetrahedron_has_the_moments_of_the_textbook():
    made = solid()
    assert_allclose(made.volume, 0.1**3 / 6, rtol=1e-12)
    assert_allclose(made.center_of_mass, [0.025] * 3, rtol=1e-12)
    assert_allclose(made.inertia_z, 0.6 * 0.1**2 * 2 * (1 / 10 - 1 / 16), rtol=1e-12)


def test_an_object_with_solids_has_their_moments():
    two = (solid(mass=0.1), solid(vertices=np.array(CORNERS) + np.array([0.2, 0, 0]), mass=0.3))
    made = ObjectModel("X", shape(), distribution((0.1, 0.3)), two)
    assert_allclose(made.total_mass, 0.4, rtol=1e-12)
    assert_allclose(made.center_of_mass, [0.175, 0.025], rtol=1e-12)
    own = 0.4 * 0.1**2 * 2 * (1 / 10 - 1 / 16)
    assert_allclose(made.inertia_cm, own + 0.1 * 0.15**2 + 0.3 * 0.05**2, rtol=1e-12)


@pytest.mark.parametrize("mass", [[0.1, 0.2], [0.1]])
def test_solids_must_be_the_mass_groups(mass: list[float]):
    with pytest.raises(InvalidValueError, match=r"ObjectModel\.solids: .*one per mass group, of \[0\.1, 0\.3\] kg"):
        ObjectModel("X", shape(), distribution((0.1, 0.3)), tuple(solid(mass=m) for m in mass))


def distribution(mass: object = (0.1, 0.4), friction: object = (0.5,)) -> MassDistribution:
    return MassDistribution(mass, friction)  # type: ignore[arg-type]


def truth(mass: list[float], friction: list[float]) -> ObjectModel:
    return ObjectModel("X", shape(), distribution(mass, friction))


def grasp(**changes: object) -> Grasp:
    values = {"name": "A1", "position": np.zeros(2), "angle": 0.0, "width": 0.05, "length": 0.05}
    return Grasp(**values | changes)  # type: ignore[arg-type]


REFUSED: list[tuple[Callable[..., object], dict[str, object], str]] = [
    *((shape, {"cell": bad}, "ObjectShape.cell") for bad in (0.0, np.nan)),
    (shape, {"height": -0.03}, "ObjectShape.height"),
    *(
        (shape, {"particles": bad}, "ObjectShape.particles")
        for bad in ([[0, 0], [np.inf, 0]], [[0, 0, 0]], np.zeros((0, 2)))
    ),
    *((shape, {"mass_group": bad}, "ObjectShape.mass_group") for bad in ([0, 2], [0, -1], [0], [0.0, 1.0])),
    (shape, {"friction_group": [-1, -1]}, "ObjectShape.friction_group"),
    *((shape, {"fill": bad}, "ObjectShape.fill") for bad in ([1.0], [1.0, 2.0], [1.0, -1.0])),
    (shape, {"group_names": ("only",)}, "ObjectShape.group_names"),
    *(
        (distribution, {"mass": bad}, "MassDistribution.mass")
        for bad in ([-0.1, 0.4], [np.nan, 0.4], [np.inf, 0.4], ["heavy"])
    ),
    *((distribution, {"mass": bad}, "MassDistribution.mass") for bad in (["0.4", "0.1"], [True, False], [None, 0.1])),
    (distribution, {"mass": [[0.4], [0.1, 0.2]]}, "MassDistribution.mass"),
    (distribution, {"friction": [-0.5]}, "MassDistribution.friction"),
    *((truth, {"mass": bad, "friction": [0.5]}, "mass") for bad in ([0.4], [0.0, 0.0])),
    (truth, {"mass": [0.4, 0.1], "friction": [0.5, 0.5]}, "friction"),
    (solid, {"vertices": [[0, 0], [1, 1]]}, "Solid.vertices"),
    *(
        (solid, {"faces": bad}, "Solid.faces")
        for bad in ([[0, 1]], [[0.0, 1.0, 2.0]], [[0, 1, 4]], [face[::-1] for face in OUTWARDS])
    ),
    (solid, {"mass": 0.0}, "Solid.mass"),
    *((grasp, {"angle": bad}, "Grasp.angle") for bad in (np.nan, np.inf, None, "0", True)),
    (grasp, {"width": 0.0}, "Grasp.width"),
    *((grasp, {"bottom": bad}, "Grasp.bottom") for bad in (-0.001, np.nan)),
    *((grasp, {"top": bad}, "Grasp.top") for bad in (np.inf, 0.0)),
]


@pytest.mark.parametrize(("make", "changes", "field"), REFUSED)
def test_a_value_out_of_range_is_refused(make, changes: dict[str, object], field: str):
    with pytest.raises(InvalidValueError) as refused:
        make(**changes)
    assert refused.value.field.endswith(field)
