"""The particle model's dynamics: balances, invariances, and gradients."""

import numpy as np
import pytest
import torch
from numpy.testing import assert_allclose
from torch import Tensor

from estimators.testing.analytic_world import drawn_object
from estimators.wrench.model import ParticleModel, acceleration, inertia_of, one_step, rotate
from testbed.objects.files import load_object
from testbed.objects.model import GRAVITY
from tests.helpers.lcp_oracle import explicit_rollout

OBJECT = drawn_object(0, friction_groups=2)
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
