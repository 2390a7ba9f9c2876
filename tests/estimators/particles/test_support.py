"""Support models: every load is accounted for, and nothing depends on the order of things."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from numpy.testing import assert_allclose

from estimators.particles.gripper_load import GripperLoad
from estimators.particles.support import own_weight, rigid_loads
from estimators.testing.analytic_world import drawn_object
from testbed.errors import InvalidValueError
from testbed.objects.blocks import block_object, parse_layout
from testbed.objects.model import GRAVITY, ObjectModel

OBJECT = drawn_object(0, friction_groups=2)
MODELS = ("own_weight", "rigid")


def carried(obj: ObjectModel, seed: int = 0, count: int = 4) -> GripperLoad:
    """Random lift and moment at random particles of random blocks."""
    rng = np.random.default_rng(seed)
    held = rng.integers(obj.shape.n_m, size=count)
    points = [obj.shape.particles[rng.choice(np.flatnonzero(obj.shape.mass_group == h))] for h in held]
    return GripperLoad(
        torch.tensor(rng.normal(size=count)),
        torch.tensor(rng.normal(scale=0.02, size=(count, 2))),
        torch.tensor(held),
        torch.tensor(np.array(points)),
    )


def loads_of(model: str, obj: ObjectModel, load: GripperLoad, mass: torch.Tensor | None = None) -> torch.Tensor:
    """Loads under either model."""
    shape = obj.shape
    particles, group = torch.tensor(shape.particles), torch.tensor(shape.mass_group)
    contact = torch.tensor(shape.friction_group >= 0)
    mass = torch.tensor(obj.particle_mass) if mass is None else mass
    if model == "rigid":
        return rigid_loads(particles, contact, mass, load)
    return own_weight(particles, group, contact, mass, load).loads(load)


def beyond_weights(obj: ObjectModel, loads: torch.Tensor, load: GripperLoad) -> np.ndarray:
    """Moment of the loads about the grasp point, less that of the weights, (K, 2)."""
    arm = obj.shape.particles - load.point.numpy()[:, None]
    return np.einsum("kp,kpd->kd", loads.numpy() - GRAVITY * obj.particle_mass, arm)


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("seed", range(3))
def test_loads_balance_weight_lift_and_moment(model, seed):
    obj = drawn_object(seed)
    load = carried(obj, seed)
    loads = loads_of(model, obj, load)
    assert_allclose(loads.sum(-1), obj.total_mass * GRAVITY - load.lift)
    assert_allclose(beyond_weights(obj, loads, load), load.moment, atol=1e-12)


def test_own_weight_lightens_the_held_group_and_no_other():
    load = carried(OBJECT)
    loads = loads_of("own_weight", OBJECT, load).numpy()
    for group, weight in enumerate(OBJECT.group_mass * GRAVITY):
        lifted = np.where(load.held.numpy() == group, load.lift.numpy(), 0.0)
        assert_allclose(loads[:, OBJECT.shape.mass_group == group].sum(axis=1), weight - lifted)


def test_rigid_loads_are_an_affine_field():
    loads = loads_of("rigid", OBJECT, carried(OBJECT)).numpy()
    basis = np.column_stack([np.ones(len(OBJECT.shape.particles)), OBJECT.shape.particles])
    fitted, *_ = np.linalg.lstsq(basis, loads.T, rcond=None)
    assert_allclose(basis @ fitted, loads.T, atol=1e-12)


def test_rigid_loads_know_only_the_weight_and_its_centre():
    particles = OBJECT.shape.particles
    basis = np.column_stack([np.ones(len(particles)), particles])
    hidden = np.random.default_rng(0).normal(scale=1e-3, size=len(particles))
    hidden -= basis @ np.linalg.lstsq(basis, hidden, rcond=None)[0]
    load = carried(OBJECT)
    other = loads_of("rigid", OBJECT, load, torch.tensor(OBJECT.particle_mass + hidden))
    assert_allclose(other, loads_of("rigid", OBJECT, load), atol=1e-12)


@pytest.fixture
def one_off_the_table() -> ObjectModel:
    """Four blocks, the second of them without contact."""
    cells = parse_layout(["111", "100"])
    return block_object(
        "o", cells, size=0.05, height=0.03, mass=[0.2] * 4, friction=[0.5], friction_group=[0, -1, 0, 0], grid=2
    )


@pytest.mark.parametrize("model", ["rigid"])
def test_particles_off_the_table_carry_nothing(model, one_off_the_table):
    off = one_off_the_table.shape.friction_group < 0
    assert_allclose(loads_of(model, one_off_the_table, GripperLoad.none(1))[:, off], 0)


def test_one_rigid_body_carries_what_has_no_feet(one_off_the_table):
    loads = loads_of("rigid", one_off_the_table, GripperLoad.none(1))
    assert_allclose(loads.sum(-1), one_off_the_table.total_mass * GRAVITY)


def test_a_group_off_the_table_has_nothing_to_rest_on(one_off_the_table):
    with pytest.raises(InvalidValueError, match="no foot under mass group"):
        loads_of("own_weight", one_off_the_table, GripperLoad.none(1))


@pytest.mark.parametrize("model", MODELS)
def test_the_order_of_particles_changes_nothing(model):
    shape, load = OBJECT.shape, carried(OBJECT)
    order = torch.tensor(np.random.default_rng(3).permutation(len(shape.particles)))
    particles, group = torch.tensor(shape.particles)[order], torch.tensor(shape.mass_group)[order]
    contact, mass = torch.tensor(shape.friction_group >= 0)[order], torch.tensor(OBJECT.particle_mass)[order]
    if model == "rigid":
        shuffled = rigid_loads(particles, contact, mass, load)
    else:
        shuffled = own_weight(particles, group, contact, mass, load).loads(load)
    assert_allclose(shuffled, loads_of(model, OBJECT, load)[:, order], atol=1e-12)


@pytest.mark.parametrize("model", MODELS)
def test_a_batch_is_its_windows_one_by_one(model):
    load = carried(OBJECT)
    together = loads_of(model, OBJECT, load)
    for k in range(len(load.lift)):
        alone = GripperLoad(*(value[k : k + 1] for value in vars(load).values()))
        assert_allclose(loads_of(model, OBJECT, alone)[0], together[k], atol=1e-12)


@pytest.mark.parametrize("model", MODELS)
def test_gradients_are_right(model):
    load = carried(OBJECT, count=2)

    def loads(mass: torch.Tensor, lift: torch.Tensor, moment: torch.Tensor) -> torch.Tensor:
        return loads_of(model, OBJECT, GripperLoad(lift, moment, load.held, load.point), mass)

    point = [torch.tensor(OBJECT.particle_mass), load.lift, load.moment]
    assert torch.autograd.gradcheck(loads, [value.clone().requires_grad_() for value in point])
