"""Block objects as particles: layouts, grasps, the moments of a solid slab, and colors of their groups."""

import dataclasses
from collections.abc import Callable

import numpy as np
import pytest
from matplotlib.colors import to_rgba
from numpy.testing import assert_allclose

from testbed import OWN_WEIGHT, InvalidValueError, SimulationSettings, load_object
from testbed.objects.blocks import parse_layout
from testbed.objects.colors import GROUP_COLORS, group_color, group_rgba
from testbed.objects.model import Grasp, MassDistribution, ObjectModel, ObjectShape, Solid
from testbed.simulation.scene import build_scene
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


@pytest.mark.parametrize("grid", [1, 2, 3])
@pytest.mark.parametrize(("columns", "rows", "masses"), [(1, 1, [0.4]), (3, 2, [0.4] * 6), (6, 1, ROW_MASS)])
def test_a_slab_has_the_moments_of_a_solid_rectangle_for_each_block(columns, rows, masses, grid: int):
    slab, mass = blocks(["1" * columns] * rows, masses, grid=grid), np.array(masses)
    x = (np.arange(len(mass)) % columns - (columns - 1) / 2) * SIZE
    assert_allclose(slab.total_mass, mass.sum(), rtol=1e-12)
    assert_allclose(slab.group_mass, mass, rtol=1e-12)
    center = mass @ x / mass.sum()
    assert_allclose(slab.center_of_mass, [center, 0], atol=1e-15)
    about_middle = mass.sum() * SIZE**2 * (1 + rows**2) / 12 + mass @ (x - center) ** 2
    assert_allclose(slab.inertia_cm, about_middle, rtol=1e-12)


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


def test_an_object_with_solids_has_their_moments():
    two = (solid(mass=0.1), solid(vertices=np.array(CORNERS) + np.array([0.2, 0, 0]), mass=0.3))
    made = ObjectModel("X", shape(), distribution((0.1, 0.3)), two)
    assert_allclose(made.total_mass, 0.4, rtol=1e-12)
    assert_allclose(made.center_of_mass, [0.175, 0.025], rtol=1e-12)
    own = 0.4 * 0.1**2 * 2 * (1 / 10 - 1 / 16)
    assert_allclose(made.inertia_cm, own + 0.1 * 0.15**2 + 0.3 * 0.05**2, rtol=1e-12)


def distribution(mass: object = (0.1, 0.4), friction: object = (0.5,)) -> MassDistribution:
    return MassDistribution(mass, friction)  # type: ignore[arg-type]


def truth(mass: list[float], friction: list[float]) -> ObjectModel:
    return ObjectModel("X", shape(), distribution(mass, friction))


def grasp(**changes: object) -> Grasp:
    values = {"name": "A1", "position": np.zeros(2), "angle": 0.0, "width": 0.05, "length": 0.05}
    return Grasp(**values | changes)  # type: ignore[arg-type]


def solids(masses: list[float]) -> ObjectModel:
    return ObjectModel("X", shape(), distribution((0.1, 0.3)), tuple(solid(mass=mass) for mass in masses))


REFUSED_LAYOUTS: list[tuple[list[str], str]] = [
    (["1", "0", "1"], "A3 apart from A1.*joined edge to edge"),
    (["101"], "C1 apart from A1"),
    (["01", "10"], "B2 apart from A1"),
    *((empty, 'at least one "1"') for empty in ([], [""], ["00", ". "])),
    (["1x1", "121"], "'2x'.*none"),
]
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


@pytest.mark.parametrize(
    ("make", "changes", "field", "allowed"),
    [
        *((*entry, None) for entry in REFUSED),
        *((parse_layout, {"rows": rows}, "layout", allowed) for rows, allowed in REFUSED_LAYOUTS),
        *(
            (solids, {"masses": bad}, "ObjectModel.solids", r"one per mass group, of \[0\.1, 0\.3\] kg")
            for bad in ([0.1, 0.2], [0.1])
        ),
    ],
)
def test_a_value_out_of_range_is_refused(make, changes: dict[str, object], field: str, allowed: str | None):
    with pytest.raises(InvalidValueError, match=allowed) as refused:
        make(**changes)
    assert refused.value.field.endswith(field)


SEEN_WITH = {
    "all cones": np.eye(3),
    "no red cones": [[0.152, 1.053, -0.205], [0.115, 0.786, 0.099], [-0.004, -0.048, 1.052]],
    "no green cones": [[0.367, 0.861, -0.228], [0.280, 0.673, 0.047], [-0.012, 0.043, 0.969]],
    "no blue cones": [[1.256, -0.077, -0.179], [-0.078, 0.931, 0.148], [0.005, 0.691, 0.304]],
}
"""Linear RGB as seen without one kind of cone (Machado 2009)."""
LEAST = 0.08
"""Least distance in OKLab between two patches that are easy to distinguish; black and white are 1 apart."""


def oklab(linear: np.ndarray) -> np.ndarray:
    """OKLab coordinates of linear RGB colors, (N, 3)."""
    cones = np.array([[0.4122, 0.5363, 0.0514], [0.2119, 0.6807, 0.1074], [0.0883, 0.2817, 0.6300]])
    parts = np.array([[0.2105, 0.7936, -0.0041], [1.9780, -2.4286, 0.4506], [0.0259, 0.7828, -0.8087]])
    return np.cbrt(linear @ cones.T) @ parts.T


@pytest.mark.parametrize("eyes", SEEN_WITH)
def test_colors_of_twelve_groups_are_distinct(eyes: str):
    rgb = np.array([group_rgba(group)[:3] for group in range(12)])
    linear = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
    seen = oklab(np.clip(linear @ np.array(SEEN_WITH[eyes]).T, 0, 1))
    apart = np.linalg.norm(seen[:, None] - seen[None], axis=-1)
    assert apart[np.triu_indices(12, 1)].min() > LEAST


def test_a_colour_is_the_same_in_both_spellings_and_comes_again():
    assert group_rgba(4) == pytest.approx(to_rgba(group_color(4)))
    assert group_color(len(GROUP_COLORS)) == group_color(0)


@pytest.mark.parametrize("name", ["L2", "F2", "wrench"])
def test_every_group_of_an_object_has_its_colour_in_the_scene(name: str):
    obj = load_object(name)
    model = build_scene(obj, OWN_WEIGHT, None, SimulationSettings()).model
    looks: dict[int, list[np.ndarray]] = {}
    for geom in range(model.ngeom):
        part, _, number = model.geom(geom).name.partition("_")
        if part in ("cell", "solid"):
            group = int(obj.shape.mass_group[int(number)]) if part == "cell" else int(number)
            looks.setdefault(group, []).append(model.geom_rgba[geom])
    assert sorted(looks) == list(range(obj.shape.n_m))
    for group, found in looks.items():
        np.testing.assert_allclose(np.unique(found, axis=0), [group_rgba(group)], atol=1e-6)
