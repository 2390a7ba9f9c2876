"""The particle model and the support models: balances, invariances, and gradients."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from numpy.testing import assert_allclose

from estimators.evaluation.metrics import normalized_absolute_difference
from estimators.particles.friction_system import LoadGroups
from estimators.particles.gripper_load import GripperLoad
from estimators.particles.model import (
    ParticleModel,
    acceleration,
    inertia_of,
    one_step,
    rollout,
    rotate,
)
from estimators.particles.support import own_weight, rigid_loads
from estimators.testing.analytic_world import drawn_object
from testbed.errors import InvalidValueError
from testbed.objects.files import load_object
from testbed.objects.model import GRAVITY, MassDistribution

OBJECT = drawn_object(0, friction_groups=2)
MODEL = ParticleModel.of(OBJECT.shape)
MASS = torch.tensor(OBJECT.truth.mass)
FRICTION = torch.tensor(OBJECT.truth.friction)
PARTICLE = MODEL.particle_mass(torch.tensor(OBJECT.truth.mass))
INERTIA = inertia_of(MODEL, PARTICLE)
DRAG = MODEL.particle_friction(torch.tensor(OBJECT.truth.friction)) * PARTICLE * GRAVITY
STILL = torch.zeros(3, dtype=torch.float64)
WEIGHTS = torch.stack([INERTIA.mass, INERTIA.mass, INERTIA.about_com])
LOAD = GripperLoad(
    lift=torch.tensor([0.0, 0.5, -1.0], dtype=torch.float64),
    moment=torch.tensor([[0.0, 0.0], [0.01, -0.02], [-0.03, 0.0]], dtype=torch.float64),
    held=torch.tensor([0, 2, 4]),
    point=torch.tensor(OBJECT.shape.particles[[4, 22, 40]]),
)


def tensor(*values: float) -> torch.Tensor:
    return torch.tensor(values, dtype=torch.float64)


def test_the_object_level_parameters_are_those_of_the_object():
    found = inertia_of(MODEL, MODEL.particle_mass(MASS))
    assert_allclose(found.mass, OBJECT.total_mass)
    assert_allclose(found.com, OBJECT.center_of_mass)
    assert_allclose(found.about_com, OBJECT.inertia_cm)


@pytest.mark.parametrize("rigid", [False, True])
def test_loads_balance_weight_lift_and_moment(rigid):
    mass = MODEL.particle_mass(MASS)
    if rigid:
        loads = rigid_loads(MODEL, mass, LOAD)
    else:
        loads = own_weight(MODEL, mass, LOAD).loads(LOAD)
    assert_allclose(loads.sum(-1), OBJECT.total_mass * GRAVITY - LOAD.lift)
    arm = MODEL.particles - LOAD.point[:, None]
    moment = torch.einsum("kp,kpd->kd", loads, arm)
    weights = GRAVITY * torch.einsum("p,kpd->kd", mass, arm) + LOAD.moment
    assert_allclose(moment, weights, atol=1e-12)


def test_own_weight_keeps_each_groups_weight_under_it():
    feet = own_weight(MODEL.particles, MODEL.mass_group, MODEL.contact, MODEL.particle_mass(MASS), LOAD)
    loads = feet.loads(GripperLoad(0 * LOAD.lift, LOAD.moment, LOAD.held, LOAD.point))
    for group in range(OBJECT.shape.n_m):
        assert_allclose(loads[:, MODEL.mass_group == group].sum(-1), OBJECT.group_mass[group] * GRAVITY)


def test_a_rigid_bodys_loads_are_affine_even_on_a_line_of_feet():
    obj = load_object("I1", 1)
    model = ParticleModel.of(obj.shape)
    loads = rigid_loads(
        model.particles, model.contact, model.particle_mass(torch.tensor(obj.truth.mass)), GripperLoad.none(1)
    )
    assert_allclose(loads[0], obj.total_mass * GRAVITY / 6)


def test_nothing_acts_on_a_free_object():
    zero = torch.zeros(len(OBJECT.shape.particles), dtype=torch.float64)
    inertia = inertia_of(MODEL, MODEL.particle_mass(MASS))
    a = acceleration(
        MODEL, inertia, zero, tensor(0, 0, 0.3), tensor(0.1, 0.2, 1.0), tensor(0, 0, 0), tensor(0.02, 0.01)
    )
    assert_allclose(a, 0, atol=1e-15)


def test_a_push_at_the_centre_only_pushes_and_a_couple_only_turns():
    zero = torch.zeros(len(OBJECT.shape.particles), dtype=torch.float64)
    inertia = inertia_of(MODEL, MODEL.particle_mass(MASS))
    still = tensor(0, 0, 0)
    a = acceleration(MODEL, inertia, zero, tensor(0, 0, 0.7), still, tensor(2.0, -1.0, 0.0), inertia.com)
    assert_allclose(a, [2 / OBJECT.total_mass, -1 / OBJECT.total_mass, 0], atol=1e-12)
    a = acceleration(MODEL, inertia, zero, tensor(0, 0, 0.7), still, tensor(0, 0, 0.3), tensor(0.05, 0.0))
    assert_allclose(a, [0, 0, 0.3 / OBJECT.inertia_cm], atol=1e-12)


def test_friction_takes_power_and_turning_the_world_turns_the_answer():
    inertia = inertia_of(MODEL, MODEL.particle_mass(MASS))
    drag = MODEL.particle_friction(FRICTION) * MODEL.particle_mass(MASS) * GRAVITY
    weights = torch.stack([inertia.mass, inertia.mass, inertia.about_com])
    rng = np.random.default_rng(0)
    for _ in range(10):
        velocity, pose, wrench = (torch.tensor(rng.normal(size=3)) for _ in range(3))
        grasp, turn = torch.tensor(rng.normal(size=2) * 0.05), torch.tensor(rng.uniform(-3, 3))
        free = acceleration(MODEL, inertia, drag, pose, velocity, 0 * wrench, grasp)
        assert float((weights * free) @ velocity) < 0
        a = acceleration(MODEL, inertia, drag, pose, velocity, wrench, grasp)
        moved = torch.cat([rotate(turn, pose[:2]) + 1.0, (pose[2] + turn)[None]])
        spun = [torch.cat([rotate(turn, v[:2]), v[2:]]) for v in (velocity, wrench, a)]
        assert_allclose(acceleration(MODEL, inertia, drag, moved, spun[0], spun[1], grasp), spun[2], atol=1e-9)


def test_gradients_of_the_one_step_model_and_of_a_rollout_are_right():
    pose, velocity = tensor(0, 0, 0.2).expand(2, 3, 3), tensor(0.05, -0.02, 0.4).expand(2, 3, 3)
    wrench = tensor(1.0, 0.5, 0.1).expand(2, 3, 3)
    grasp = torch.tensor(OBJECT.shape.particles[[4, 13]])

    def one(mass: torch.Tensor, friction: torch.Tensor) -> torch.Tensor:
        particle = MODEL.particle_mass(mass)
        drag = (MODEL.particle_friction(friction) * particle * GRAVITY).expand(2, 3, -1)
        return one_step(MODEL, inertia_of(MODEL, particle), drag, pose, velocity, wrench, grasp, 0.01)

    def many(mass: torch.Tensor, friction: torch.Tensor) -> torch.Tensor:
        particle = MODEL.particle_mass(mass)
        drag = (MODEL.particle_friction(friction) * particle * GRAVITY).expand(3, -1)
        return torch.cat(
            rollout(MODEL, inertia_of(MODEL, particle), drag, pose[0, 0], velocity[0, 0], wrench[0], grasp[0], 0.01)
        )

    point = (MASS.clone().requires_grad_(), FRICTION.clone().requires_grad_())
    assert torch.autograd.gradcheck(one, point)
    assert torch.autograd.gradcheck(many, point)


def test_the_first_step_of_a_rollout_is_the_one_step_model():
    inertia = inertia_of(MODEL, MODEL.particle_mass(MASS))
    drag = (MODEL.particle_friction(FRICTION) * MODEL.particle_mass(MASS) * GRAVITY)[None]
    state = tensor(0.1, 0.2, 0.3), tensor(0.05, -0.02, 0.4)
    wrench, grasp = tensor(1.0, 0.5, 0.1)[None], tensor(0.02, 0.03)
    _, velocities = rollout(MODEL, inertia, drag, *state, wrench, grasp, 0.01)
    assert_allclose(velocities, one_step(MODEL, inertia, drag, state[0][None], state[1][None], wrench, grasp, 0.01))


def test_load_groups_pair_mass_and_friction_groups():
    groups = LoadGroups.of(MODEL)
    assert len(groups.pairs) == OBJECT.shape.n_m
    ones = torch.ones(2, len(OBJECT.shape.particles), dtype=torch.float64)
    assert_allclose(groups.gather(ones), 9)


def test_nad_counts_misplaced_mass():
    shape = load_object("I1").shape
    truth = MassDistribution(np.full(6, 0.1), np.array([0.5]))
    moved = MassDistribution(np.array([0.2, 0.0, 0.1, 0.1, 0.1, 0.1]), np.array([0.5]))
    assert normalized_absolute_difference(shape, truth, truth) == 0
    assert normalized_absolute_difference(shape, moved, truth) == pytest.approx(1 / 3)
    with pytest.raises(InvalidValueError, match="6 numbers"):
        normalized_absolute_difference(shape, MassDistribution(np.ones(5), np.ones(1)), truth)


def test_a_sliding_object_of_one_friction_slows_by_mu_g_and_does_not_turn():
    obj = load_object("L2")
    model = ParticleModel.of(obj.shape)
    particle = model.particle_mass(torch.tensor(obj.truth.mass))
    drag = 0.5 * particle * GRAVITY
    a = acceleration(model, inertia_of(model, particle), drag, STILL, tensor(0.3, -0.4, 0), STILL, STILL[:2])
    assert_allclose(a, 0.5 * GRAVITY * np.array([-0.6, 0.8, 0.0]), atol=1e-9)


def test_a_spin_about_the_centre_of_mass_is_slowed_by_every_lever():
    a = acceleration(MODEL, INERTIA, DRAG, STILL, tensor(0, 0, 5.0), STILL, INERTIA.com)
    arm = torch.linalg.norm(MODEL.particles - INERTIA.com, dim=1)
    assert_allclose(a[2], -(DRAG * arm).sum() / INERTIA.about_com, rtol=1e-6)


def test_a_free_object_keeps_its_momentum_over_a_rollout():
    free = torch.zeros(50, len(PARTICLE), dtype=torch.float64)
    velocity = tensor(0.2, -0.1, 1.5)
    _, velocities = rollout(MODEL, INERTIA, free, STILL, velocity, STILL.expand(50, 3), STILL[:2], 0.01)
    assert_allclose(velocities, velocity.expand(50, 3), atol=1e-13)


def test_friction_takes_kinetic_energy_in_every_step_of_a_rollout():
    start = tensor(0.5, -0.3, 4.0)
    drag, push = DRAG.expand(5, -1), STILL.expand(5, 3)
    _, velocities = rollout(MODEL, INERTIA, drag, STILL, start, push, STILL[:2], 1e-3)
    energy = (WEIGHTS * torch.cat([start[None], velocities]) ** 2).sum(-1) / 2
    assert (energy.diff() < 0).all()


def test_a_batch_is_its_states_one_by_one():
    rng = np.random.default_rng(0)
    pose, velocity, wrench = (torch.tensor(rng.normal(size=(4, 6, 3))) for _ in range(3))
    grasp = torch.tensor(rng.normal(scale=0.05, size=(4, 2)))
    drag = DRAG.expand(4, 6, -1)
    together = one_step(MODEL, INERTIA, drag, pose, velocity, wrench, grasp, 0.01)
    poses, velocities = rollout(MODEL, INERTIA, drag, pose[:, 0], velocity[:, 0], wrench, grasp, 0.01)
    for k in range(4):
        alone = one_step(MODEL, INERTIA, drag[k], pose[k], velocity[k], wrench[k], grasp[k], 0.01)
        assert_allclose(alone, together[k], atol=1e-12)
        p, v = rollout(MODEL, INERTIA, drag[k], pose[k, 0], velocity[k, 0], wrench[k], grasp[k], 0.01)
        assert_allclose(p, poses[k], atol=1e-12)
        assert_allclose(v, velocities[k], atol=1e-12)
