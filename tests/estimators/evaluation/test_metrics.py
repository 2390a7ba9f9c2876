"""NAD as the paper defines it, and MPD against first-order theory and another integrator."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
import torch

from estimators.evaluation import metrics as steady_turn
from estimators.evaluation.metrics import (
    OPEN_LOOP,
    ParticleDistance,
    SteadyTurn,
    mean_particle_distance,
    normalized_absolute_difference,
    open_loop,
)
from estimators.particles.wrench import AffineLoads
from estimators.testing.analytic_world import drawn_object, turns
from estimators.wrench.model import ParticleModel, inertia_of, rotate
from estimators.wrench.support import SupportModel
from testbed.errors import InvalidValueError
from testbed.objects.files import load_object
from testbed.objects.model import MassDistribution, ObjectModel, ObjectShape
from testbed.sensing.windows import steady_samples
from testbed.trajectory import Trajectory
from tests.helpers.answers import windows_of
from tests.helpers.lcp_oracle import explicit_rollout

OBJECT = drawn_object(0)
FRICTION = np.array([0.5])


def masses(values: np.ndarray) -> MassDistribution:
    return MassDistribution(values, FRICTION)


def nad(estimate: MassDistribution, truth: MassDistribution) -> float:
    return normalized_absolute_difference(OBJECT.shape, estimate, truth)


@pytest.mark.parametrize("seed", range(2))
def test_nad_is_the_sum_over_particles_in_any_unit_of_mass(seed):
    found = np.random.default_rng(seed).uniform(0, 0.1, OBJECT.shape.n_m)
    particles = np.abs(found[OBJECT.shape.mass_group] - OBJECT.particle_mass).sum() / OBJECT.total_mass
    assert nad(masses(found), OBJECT.truth) == pytest.approx(particles)
    assert nad(masses(1e3 * found), masses(1e3 * OBJECT.truth.mass)) == pytest.approx(particles)


@pytest.mark.parametrize("part", [0.0, 0.1, 0.6, 1.0])
def test_nad_is_twice_the_misplaced_part_where_the_total_is_right(part):
    true = np.eye(OBJECT.shape.n_m)[0]
    found = (1 - part) * true + part * np.eye(OBJECT.shape.n_m)[-1]
    assert nad(masses(found), masses(true)) == pytest.approx(2 * part)
    assert nad(masses(4 * true), masses(true)) == pytest.approx(3)


def test_nad_is_zero_for_the_true_masses_alone_at_any_friction():
    slippery = MassDistribution(OBJECT.truth.mass, OBJECT.truth.friction / 2)
    nearly = masses(OBJECT.truth.mass + 1e-9 * np.eye(OBJECT.shape.n_m)[0])
    assert nad(slippery, OBJECT.truth) == 0 < nad(nearly, OBJECT.truth)


def test_a_group_counts_for_each_of_its_particles():
    shape = ObjectShape(np.array([[0.0, 0], [1, 0], [2, 0], [3, 0]]), np.array([0, 1, 1, 1]), np.zeros(4, int), 1, 1)
    # one particle of 4 against three of 1: 1 too few in each of the three, 1 too many in the one
    found, truth = masses(np.array([5.0, 0.0])), masses(np.array([4.0, 1.0]))
    assert normalized_absolute_difference(shape, found, truth) == pytest.approx(4 / 7)


def test_masses_that_do_not_fit_the_shape_are_refused():
    short = masses(np.ones(OBJECT.shape.n_m - 1))
    for estimate, truth, field in ((short, OBJECT.truth, "estimate.mass"), (OBJECT.truth, short, "truth.mass")):
        with pytest.raises(InvalidValueError) as raised:
            nad(estimate, truth)
        assert raised.value.field == field


FLOOR = 3e-5
"""Distance that steps of 10 ms cost the truth itself [m]."""
PRESSED = {"lift": 0.4, "moment": (0.004, -0.003)}


def distance(
    obj: ObjectModel,
    trajectories: list[Trajectory],
    slower: float = 0.0,
    support: SupportModel = "own_weight",
    mass: np.ndarray | None = None,
) -> ParticleDistance:
    """MPD of the truth or other masses, their friction too large by the part `slower`."""
    estimate = MassDistribution(obj.truth.mass if mass is None else mass, obj.truth.friction * (1 + slower))
    found = mean_particle_distance(obj.shape, estimate, trajectories, support)
    assert found is not None
    return found


@pytest.mark.parametrize("name", ["I2", "L2", "F2"])
@pytest.mark.parametrize("world", [{}, PRESSED], ids=["free", "pressed"])
def test_the_truth_goes_where_the_object_went(name, world):
    obj = load_object(name)
    found = distance(obj, turns(obj, **world))
    assert max(found.open_loop, found.turn) < FLOOR


@pytest.mark.parametrize(
    ("name", "support", "world", "right"),
    [
        ("I1", "own_weight", {}, True),
        ("I2", "own_weight", {}, False),
        ("I2", "rigid", {}, True),
        ("F2", "rigid", PRESSED, True),
    ],
)
def test_one_rigid_body_goes_where_the_rigid_support_says_and_where_own_weight_says_if_it_is_uniform(
    name, support, world, right
):
    obj = load_object(name)
    found = distance(obj, turns(obj, [0, 3], rigid=True, **world), support=support)
    assert (found.turn < FLOOR) == (found.open_loop < FLOOR) == right
    assert right or min(found.turn, found.open_loop) > 1e-3


@pytest.mark.parametrize(("name", "part"), [("I2", -0.2), ("F2", -0.03), ("I2", 0.01), ("F2", 0.1)])
def test_over_a_whole_turn_it_grows_with_the_error_of_friction_as_theory_says(name, part):
    # too much friction by `part` slows every step by part * drag / (M, I_cm): over n steps of dt the body falls behind
    # by n dt^2 times that, its linear part turning with the body
    obj = load_object(name)
    trajectories = turns(obj)
    windows, model = windows_of(obj, trajectories), ParticleModel.of(obj.shape)
    inertia = inertia_of(model, torch.tensor(obj.particle_mass))
    arm = model.particles - inertia.com
    behind, k = [], 0
    for trajectory in trajectories:
        for kept in steady_samples(trajectory):
            f, to_com = windows.wrench[k], inertia.com - windows.grasp[k]
            force = f[:2] - windows.table(model).motion(torch.tensor(obj.particle_mass))[k, :2]
            torque = f[2] - to_com[0] * f[1] + to_com[1] * f[0]
            yaw = torch.tensor(trajectory.object_pose[kept, 2])
            dt = float(np.median(np.diff(trajectory.time_s)))
            shift = part * dt**2 * rotate(yaw[:-2], (force / inertia.mass).expand(len(yaw) - 2, 2)).sum(0)
            angle = yaw[-1] - part * dt**2 * (len(yaw) - 2) * torque / inertia.about_com
            apart = rotate(yaw[-1], arm) - rotate(angle, arm) + shift
            behind.append(float(apart.norm(dim=-1).mean()))
            k += 1
    assert distance(obj, trajectories, part).turn == pytest.approx(np.mean(behind), rel=0.01, abs=FLOOR)


@pytest.mark.parametrize("part", [-0.001, 0.001])
def test_open_loop_a_small_error_of_friction_grows_in_proportion(part):
    obj = load_object("L2")
    once, twice = (distance(obj, turns(obj, [0, 3]), x).open_loop for x in (part, 2 * part))
    assert twice == pytest.approx(2 * once, rel=0.05)
    assert once > 1e-3


@pytest.mark.parametrize("name", ["I2", "L2"])
def test_open_loop_a_body_with_more_friction_than_the_drive_stops(name):
    obj = load_object(name)
    trajectories = turns(obj, [0, 3])
    travelled = []
    for trajectory in trajectories:
        for kept in steady_samples(trajectory):
            steps = min(round(OPEN_LOOP * 100), len(kept) - 1)
            pose = trajectory.object_pose[kept[[0, steps, -1]]]
            places = [p[:2] + rotate(torch.tensor(p[2]), torch.tensor(obj.shape.particles)).numpy() for p in pose]
            travelled.append([float(np.linalg.norm(place - places[0], axis=1).mean()) for place in places[1:]])
    way, whole = np.mean(travelled, axis=0)
    # at once where friction is doubled; after a part of the way that falls with the error where it is little
    stuck = distance(obj, trajectories, 1.0)
    assert (stuck.open_loop, stuck.end) == pytest.approx((way, whole), rel=0.03)
    gone = [way - distance(obj, trajectories, part).open_loop for part in (0.03, 0.06, 0.12, 0.3)]
    assert all(near > far > 0 for near, far in pairwise(gone))
    assert gone[0] < 0.25 * way


@pytest.mark.parametrize("part", [-0.02, 0.0, 0.03, 1.0])
def test_open_loop_does_not_depend_on_the_creep(part, monkeypatch):
    obj = load_object("I2")
    trajectories = turns(obj, [0, 3])
    found = []
    for creep in (1e-4, 1e-5, 1e-6):
        monkeypatch.setattr(steady_turn, "CREEP", creep)
        found.append(distance(obj, trajectories, part).open_loop)
    # a body at rest creeps on, and one that comes to rest does so a little later: 2 % of its way at the coarsest
    assert found[2] == pytest.approx(found[1], abs=5e-5)
    assert found[0] == pytest.approx(found[1], abs=4e-4)


@pytest.mark.parametrize("name", ["L2", *(pytest.param(name, marks=pytest.mark.slow) for name in ("I2", "F2"))])
def test_open_loop_agrees_with_a_rollout_of_fine_steps_where_nothing_sticks(name):
    obj, fine = load_object(name), 25
    # a little too light on its feet: nothing comes to rest
    friction = 0.998 * torch.tensor(obj.truth.friction)
    trajectories = turns(obj, [1])
    windows = windows_of(obj, trajectories)
    model, mass = ParticleModel.of(obj.shape), torch.tensor(obj.truth.mass)
    inertia = inertia_of(model, model.particle_mass(mass))
    pressed = model.particle_friction(friction) * AffineLoads.of(obj.shape, model, windows).at(mass)
    turn = SteadyTurn.of(windows.where(torch.tensor([0])), trajectories[0], steady_samples(trajectories[0])[0], inertia)
    steps = 100
    # the wrench turns with the object between samples too
    part = torch.arange(fine)[:, None] / fine
    push = (turn.wrench[:steps, None] * (1 - part) + turn.wrench[1 : steps + 1, None] * part).flatten(0, 1)
    start, drag = (turn.pose[0], turn.velocity[0]), pressed[:1].expand(len(push), -1)
    poses, _ = explicit_rollout(model, inertia, drag, *start, push, turn.grasp, turn.dt / fine)
    arm = model.particles - inertia.com
    ends = [pose[:2] + rotate(pose[2], arm) for pose in (poses[-1], turn.pose[steps])]
    apart = float((ends[0] - ends[1]).norm(dim=-1).mean())
    assert apart > 1e-3
    both, ends = open_loop([turn, turn], model, inertia, torch.stack([pressed[0], 1.1 * pressed[0]]))
    assert both[0] == pytest.approx(apart, abs=1e-4)
    alone = [open_loop([turn], model, inertia, scale * pressed[:1]) for scale in (1, 1.1)]
    assert both == pytest.approx([near[0] for near, _ in alone], rel=1e-8)  # rounding grows on the way
    assert ends == pytest.approx([end[0] for _, end in alone], rel=1e-6)


def test_mpd_is_the_mean_over_turns_that_ended_well():
    obj = load_object("L2")
    good = turns(obj, [0, 2])
    wrong = replace(good[1], status="slipped", reason="it slipped", wrench_on_object_world=0 * good[1].tcp_velocity)
    together, each = distance(obj, good, 0.02), [distance(obj, [turn], 0.02) for turn in good]
    assert distance(obj, [*good, wrong], 0.02) == together
    for name in ("turn", "open_loop", "end"):
        assert getattr(together, name) == pytest.approx(np.mean([getattr(x, name) for x in each]))
    for nothing in ([wrong], []):
        assert mean_particle_distance(obj.shape, obj.truth, nothing) is None


def test_wrong_masses_are_seen_too():
    obj = load_object("F2")
    found = distance(obj, turns(obj), mass=obj.truth.mass[::-1])
    assert min(found.turn, found.open_loop) > 1e-3
