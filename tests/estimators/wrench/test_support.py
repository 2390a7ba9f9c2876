"""Support models: every load is accounted for, and nothing depends on the order of things."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from numpy.testing import assert_allclose
from torch import Tensor

from estimators.testing.analytic_world import drawn_object
from estimators.wrench.model import ParticleModel, rotate
from estimators.wrench.support import LOADS, GripperLoad
from testbed.objects.blocks import block_object, parse_layout
from testbed.objects.files import load_object
from testbed.objects.model import GRAVITY, ObjectModel

OBJECT = drawn_object(0, friction_groups=2)
ONE_OFF_THE_TABLE = block_object(
    "o",
    parse_layout(["111", "100"]),
    size=0.05,
    height=0.03,
    mass=[0.2] * 4,
    friction=[0.5],
    friction_group=[0, -1, 0, 0],
    grid=2,
)


def carried(obj: ObjectModel, seed: int = 0, count: int = 4) -> GripperLoad:
    """Random lift and moment at random particles of random blocks; every other lift is by two blocks."""
    rng = np.random.default_rng(seed)
    held = rng.integers(obj.shape.n_m, size=count)
    points = [obj.shape.particles[rng.choice(np.flatnonzero(obj.shape.mass_group == h))] for h in held]
    return GripperLoad(
        torch.tensor(rng.normal(size=count)),
        torch.tensor(rng.normal(scale=0.02, size=(count, 2))),
        torch.tensor(np.column_stack([held, np.where(np.arange(count) % 2, (held + 1) % obj.shape.n_m, held)])),
        torch.tensor(obj.shape.particles - np.array(points)[:, None]),
    )


def loads_of(support: str, obj: ObjectModel, load: GripperLoad, mass: Tensor | None = None) -> Tensor:
    mass = torch.tensor(obj.particle_mass) if mass is None else mass
    return LOADS[support](ParticleModel.of(obj.shape), mass, load)


@pytest.mark.parametrize("support", LOADS)
@pytest.mark.parametrize("seed", range(3))
def test_loads_balance_weight_lift_and_moment(support, seed):
    obj = drawn_object(seed)
    load = carried(obj, seed)
    loads = loads_of(support, obj, load)
    assert_allclose(loads.sum(-1), obj.total_mass * GRAVITY - load.lift)
    moment = np.einsum("kp,kpd->kd", loads.numpy() - GRAVITY * obj.particle_mass, load.lever)
    assert_allclose(moment, load.moment, atol=1e-12)


@pytest.mark.parametrize("balanced", [False, True], ids=["one tilt", "balanced"])
@pytest.mark.parametrize("support", LOADS)
def test_loads_balance_where_links_have_moved(support, balanced):
    still = carried(OBJECT)
    turn = torch.arange(len(still.lift)) * 0.7
    beyond = (ParticleModel.of(OBJECT.shape).mass_group > 1)[:, None]
    moved = replace(
        still, lever=torch.where(beyond, rotate(turn[:, None], still.lever), still.lever), balanced=balanced
    )
    loads = loads_of(support, OBJECT, moved)
    assert_allclose(loads.sum(-1), OBJECT.total_mass * GRAVITY - moved.lift)
    moment = np.einsum("kp,kpd->kd", loads.numpy() - GRAVITY * OBJECT.particle_mass, moved.lever)
    assert_allclose(moment, moved.moment, atol=1e-12)


def test_own_weight_lightens_the_held_groups_and_no_other():
    load = carried(OBJECT)
    loads = loads_of("own_weight", OBJECT, load).numpy()
    for group, weight in enumerate(OBJECT.group_mass * GRAVITY):
        lifted = (load.held.numpy() == group).mean(axis=1) * load.lift.numpy()
        assert_allclose(loads[:, OBJECT.shape.mass_group == group].sum(axis=1), weight - lifted)


def test_rigid_loads_are_an_affine_field_of_the_weight_and_its_center_alone():
    load, particles = carried(OBJECT), OBJECT.shape.particles
    loads = loads_of("rigid", OBJECT, load)
    basis = np.column_stack([np.ones(len(particles)), particles])
    fitted, *_ = np.linalg.lstsq(basis, loads.numpy().T, rcond=None)
    assert_allclose(basis @ fitted, loads.T, atol=1e-12)
    hidden = np.random.default_rng(0).normal(scale=1e-3, size=len(particles))
    hidden -= basis @ np.linalg.lstsq(basis, hidden, rcond=None)[0]
    assert_allclose(loads_of("rigid", OBJECT, load, torch.tensor(OBJECT.particle_mass + hidden)), loads, atol=1e-12)


def test_a_rigid_body_on_a_line_of_feet_shares_its_weight_evenly():
    obj = load_object("I1", 1)
    assert_allclose(
        loads_of("rigid", obj, GripperLoad.none(ParticleModel.of(obj.shape)))[0], obj.total_mass * GRAVITY / 6
    )


def test_one_rigid_body_carries_what_has_no_feet_by_either_name():
    none = GripperLoad.none(ParticleModel.of(ONE_OFF_THE_TABLE.shape))
    loads = loads_of("rigid", ONE_OFF_THE_TABLE, none)
    assert_allclose(loads[:, torch.tensor(ONE_OFF_THE_TABLE.shape.friction_group < 0)], 0)
    assert_allclose(loads.sum(-1), ONE_OFF_THE_TABLE.total_mass * GRAVITY)
    for load in (none, carried(ONE_OFF_THE_TABLE)):
        own, rigid = (loads_of(support, ONE_OFF_THE_TABLE, load) for support in ("own_weight", "rigid"))
        assert_allclose(own, rigid, atol=1e-12)


@pytest.mark.parametrize("support", LOADS)
def test_the_order_of_particles_changes_nothing(support):
    load, model = carried(OBJECT), ParticleModel.of(OBJECT.shape)
    order = torch.tensor(np.random.default_rng(3).permutation(len(model.particles)))
    names = ("particles", "mass_group", "friction_group", "fill")
    shuffled = replace(model, **{name: getattr(model, name)[order] for name in names})
    loads = LOADS[support](
        shuffled, torch.tensor(OBJECT.particle_mass)[order], replace(load, lever=load.lever[:, order])
    )
    assert_allclose(loads, loads_of(support, OBJECT, load)[:, order], atol=1e-12)


@pytest.mark.parametrize("support", LOADS)
def test_a_batch_is_its_windows_one_by_one(support):
    load = carried(OBJECT)
    together = loads_of(support, OBJECT, load)
    for k in range(len(load.lift)):
        alone = replace(load, **{n: value[k : k + 1] for n, value in vars(load).items() if n != "balanced"})
        assert_allclose(loads_of(support, OBJECT, alone)[0], together[k], atol=1e-12)


@pytest.mark.parametrize("support", LOADS)
def test_gradients_are_right(support):
    load = carried(OBJECT, count=2)

    def loads(mass: Tensor, lift: Tensor, moment: Tensor) -> Tensor:
        return loads_of(support, OBJECT, GripperLoad(lift, moment, load.held, load.lever), mass)

    point = [torch.tensor(OBJECT.particle_mass), load.lift, load.moment]
    assert torch.autograd.gradcheck(loads, [value.clone().requires_grad_() for value in point])
