"""The complementarity time step: against textbook solvers, the axioms of dry friction, and its gradients."""

import math
from dataclasses import dataclass, replace

import numpy as np
import pytest
import torch
from numpy.testing import assert_allclose

from estimators.baselines.dry_friction import LcpError
from estimators.baselines.lcp import LcpEngine, _Advance, polygon_sides
from estimators.testing.analytic_world import drawn_object
from estimators.wrench.model import Inertia, ParticleModel, inertia_of, rotate
from testbed import GRAVITY
from tests.helpers.lcp_oracle import Step, Textbook, explicit_rollout, interior_point, rollout, solve_step

OBJECTS = [drawn_object(seed, friction_groups=2) for seed in range(3)]
MODEL = ParticleModel.of(OBJECTS[0].shape)
MASS, FRICTION = torch.tensor(OBJECTS[0].truth.mass), torch.tensor(OBJECTS[0].truth.friction)
INERTIA = inertia_of(MODEL, MODEL.particle_mass(MASS))
DRAG = MODEL.particle_friction(FRICTION) * MODEL.particle_mass(MASS) * GRAVITY
WEIGHTS = torch.stack([INERTIA.mass, INERTIA.mass, INERTIA.about_com])
STILL = torch.zeros(3, dtype=torch.float64)
KINDS = ("slides", "turns", "slows", "creeps", "sticks", "slides along a corner", "starts from rest", "rests")


def tensor(*values: float) -> torch.Tensor:
    return torch.tensor(values, dtype=torch.float64)


@dataclass(frozen=True)
class Case:
    """One body's step, as in `Textbook.of`."""

    mass: np.ndarray
    momentum: np.ndarray
    jacobians: np.ndarray
    bound: np.ndarray
    directions: int

    @property
    def tensors(self) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor]:
        """Arguments of `solve_step`, a batch of one."""
        parts = (self.mass, self.momentum, self.jacobians[:, :, 2], self.bound)
        mass, momentum, arms, bound = (torch.tensor(x)[None] for x in parts)
        return mass, momentum, arms, bound

    @property
    def lines(self) -> np.ndarray:
        """Lines of all sides."""
        return np.einsum("sd,cdn->csn", polygon_sides(self.directions).numpy(), self.jacobians).reshape(-1, 3)

    @property
    def textbook(self) -> Textbook:
        """The textbook's problem."""
        return Textbook.of(self.mass, self.momentum, self.jacobians, self.bound, self.directions)

    def residual(self, step: Step) -> float:
        """Residual of the textbook's complementarity, N s and m/s."""
        sides = polygon_sides(self.directions).numpy()
        z = self.textbook.unknowns(step.velocity[0].numpy(), step.impulse[0].numpy(), sides)
        return self.textbook.residual(z)


def drawn_case(kind: str, directions: int, seed: int, feet: int | None = None) -> Case:
    """A random object on a few of its feet, or on all of them for 0; one foot in eight has no friction."""
    rng = np.random.default_rng([KINDS.index(kind), directions, seed])
    obj = OBJECTS[seed % len(OBJECTS)]
    arm = obj.shape.particles[obj.shape.friction_group >= 0] - obj.center_of_mass
    count = int(rng.integers(2, 7)) if feet is None else feet or len(arm)
    x, y = arm[rng.permutation(len(arm))[:count]].T
    one, zero = np.ones(count), np.zeros(count)
    jacobians = np.stack([np.column_stack([one, zero, -y]), np.column_stack([zero, one, x])], axis=1)
    h = 10 ** rng.uniform(math.log10(5e-4), -2)
    bound = h * obj.total_mass * GRAVITY / count * rng.uniform(0.1, 0.8, count)
    pivot = int(bound.argmax())
    bound[(rng.random(count) < 1 / 8) & (bound < bound.max())] = 0.0
    corner = 2 * math.pi * rng.integers(directions) / directions
    velocity = {
        "slides": [*rng.normal(scale=0.2, size=2), rng.normal(scale=0.3)],
        "turns": [*rng.normal(scale=0.005, size=2), rng.choice([-1, 1]) * rng.uniform(3.0, 6.0)],
        "slows": [*rng.normal(scale=0.3 * h, size=2), rng.normal(scale=10 * h)],
        "creeps": rng.choice([-0.5, 0.5]) * np.array([y[pivot], -x[pivot], 1.0]),
        "slides along a corner": [0.2 * math.cos(corner), 0.2 * math.sin(corner), 0.0],
    }.get(kind, np.zeros(3))
    mass = np.diag([obj.total_mass, obj.total_mass, obj.inertia_cm])
    push = np.zeros(3)
    if kind == "creeps":  # the other feet do not hold it as it turns about the strongest
        bound[pivot] = 3 * bound.sum()
    elif kind == "sticks":
        push = np.einsum("cdn,cd,c->n", jacobians, rng.uniform(-0.5, 0.5, (count, 2)), bound)
    elif kind == "starts from rest":
        push = 3 * bound.sum() * np.append(rng.normal(size=2), rng.normal(scale=0.05))
    return Case(mass, mass @ np.asarray(velocity) + push, jacobians, bound, directions)


@pytest.mark.parametrize("directions", [4, 8, 16])
@pytest.mark.parametrize("kind", KINDS)
def test_a_step_solves_the_textbooks_problem_and_friction_takes_power(kind, directions):
    for seed in range(6):
        case = drawn_case(kind, directions, seed)
        step = solve_step(*case.tensors, case.directions)
        assert case.residual(step) < 1e-9
        velocity = step.velocity[0].numpy()
        speed = np.linalg.norm(case.jacobians @ velocity, axis=1)
        assert {
            "slides": speed.min() > 1e-3,
            "turns": abs(velocity[2]) > 1e-3,
            "creeps": speed[case.bound.argmax()] < 1e-9 and speed.max() > 1e-3,
            "sticks": speed.max() < 1e-9,
            "starts from rest": speed.max() > 1e-3,
        }.get(kind, True), "a case is what its name says"
        lines, impulse = case.lines, step.impulse[0].numpy()
        balance = case.mass @ velocity + lines.T @ impulse - case.momentum
        assert np.abs(balance).max() <= 1e-10 * (np.abs(case.momentum).max() + case.bound.sum())
        power = impulse * (lines @ velocity)
        assert (power >= -1e-12 * case.bound.max() * (1e-3 + np.abs(velocity).max())).all()
        free = case.textbook.free
        assert velocity @ case.mass @ velocity <= free @ case.mass @ free * (1 + 1e-12)


@pytest.mark.parametrize(("kind", "feet"), [*((kind, None) for kind in KINDS), ("slides", 0), ("creeps", 0)])
def test_a_textbook_solver_finds_the_same_velocity(kind, feet):
    case = drawn_case(kind, 8, 0, feet=feet)
    dense = interior_point(case.textbook)
    assert case.textbook.residual(dense) < 1e-8
    assert_allclose(solve_step(*case.tensors, case.directions).velocity[0], case.textbook.velocity(dense), atol=1e-8)


@pytest.mark.parametrize("directions", [4, 8])
def test_a_batch_is_its_bodies_one_by_one_whatever_the_guess(directions):
    cases = [drawn_case(kind, directions, seed, feet=5) for kind in KINDS for seed in range(6)]
    together = [torch.cat(x) for x in zip(*(case.tensors for case in cases), strict=True)]
    step = solve_step(*together, directions)  # pyright: ignore
    for k, case in enumerate(cases):
        assert_allclose(step.velocity[k], solve_step(*case.tensors, case.directions).velocity[0], atol=1e-10)
    generator = torch.Generator().manual_seed(0)
    bound = together[3].repeat_interleave(directions // 2, 1)
    noise = 2 * torch.rand(bound.shape, generator=generator, dtype=torch.float64) - 1
    wrong = [-step.used, 0 * step.used, noise, noise.sign(), step.used.roll(1, 0)]
    for guess in (step.used, *wrong):
        again = solve_step(*together, directions, guess)  # pyright: ignore
        assert_allclose(again.velocity, step.velocity, atol=1e-9)
        assert (again.impulse.abs() <= bound * (1 + 1e-9)).all()


def test_bounds_of_any_ratio_and_no_friction_are_solved():
    for seed in range(12):
        case = drawn_case("sticks" if seed % 2 else "slows", 8, seed, feet=5)
        ratio = 10.0 ** np.random.default_rng(seed).choice([0, -3, -6, -9, -12, -np.inf], 5)
        case = replace(case, bound=case.bound * ratio)
        step = solve_step(*case.tensors, case.directions)
        assert case.residual(step) < 1e-9
        free = replace(case, bound=0 * case.bound)
        assert_allclose(solve_step(*free.tensors, free.directions).velocity[0], case.textbook.free, rtol=1e-12)


def test_a_body_exactly_at_its_limit_stays():
    for seed in range(24):
        case = drawn_case("sticks", (4, 8, 16)[seed % 3], seed)
        corners = case.textbook.corners[np.random.default_rng(seed).integers(case.directions, size=len(case.bound))]
        limit = replace(case, momentum=np.einsum("cdn,cd,c->n", case.jacobians, corners, case.bound))
        step = solve_step(*limit.tensors, limit.directions)
        assert limit.residual(step) < 1e-9
        assert step.velocity.abs().max() < 1e-6


@pytest.mark.parametrize("corner", range(8))
def test_a_body_sliding_along_a_corner_slows_by_mu_g_and_stops(corner):
    angle = torch.tensor(2 * math.pi * corner / 8, dtype=torch.float64)
    along = torch.stack([angle.cos(), angle.sin(), torch.zeros_like(angle)])
    mu, dt = 0.4, 0.01
    drag = (mu * GRAVITY * MODEL.particle_mass(MASS)).expand(12, -1)
    start, push = 0.3 * along, STILL.expand(12, 3)
    _, velocity = rollout(LcpEngine(8, 3), MODEL, INERTIA, drag, STILL, start, push, STILL[:2], dt)
    speed = (0.3 - mu * GRAVITY * dt * torch.arange(1, 13, dtype=torch.float64)).clamp(min=0.0)
    assert speed[-1] == 0 < speed[5]
    assert_allclose(velocity, speed[:, None] * along, atol=1e-12)


def test_turning_the_world_by_a_corner_or_mirroring_it_turns_or_mirrors_the_motion():
    rng = np.random.default_rng(0)
    friction = DRAG.expand(20, -1)
    pose, velocity = torch.tensor(rng.normal(size=3)), torch.tensor(rng.normal(size=3) * [0.2, 0.2, 2.0])
    wrench = torch.tensor(rng.normal(size=(20, 3)) * [2.0, 2.0, 0.05])
    grasp = torch.tensor(OBJECTS[0].shape.particles[4])
    engine = LcpEngine(8, 2)
    poses, velocities = rollout(engine, MODEL, INERTIA, friction, pose, velocity, wrench, grasp, 0.01)

    turn = torch.tensor(2 * math.pi * 3 / 8, dtype=torch.float64)

    def turned(x: torch.Tensor) -> torch.Tensor:
        return torch.cat([rotate(turn.expand(x.shape[:-1]), x[..., :2]), x[..., 2:]], -1)

    start = turned(pose) + torch.stack([0 * turn, 0 * turn, turn])
    spun, moved = rollout(engine, MODEL, INERTIA, friction, start, turned(velocity), turned(wrench), grasp, 0.01)
    assert_allclose(moved, turned(velocities), atol=1e-9)
    assert_allclose(spun[:, :2], turned(poses)[:, :2], atol=1e-9)

    flip = tensor(1, -1, -1)
    mirror = replace(MODEL, particles=MODEL.particles * flip[:2])
    inertia = Inertia(INERTIA.mass, INERTIA.com * flip[:2], INERTIA.about_com)
    _, moved = rollout(
        engine, mirror, inertia, friction, pose * flip, velocity * flip, wrench * flip, grasp * flip[:2], 0.01
    )
    assert_allclose(moved, velocities * flip, atol=1e-9)


@pytest.mark.parametrize("directions", [4, 6, 8, 16])
def test_friction_of_a_sliding_contact_is_within_the_nearest_corner_of_coulombs(directions):
    # the corner with most power lies within pi / n of the motion: a chord of 2 sin(pi / 2n)
    angle = torch.linspace(0, 2 * math.pi, 1001, dtype=torch.float64)
    count = len(angle)
    momentum = torch.stack([angle.cos(), angle.sin(), 0 * angle], -1)
    sides = polygon_sides(directions)
    arms, bound = torch.zeros(count, 1, 2, dtype=torch.float64), torch.full((count, 1), 0.01, dtype=torch.float64)
    step = solve_step(torch.eye(3, dtype=torch.float64).expand(count, 3, 3), momentum, arms, bound, directions)
    polygon = -step.impulse @ sides / 0.01
    unit = step.velocity[:, :2] / step.velocity[:, :2].norm(dim=-1, keepdim=True)
    error = float((polygon + unit).norm(dim=-1).max())
    chord = 2 * math.sin(math.pi / (2 * directions))
    assert 0.9 * chord < error < chord * (1 + 1e-9)


START, SPUN, PUSH = tensor(0.1, 0.2, 0.3), tensor(0.3, -0.2, 4.0), tensor(0.5, 0.3, 0.02)


@pytest.fixture(scope="module")
def coulomb() -> torch.Tensor:
    """Velocity after 0.1 s of sliding under exact Coulomb friction, from fine explicit steps."""
    steps = 2000
    _, velocity = explicit_rollout(
        MODEL, INERTIA, DRAG.expand(steps, -1), START, SPUN, PUSH.expand(steps, 3), INERTIA.com, 0.1 / steps
    )
    return velocity[-1]


def slid(directions: int, substeps: int) -> torch.Tensor:
    """The engine's answer to `coulomb`."""
    engine = LcpEngine(directions, substeps)
    _, velocity = rollout(
        engine, MODEL, INERTIA, DRAG.expand(10, -1), START, SPUN, PUSH.expand(10, 3), INERTIA.com, 0.01
    )
    return velocity[-1]


@pytest.mark.slow
def test_rollouts_go_to_coulombs_as_corners_and_substeps_grow(coulomb):
    assert float(coulomb[2]) > 0.5, "it slides all the while"
    # monotone friction: errors of the force add up and never grow, in the norm of M
    reach = (1 / INERTIA.mass + (MODEL.particles - INERTIA.com).square().sum(-1) / INERTIA.about_com).sqrt()
    errors = {}
    for directions in (4, 8, 32):
        error = float((WEIGHTS * (slid(directions, 24) - coulomb).square()).sum().sqrt())
        chord = 2 * math.sin(math.pi / (2 * directions))
        assert error < 0.1 * chord * float((DRAG * reach).sum())
        errors[directions] = error
    assert errors[8] < errors[4] / 2
    assert errors[32] < errors[4] / 10

    fine = slid(8, 24)
    by_step = [float((slid(8, n) - fine).norm()) for n in (1, 3)]
    assert by_step[0] > 2 * by_step[1]


def gradient_case(name: str) -> tuple[Case, list[torch.Tensor], torch.Tensor]:
    """A body on four feet, in units of its own, of which as many sides stick as its name says: the step, its parts."""
    arm = np.array([[1.0, 0.8], [-0.7, 0.9], [-1.1, -0.6], [0.6, -1.0]])
    jacobians = np.stack([np.column_stack([[1.0] * 4, [0.0] * 4, -arm[:, 1]]),
                          np.column_stack([[0.0] * 4, [1.0] * 4, arm[:, 0]])], axis=1)  # fmt: skip
    bound, momentum = np.array([0.3, 0.2, 0.25, 0.15]), np.array([4.0, -2.2, 1.1])
    if name == "one side sticks":
        momentum = np.array([-1.8, -0.9, 0.4])
    elif name == "a foot sticks":
        bound, momentum = np.array([3.0, 0.2, 0.25, 0.15]), 2.0 * np.array([0.8, -1.0, 1.0])
    elif name == "all stick":
        momentum = np.array([-0.2, 0.1, 0.03])
    weights, push, grasp = np.array([2.0, 2.0, 1.5]), np.array([0.3, -0.2, 0.1]), np.array([0.2, -0.3])
    turning = push[2] + grasp[0] * push[1] - grasp[1] * push[0]
    velocity = (momentum - np.array([*push[:2], turning])) / weights
    # seen from a frame that is turned and moved
    turn, com = np.array([[np.cos(0.4), np.sin(0.4)], [-np.sin(0.4), np.cos(0.4)]]), np.array([0.05, -0.1])
    parts = (weights, velocity, np.array(0.4), com, push, com + turn @ grasp, bound)
    feet = torch.tensor(com + arm @ turn.T)
    moved = [torch.tensor(x[None], requires_grad=True) for x in parts]
    return Case(np.diag(weights), momentum, jacobians, bound, 4), moved, feet


@pytest.mark.parametrize(
    ("name", "sticking"), [("slides", 0), ("one side sticks", 1), ("a foot sticks", 2), ("all stick", 8)]
)
def test_the_gradient_of_a_step_is_right(name, sticking):
    case, arguments, feet = gradient_case(name)
    step = solve_step(*case.tensors, case.directions)
    assert int((step.used.abs() < 0.999).sum()) == sticking

    def advanced(*parts: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        return _Advance.apply(*parts, feet, polygon_sides(4), None)  # pyright: ignore

    velocity, used = advanced(*arguments)
    assert_allclose(velocity.detach(), step.velocity, atol=1e-12)
    assert_allclose(used, step.used, atol=1e-9)
    assert torch.autograd.gradcheck(lambda *parts: advanced(*parts)[0], arguments)


def pushed(kind: str) -> tuple[torch.Tensor, torch.Tensor]:
    """Velocity at the start, and 20 wrenches about the grasped point."""
    time = torch.arange(20, dtype=torch.float64)[:, None] / 20
    if kind == "slides":
        return tensor(0.4, 0.15, 3.0), tensor(6.0, 4.0, 0.1) * torch.cos(3 * time)
    if kind == "stops and stays":
        return tensor(0.12, 0.05, 1.0), tensor(1.0, -0.5, 0.02) * torch.cos(3 * time)
    return STILL, tensor(30.0, 12.0, 0.3) * time  # "breaks loose"


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["slides", "stops and stays", "breaks loose"])
def test_gradients_through_a_rollout_are_finite_differences(kind):
    velocity, wrench = pushed(kind)
    grasp = torch.tensor(OBJECTS[0].shape.particles[4])
    engine = LcpEngine(8, 2)
    rng = np.random.default_rng(0)
    toward = torch.tensor(rng.normal(size=(2, 20, 3)))

    def motion(parameters: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        particle = MODEL.particle_mass(parameters[: len(MASS)])
        friction = MODEL.particle_friction(parameters[len(MASS) :]) * particle * GRAVITY
        return rollout(
            engine, MODEL, inertia_of(MODEL, particle), friction.expand(20, -1), STILL, velocity, wrench, grasp, 0.01
        )

    def loss(parameters: torch.Tensor) -> torch.Tensor:
        poses, velocities = motion(parameters)
        return (toward[0] * poses + toward[1] * velocities).sum()

    parameters = torch.cat([MASS, FRICTION]).requires_grad_()
    speed = motion(parameters)[1].detach().norm(dim=-1)
    assert {"slides": speed.min() > 1e-3, "stops and stays": speed[0] > 1e-2 and speed[-3:].max() < 1e-10,
            "breaks loose": speed[:3].max() < 1e-10 and speed[-1] > 1e-2}[kind]  # fmt: skip
    (gradient,) = torch.autograd.grad(loss(parameters), parameters)
    assert gradient.abs().max() < 1e6
    with torch.no_grad():
        nudges = 1e-6 * torch.eye(len(parameters), dtype=torch.float64)
        found = [(loss(parameters + n) - loss(parameters - n)) / 2e-6 for n in nudges]
    assert_allclose(gradient, torch.stack(found), rtol=1e-4, atol=1e-4 * float(gradient.abs().max()))


@pytest.mark.parametrize("which", range(4))
def test_a_step_of_what_is_not_a_number_is_refused(which):
    arguments = [x.clone() for x in drawn_case("turns", 8, 0).tensors]
    arguments[which].view(-1)[0] = math.nan
    with pytest.raises(LcpError, match="finite numbers and a positive definite mass"):
        solve_step(*arguments, 8)  # pyright: ignore
