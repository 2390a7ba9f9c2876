"""Loads of groups that springs join: between own weight and one rigid body, as at rest in simulation."""

import numpy as np
import pytest
import torch
from numpy.testing import assert_allclose
from scipy.linalg import null_space

from estimators.testing.analytic_world import drawn_object, foundation
from estimators.wrench.model import ParticleModel
from estimators.wrench.support import GripperLoad, Springs, own_weight_loads, rigid_loads
from testbed.objects.blocks import block_object, parse_layout
from testbed.objects.files import load_object
from testbed.objects.model import ObjectModel
from testbed.simulation.contacts import foot_stiffness, resting_loads
from testbed.simulation.settings import ContactSettings
from testbed.trial import Support

PADS = np.array([[-0.02, -0.02], [0.02, -0.02], [0.0, 0.02]])
L2 = load_object("L2")
CELLS = parse_layout(["111", "010"])
ONE_FOOT = block_object(
    "one", CELLS, size=0.05, height=0.03, mass=[0.1, 0.4, 0.2, 0.3], friction=[0.4], friction_group=[0] * 4, grid=1
)
OBJECTS = {
    "I2": load_object("I2"),
    "F2": load_object("F2"),
    "two frictions": drawn_object(4, friction_groups=2),
    "a foot each": ONE_FOOT,
    "pads": L2.on_feet([L2.shape.middle_of(group) + PADS for group in range(L2.shape.n_m)]),
}


def loads(obj: ObjectModel) -> tuple[Springs, torch.Tensor, torch.Tensor]:
    """Springs between the groups, and loads on own weight and under one rigid body."""
    model, mass = ParticleModel.of(obj.shape), torch.tensor(obj.particle_mass)
    none = GripperLoad.none(model)
    own, rigid = own_weight_loads(model, mass, none)[0], rigid_loads(model, mass, none)[0]
    return Springs.of(model, obj.shape.neighbors), own, rigid


def stiffness(obj: ObjectModel, springs: Springs, share: float) -> float:
    """Stiffness of springs of a share, N/m, by the work of the stiffest pattern in a foundation of even stiffness."""
    sinks, _ = foundation(obj.shape)
    ends = np.zeros((len(obj.shape.neighbors), sinks.shape[1]))
    for spring, pair in enumerate(obj.shape.neighbors):
        ends[spring, pair] = 1.0, -1.0
    sunk, free = np.linalg.lstsq(sinks, springs.patterns[:, -1].numpy(), rcond=None)[0], null_space(sinks)
    stretch = ends @ (sunk - free @ np.linalg.lstsq(ends @ free, ends @ sunk, rcond=None)[0])
    mean = stretch @ stretch / float(springs.weight[-1])
    return share / (1 - share) / mean * foot_stiffness(obj, ContactSettings())


@pytest.mark.parametrize("name", OBJECTS)
def test_its_ends_are_own_weight_and_one_rigid_body(name):
    springs, own, rigid = loads(OBJECTS[name])
    assert_allclose(springs.joined(own, torch.tensor(0.0)), own, atol=1e-12)
    assert_allclose(springs.joined(own, torch.tensor(1.0)), rigid, atol=1e-10)


@pytest.mark.parametrize("share", [0.01, 0.3, 0.5, 0.9, 0.99])
@pytest.mark.parametrize("name", ["I2", "F2", "two frictions", "a foot each"])
def test_between_them_loads_are_those_at_rest_in_simulation(name, share):
    obj = OBJECTS[name]
    springs, own, _ = loads(obj)
    expected = resting_loads(obj, Support(stiffness=stiffness(obj, springs, share)), ContactSettings())
    assert_allclose(springs.joined(own, torch.tensor(share, dtype=torch.float64)), expected, atol=1e-9)


@pytest.mark.parametrize("share", [-0.2, 0.0, 0.4, 1.0, 1.3])
@pytest.mark.parametrize("name", OBJECTS)
def test_the_weight_and_its_moments_stay_and_slopes_are_continuous(name, share):
    obj = OBJECTS[name]
    springs, own, _ = loads(obj)
    at = torch.tensor(share, dtype=torch.float64)
    joined = springs.joined(own, at)
    basis = torch.cat([torch.ones(len(own), 1), torch.tensor(obj.shape.particles)], 1)
    assert_allclose(joined @ basis, own @ basis, atol=1e-10)
    slope = torch.func.jacrev(lambda s: springs.joined(own, s))(at)
    for step in (-1e-7, 1e-7):
        assert_allclose((springs.joined(own, at + step) - joined) / step, slope, rtol=1e-4, atol=1e-5)
