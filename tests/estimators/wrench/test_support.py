"""The particle model: loads of its feet, from own weight to one rigid body, and its dynamics."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from numpy.testing import assert_allclose
from scipy.linalg import null_space
from torch import Tensor

from estimators.particles.links import carried_moment
from estimators.testing.analytic_world import drawn_object, foundation
from estimators.wrench.model import ParticleModel, acceleration, inertia_of, one_step, rotate
from estimators.wrench.support import LOADS, GripperLoad, Springs, nulled_load
from testbed import GRAVITY, ObjectModel, Support, load_object
from testbed.simulation.contacts import foot_stiffness, resting_loads
from testbed.simulation.settings import ContactSettings
from testbed.worlds.setup_errors import EXACT_SETUP
from tests.helpers.blocks import blocks
from tests.helpers.lcp_oracle import explicit_rollout

OBJECT = drawn_object(0, friction_groups=2)
ONE_OFF_THE_TABLE = blocks(["111", "100"], [0.2] * 4, groups=[0, -1, 0, 0], grid=2)


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


def turned_links(*, balanced: bool) -> GripperLoad:
    """Load of the gripper on OBJECT, whose groups from the third on have turned."""
    still = carried(OBJECT)
    turn = torch.arange(len(still.lift))[:, None] * 0.7
    beyond = (ParticleModel.of(OBJECT.shape).mass_group > 1)[:, None]
    return replace(still, lever=torch.where(beyond, rotate(turn, still.lever), still.lever), balanced=balanced)


CARRIED = {f"object {seed}": (drawn_object(seed), carried(drawn_object(seed), seed)) for seed in range(3)}
CARRIED |= {f"links, balanced {each}": (OBJECT, turned_links(balanced=each)) for each in (False, True)}


@pytest.mark.parametrize("support", LOADS)
@pytest.mark.parametrize("name", CARRIED)
def test_loads_balance_weight_lift_and_moment(support, name):
    obj, load = CARRIED[name]
    loads = loads_of(support, obj, load)
    assert_allclose(loads.sum(-1), obj.total_mass * GRAVITY - load.lift)
    moment = np.einsum("kp,kpd->kd", loads.numpy() - GRAVITY * obj.particle_mass, load.lever)
    assert_allclose(moment, load.moment, atol=1e-12)


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
    none = GripperLoad.none(ParticleModel.of(obj.shape))
    assert_allclose(loads_of("rigid", obj, none)[0], obj.total_mass * GRAVITY / 6)


def test_an_object_with_a_group_off_the_table_is_one_rigid_body_under_either_support():
    none = GripperLoad.none(ParticleModel.of(ONE_OFF_THE_TABLE.shape))
    loads = loads_of("rigid", ONE_OFF_THE_TABLE, none)
    assert_allclose(loads[:, torch.tensor(ONE_OFF_THE_TABLE.shape.friction_group < 0)], 0)
    assert_allclose(loads.sum(-1), ONE_OFF_THE_TABLE.total_mass * GRAVITY)
    for load in (none, carried(ONE_OFF_THE_TABLE)):
        own, rigid = (loads_of(support, ONE_OFF_THE_TABLE, load) for support in ("own_weight", "rigid"))
        assert_allclose(own, rigid, atol=1e-12)


@pytest.mark.parametrize("support", LOADS)
def test_loads_follow_their_particles_and_windows(support):
    load, model = carried(OBJECT), ParticleModel.of(OBJECT.shape)
    together = loads_of(support, OBJECT, load)
    order = torch.tensor(np.random.default_rng(3).permutation(len(model.particles)))
    names = ("particles", "mass_group", "friction_group", "fill")
    permuted = replace(model, **{name: getattr(model, name)[order] for name in names})
    mass = torch.tensor(OBJECT.particle_mass)[order]
    loads = LOADS[support](permuted, mass, replace(load, lever=load.lever[:, order]))
    assert_allclose(loads, together[:, order], atol=1e-12)
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


PADS = np.array([[-0.02, -0.02], [0.02, -0.02], [0.0, 0.02]])
L2 = load_object("L2")
ONE_FOOT = blocks(["111", "010"], [0.1, 0.4, 0.2, 0.3], 0.4, grid=1)
OBJECTS = {
    "I2": load_object("I2"),
    "F2": load_object("F2"),
    "two frictions": drawn_object(4, friction_groups=2),
    "a foot each": ONE_FOOT,
    "pads": L2.on_feet([L2.shape.middle_of(group) + PADS for group in range(L2.shape.n_m)]),
}


def springs_of(obj: ObjectModel) -> tuple[Springs, Tensor, Tensor]:
    """Springs between the groups, and loads on own weight and under one rigid body, N."""
    model = ParticleModel.of(obj.shape)
    own, rigid = (loads_of(support, obj, GripperLoad.none(model))[0] for support in ("own_weight", "rigid"))
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
def test_springs_end_at_own_weight_and_one_rigid_body(name):
    springs, own, rigid = springs_of(OBJECTS[name])
    assert_allclose(springs.joined(own, torch.tensor(0.0)), own, atol=1e-12)
    assert_allclose(springs.joined(own, torch.tensor(1.0)), rigid, atol=1e-10)


@pytest.mark.parametrize("share", [0.01, 0.3, 0.5, 0.9, 0.99])
@pytest.mark.parametrize("name", ["I2", "F2", "two frictions", "a foot each"])
def test_loads_of_springs_are_those_at_rest_in_simulation(name, share):
    obj = OBJECTS[name]
    springs, own, _ = springs_of(obj)
    expected = resting_loads(obj, Support(stiffness=stiffness(obj, springs, share)), ContactSettings())
    assert_allclose(springs.joined(own, torch.tensor(share, dtype=torch.float64)), expected, atol=1e-9)


@pytest.mark.parametrize("share", [-0.2, 0.0, 0.4, 1.0, 1.3])
@pytest.mark.parametrize("name", OBJECTS)
def test_springs_keep_weight_and_moments_and_have_continuous_slopes(name, share):
    obj = OBJECTS[name]
    springs, own, _ = springs_of(obj)
    at = torch.tensor(share, dtype=torch.float64)
    joined = springs.joined(own, at)
    basis = torch.cat([torch.ones(len(own), 1), torch.tensor(obj.shape.particles)], 1)
    assert_allclose(joined @ basis, own @ basis, atol=1e-10)
    slope = torch.func.jacrev(lambda s: springs.joined(own, s))(at)
    for step in (-1e-7, 1e-7):
        assert_allclose((springs.joined(own, at + step) - joined) / step, slope, rtol=1e-4, atol=1e-5)


def test_a_hand_may_carry_the_weight_of_groups_beside_their_feet():
    drag = torch.tensor(4.0, dtype=torch.float64)
    block, hammer = (ParticleModel.of(load_object(name).shape) for name in ("L2", "hammer"))
    assert float(carried_moment(block, drag, EXACT_SETUP)) < 1e-12
    moment = float(carried_moment(hammer, drag, EXACT_SETUP))
    assert 0.01 < moment < 8.0 * float(hammer.reach)  # the weight at the reach
    nulled, still, pushed = np.array([0.06, 5e-4, 5e-4]), np.array([False]), np.array([False])
    for links in (False, True):
        mean, change = nulled_load(nulled, still, pushed, moment, links=links)
        assert_allclose(mean, [[0.06, moment, moment]])
        assert (change[0, 1:] == moment).all() == links


MODEL = ParticleModel.of(OBJECT.shape)
MASS, FRICTION = torch.tensor(OBJECT.truth.mass), torch.tensor(OBJECT.truth.friction)
PARTICLE = MODEL.particle_mass(MASS)
INERTIA = inertia_of(MODEL, PARTICLE)
DRAG = MODEL.particle_friction(FRICTION) * PARTICLE * GRAVITY
STILL = torch.zeros(3, dtype=torch.float64)
WEIGHTS = torch.stack([INERTIA.mass, INERTIA.mass, INERTIA.about_com])
DT = 0.01


def tensor(*values: float) -> Tensor:
    return torch.tensor(values, dtype=torch.float64)


def test_the_object_level_parameters_are_those_of_the_object():
    assert_allclose(INERTIA.mass, OBJECT.total_mass)
    assert_allclose(INERTIA.com, OBJECT.center_of_mass)
    assert_allclose(INERTIA.about_com, OBJECT.inertia_cm)


@pytest.mark.parametrize(
    ("velocity", "wrench", "grasp", "expected"),
    [
        ((0.1, 0.2, 1.0), (0, 0, 0), (0.02, 0.01), (0, 0, 0)),
        ((0, 0, 0), (2.0, -1.0, 0.0), None, (2 / OBJECT.total_mass, -1 / OBJECT.total_mass, 0)),
        ((0, 0, 0), (0, 0, 0.3), (0.05, 0.0), (0, 0, 0.3 / OBJECT.inertia_cm)),
    ],
    ids=["free", "push at c", "couple"],
)
def test_a_push_at_the_center_only_pushes_and_a_couple_only_turns(velocity, wrench, grasp, expected):
    at = INERTIA.com if grasp is None else tensor(*grasp)
    a = acceleration(MODEL, INERTIA, 0 * PARTICLE, tensor(0, 0, 0.7), tensor(*velocity), tensor(*wrench), at)
    assert_allclose(a, expected, atol=1e-12)


def test_friction_takes_power_and_turning_the_world_turns_the_answer():
    rng = np.random.default_rng(0)
    for _ in range(10):
        velocity, pose, wrench = (torch.tensor(rng.normal(size=3)) for _ in range(3))
        grasp, turn = torch.tensor(rng.normal(size=2) * 0.05), torch.tensor(rng.uniform(-3, 3))
        free = acceleration(MODEL, INERTIA, DRAG, pose, velocity, 0 * wrench, grasp)
        assert float((WEIGHTS * free) @ velocity) < 0
        a = acceleration(MODEL, INERTIA, DRAG, pose, velocity, wrench, grasp)
        moved = torch.cat([rotate(turn, pose[:2]) + 1.0, (pose[2] + turn)[None]])
        spun = [torch.cat([rotate(turn, v[:2]), v[2:]]) for v in (velocity, wrench, a)]
        assert_allclose(acceleration(MODEL, INERTIA, DRAG, moved, spun[0], spun[1], grasp), spun[2], atol=1e-9)


def test_gradients_of_the_one_step_model_are_right():
    pose, velocity = tensor(0, 0, 0.2).expand(2, 3, 3), tensor(0.05, -0.02, 0.4).expand(2, 3, 3)
    wrench = tensor(1.0, 0.5, 0.1).expand(2, 3, 3)
    grasp = torch.tensor(OBJECT.shape.particles[[4, 13]])

    def one(mass: Tensor, friction: Tensor, velocity: Tensor, pose: Tensor) -> Tensor:
        particle = MODEL.particle_mass(mass)
        drag = (MODEL.particle_friction(friction) * particle * GRAVITY).expand(2, 3, -1)
        return one_step(MODEL, inertia_of(MODEL, particle), drag, pose, velocity, wrench, grasp, DT)

    point = [each.clone().requires_grad_() for each in (MASS, FRICTION, velocity, pose)]
    assert torch.autograd.gradcheck(one, point)


def test_a_sliding_object_of_one_friction_slows_by_mu_g_and_does_not_turn():
    obj = load_object("L2")
    model = ParticleModel.of(obj.shape)
    particle = model.particle_mass(torch.tensor(obj.truth.mass))
    drag = 0.5 * particle * GRAVITY
    a = acceleration(model, inertia_of(model, particle), drag, STILL, tensor(0.3, -0.4, 0), STILL, STILL[:2])
    assert_allclose(a, 0.5 * GRAVITY * np.array([-0.6, 0.8, 0.0]), atol=1e-9)


def test_a_spin_about_the_center_of_mass_is_slowed_by_every_lever():
    a = acceleration(MODEL, INERTIA, DRAG, STILL, tensor(0, 0, 5.0), STILL, INERTIA.com)
    arm = torch.linalg.norm(MODEL.particles - INERTIA.com, dim=1)
    assert_allclose(a[2], -(DRAG * arm).sum() / INERTIA.about_com, rtol=1e-6)


def test_a_free_body_keeps_momentum_and_friction_takes_energy_in_every_step():
    start = tensor(0.5, -0.3, 4.0)
    state, alone = (STILL, start), STILL.expand(50, 3)
    _, free = explicit_rollout(MODEL, INERTIA, 0 * DRAG.expand(50, -1), *state, alone, STILL[:2], DT)
    assert_allclose(free, start.expand(50, 3), atol=1e-13)
    _, slowed = explicit_rollout(MODEL, INERTIA, DRAG.expand(5, -1), *state, alone[:5], STILL[:2], 1e-3)
    energy = (WEIGHTS * torch.cat([start[None], slowed]) ** 2).sum(-1) / 2
    assert (energy.diff() < 0).all()


def test_a_batch_is_its_states_one_by_one():
    rng = np.random.default_rng(0)
    pose, velocity, wrench = (torch.tensor(rng.normal(size=(4, 6, 3))) for _ in range(3))
    grasp = torch.tensor(rng.normal(scale=0.05, size=(4, 2)))
    drag = DRAG.expand(4, 6, -1)
    together = one_step(MODEL, INERTIA, drag, pose, velocity, wrench, grasp, DT)
    for k in range(4):
        alone = one_step(MODEL, INERTIA, drag[k], pose[k], velocity[k], wrench[k], grasp[k], DT)
        assert_allclose(alone, together[k], atol=1e-12)
