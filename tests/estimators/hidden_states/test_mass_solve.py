"""Mass and friction from hidden states: exact from exact ones, and honest about what they leave open."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from estimators.hidden_states.masses import MassSolution, feet_of, solve_masses
from estimators.particles.friction_system import LoadGroups
from estimators.particles.pivots import PivotInertia, inertia_map
from estimators.testing.analytic_world import drawn_object
from estimators.wrench.model import ParticleModel
from estimators.wrench.weighing import Weighing
from testbed.objects.blocks import block_object, parse_layout
from testbed.objects.files import load_object
from testbed.objects.model import GRAVITY, ObjectModel
from testbed.worlds.setup_errors import EXACT_SETUP

PRECISE = 1e-6
"""Error of every load, N, and of the weight, kg, where the hidden states are exact."""


def exact_loads(obj: ObjectModel) -> tuple[tuple[tuple[int, int], ...], np.ndarray]:
    """Pairs of groups in contact and s = mu m g of one particle of each, all weight on the pair's own feet, N."""
    pairs = LoadGroups.of(ParticleModel.of(obj.shape)).pairs
    feet = np.bincount(obj.shape.mass_group[obj.shape.friction_group >= 0], minlength=obj.shape.n_m)
    return pairs, np.array([obj.truth.friction[f] * obj.group_mass[m] * GRAVITY / feet[m] for m, f in pairs])


def exact_pivots(obj: ObjectModel, error: float = 1e-8) -> PivotInertia:
    """I_j about every grasp, kg m^2."""
    points = np.array([grasp.position for grasp in obj.shape.grasps])
    return PivotInertia(points, inertia_map(obj.shape, points) @ obj.truth.mass, np.full(len(points), error**2))


def solved(obj: ObjectModel, pivots: PivotInertia | None) -> MassSolution:
    pairs, loads = exact_loads(obj)
    return solve_masses(
        obj.shape,
        obj.total_mass,
        Weighing.of(obj.shape, PRECISE, EXACT_SETUP),
        pairs,
        loads,
        PRECISE**2 * np.eye(len(loads)),
        pivots,
    )


def grouped(layout: list[str], friction: list[float], groups: list[int]) -> ObjectModel:
    """Six blocks of different mass in given friction groups."""
    mass = [0.4, 0.1, 0.2, 0.3, 0.4, 0.2]
    cells = parse_layout(layout)
    return block_object("o", cells, size=0.05, height=0.03, mass=mass, friction=friction, friction_group=groups, grid=3)


@pytest.mark.parametrize("seed", [0, 1])
@pytest.mark.parametrize("groups", [1, 2, 3])
def test_exact_hidden_states_give_exact_masses(groups, seed):
    obj = drawn_object(seed, friction_groups=groups)
    found = solved(obj, exact_pivots(obj))
    assert_allclose(found.distribution.mass, obj.truth.mass, rtol=1e-9)
    assert_allclose(found.distribution.friction, obj.truth.friction, rtol=1e-9)
    assert found.rank == found.unknowns == obj.shape.n_m + obj.shape.n_mu


@pytest.mark.parametrize("groups", [1, 2])
def test_one_friction_needs_the_weight_alone_and_two_are_not_of_full_rank(groups):
    obj = drawn_object(0, friction_groups=groups)
    found = solved(obj, None)
    assert found.rank == found.unknowns - (groups - 1)
    assert groups == 2 or np.allclose(found.distribution.mass, obj.truth.mass, rtol=1e-9)


def test_a_block_that_stands_on_part_of_itself_weighs_all_of_it():
    whole = load_object("L2")
    friction_group = np.array(whole.shape.friction_group)
    friction_group[::2] = -1
    obj = replace(whole, shape=replace(whole.shape, friction_group=friction_group))
    found = solved(obj, exact_pivots(obj))
    assert_allclose(found.distribution.mass, obj.truth.mass, rtol=1e-9)
    pairs, _ = exact_loads(obj)
    assert feet_of(obj.shape, pairs).sum() == (friction_group >= 0).sum()


@pytest.mark.parametrize(
    ("name", "layout", "most"),
    [("I", ["111111"], 3), ("L", ["1", "1", "1", "111"], 4), ("F", ["10", "11", "10", "11"], 4)],
)
def test_as_many_frictions_as_claimed_are_told_apart_and_no_more(name, layout, most):
    for count in (most, most + 1):
        groups = [i % count for i in range(6)]
        obj = grouped(layout, np.linspace(0.3, 0.7, count).tolist(), groups)
        found = solved(obj, exact_pivots(obj))
        assert (found.rank == found.unknowns) == (count == most), name


@pytest.mark.parametrize("least", [0.0, 1e-5])
def test_the_mass_of_a_frictionless_group_comes_from_weight_and_inertia(least):
    obj = grouped(["1", "1", "1", "111"], [0.5, least], [0, 0, 0, 0, 0, 1])
    found = solved(obj, exact_pivots(obj)).distribution
    assert_allclose(found.mass, obj.truth.mass, rtol=1e-6)
    assert least or abs(found.friction - obj.truth.friction).max() < 1e-6


def test_no_mass_is_below_zero_when_the_loads_are_noise():
    obj = drawn_object(0)
    pairs, loads = exact_loads(obj)
    loads = np.where(np.arange(len(loads)) == 2, 0.0, loads)
    found = solve_masses(
        obj.shape,
        obj.total_mass,
        Weighing.of(obj.shape, PRECISE, EXACT_SETUP),
        pairs,
        loads,
        1e-4 * np.eye(len(loads)),
        None,
    )
    assert (found.distribution.mass >= 0).all()
    assert found.distribution.mass[2] == pytest.approx(0, abs=1e-9)
