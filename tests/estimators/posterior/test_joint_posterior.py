"""Joint posterior: unknowns, derivatives, recovered masses, covariance, and evidence."""

import math
from dataclasses import dataclass, field, replace
from functools import cache

import numpy as np
import pytest
import torch
from numpy.testing import assert_allclose
from scipy.special import log_ndtr
from scipy.stats import chi2
from torch import Tensor

from estimators import HiddenStates, Observations
from estimators.evaluation.judged import misfit_on
from estimators.particles import links
from estimators.particles.lifts import lifts_among
from estimators.posterior import solver, table_errors
from estimators.posterior.estimator import Bayes, posterior_of
from estimators.posterior.in_air import InAir
from estimators.posterior.on_table import ContactPatterns, OnTable
from estimators.posterior.posterior import Part, Posterior, log_chance
from estimators.posterior.priors import RADIUS, priors
from estimators.posterior.scale import Scale, Weighing
from estimators.posterior.solver import Linearized, solve
from estimators.posterior.unknowns import Block, Unknowns
from estimators.testing.analytic_lab import drawn
from estimators.testing.analytic_world import accelerated, analytic_trial, drawn_object, turns
from estimators.testing.conformance import opposed
from estimators.wrench.model import EXACT, ModelErrors, ParticleModel
from estimators.wrench.support import SupportModel
from testbed import Lift, Push, Rotate, Slide, faces, world
from testbed.frames import move_wrench, rotate_wrench, rotation_matrix
from testbed.objects.chain import Chain
from testbed.sensing.camera import PoseStream
from testbed.worlds.setup_errors import EXACT_SETUP
from tests.fakes.analytic_links import analytic_links, drawn_chain
from tests.fakes.analytic_push import analytic_pushes
from tests.fakes.lifted_world import lifted
from tests.helpers.answers import ask, claimed, found, trials_of, true_values, windows_of
from tests.helpers.blocks import blocks
from tests.helpers.lab import lab_trials

OBJECT = drawn_object(2)
BLOCKS = drawn_object(3, ["11", "11", "11"])
CHAIN = drawn_chain(1)
LAB = world("lab").stated
PLASTIC = replace(LAB, friction_law=0.1)
SHARP = replace(EXACT, weight_error=1e-6)


@pytest.mark.parametrize("square", [0.3, 40.0, 1400.0, 1500.0, 1e4, 1e9])
def test_the_chance_of_a_sum_of_squares_is_exact_where_it_underflows(square: float):
    assert_allclose(log_chance(square, 1), math.log(2) + log_ndtr(-math.sqrt(square)), rtol=1e-8)
    assert_allclose(log_chance(square, 2), -square / 2, rtol=1e-8)


def test_parts_far_from_plausible_keep_their_order():
    deviations = torch.tensor([10.0, 40.0, 60.0, 1e4, math.inf])
    chances = [Part.of("gain", deviation * torch.ones(3)).log_chance for deviation in deviations]
    assert chances == sorted(set(chances), reverse=True)


@cache
def slid():
    return [*turns(OBJECT, [0, 1]), *(analytic_trial(OBJECT, Slide(g, way)) for g, way in ((0, 0.3), (1, 2.0)))]


@cache
def pushed():
    return analytic_pushes(BLOCKS, [Push.into(face) for face in faces(BLOCKS.shape)[::2]])


@cache
def in_links():
    grasps = CHAIN.shape.grasps
    ends = {0: math.pi / 2, len(grasps) - 1: -math.pi / 2}
    actions: list[Slide | Rotate] = [Slide(grasp, way, duration=1.5) for grasp, way in ends.items()]
    actions += [Rotate(g, duration=1.5, pivot=tuple((grasps[g].position + 0.015).tolist())) for g in ends]
    return [analytic_links(CHAIN, action) for action in actions]


KINDS = {
    "turns": (OBJECT, lambda: turns(OBJECT)),
    "slides": (OBJECT, slid),
    "accelerated": (OBJECT, lambda: turns(OBJECT, [0, 1]) + accelerated(OBJECT)),
    "lifts": (OBJECT, lambda: [*turns(OBJECT, [0, 1]), lifted(OBJECT, Lift(0, hold=1.4))]),
    "pushes": (BLOCKS, pushed),
    "links": (CHAIN, in_links),
}
EACH = [pytest.param(kind, marks=[pytest.mark.slow] * (kind in ("pushes", "links"))) for kind in KINDS]


def problem(kind, setup=EXACT_SETUP, errors=SHARP, *, loaded=True):
    """Measurements of one kind, and their unknowns; without a gripper's load if not `loaded`."""
    model, trials = KINDS[kind]
    made = [replace(trial, setup=setup) for trial in trials()]
    windows, weight = windows_of(model, made, errors), model.total_mass
    if not loaded:
        windows = replace(windows, load_size=0 * windows.load_size, load_change=0 * windows.load_change)
    on_table = OnTable.of(model.shape, windows, "own_weight", errors)
    measurements = [on_table, Scale(weight, Weighing.of(model.shape, errors.weight_error, setup))]
    measurements += [InAir.of(model.shape, k, lift, weight) for k, lift in lifts_among(model.shape, made).items()]
    return model, measurements, priors(model.shape, setup, errors, weight, on_table.trials)


def joint(model, trials, support: SupportModel = "own_weight"):
    """Posterior of trials, some of them usable."""
    made = posterior_of(model.shape, model.total_mass, trials, support)
    assert made is not None
    return made


def at_truth(model, unknowns, z=None):
    """z of the true masses and frictions; the others as given, or 0."""
    z = torch.zeros(len(unknowns), dtype=torch.float64) if z is None else z.clone()
    for name in ("mass", "friction"):
        block = unknowns.blocks[name]
        z[unknowns.at[name]] = (torch.tensor(getattr(model.truth, name)).log() - block.mean) / block.std
    return z


@pytest.mark.parametrize("kind", EACH)
def test_derivatives_are_those_of_the_rows(kind):
    model, measurements, unknowns = problem(kind, PLASTIC, ModelErrors(), loaded=False)
    rng = np.random.default_rng(0)
    z = at_truth(model, unknowns, 0.3 * torch.tensor(rng.standard_normal(len(unknowns))))
    for measurement in measurements:
        found = measurement.linearized(unknowns, z)
        slopes = found.slopes
        for _ in range(3):
            way = torch.tensor(rng.standard_normal(len(unknowns)))
            ahead, behind = (found.residual_at(z + step * way) for step in (1e-5, -1e-5))
            assert_allclose(slopes @ way, (ahead - behind) / 2e-5, rtol=1e-5, atol=1e-6 * float(slopes.abs().max()))


@pytest.mark.parametrize("kind", [kind for kind in EACH if kind.values != ("lifts",)])
def test_masses_come_back_from_predicted_readings(kind, monkeypatch):
    for module, name in ((links, "FORCE_ERROR"), (links, "HINGE_ERROR"), (links, "RESTING")):
        monkeypatch.setattr(module, name, 1e-6 * getattr(module, name))
    for name in ("PUSH_ERROR", "SLOW", "SWING"):
        monkeypatch.setattr(table_errors, name, 1e-6 * getattr(table_errors, name))
    monkeypatch.setattr(Observations, "twist_noise", torch.zeros(3, dtype=torch.float64))
    monkeypatch.setattr(solver, "TOLERANCE", 1e-12)
    model, (planned, scale), unknowns = problem(kind, loaded=False)
    # priors so wide that they do not count
    unknowns = Unknowns({name: replace(block, std=1e3 * block.std) for name, block in unknowns.blocks.items()})
    truth = at_truth(model, unknowns)
    off = planned.linearized(unknowns, truth).residual.reshape(planned.read.shape)
    windows = planned.windows
    still = windows.links[:, None].expand_as(windows.links_with_errors)
    windows = replace(
        windows,
        bias=0 * windows.bias,
        noise=1e-9 * windows.noise,
        camera_errors=0 * windows.camera_errors,
        links_with_errors=still,
    )
    measured = OnTable(model.shape, windows, planned.table, planned.whole, planned.patterns, SHARP)
    measured.__dict__["read"] = planned.read + off
    found = solve([measured, scale], unknowns, unknowns.start(friction=0.3))
    assert found.converged
    assert_allclose(unknowns.values(found.z)["mass"], model.truth.mass, rtol=1e-8)


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "known"), [("turns", True), ("pushes", True), ("pushes", False)])
def test_a_constant_error_in_the_sensors_axes_changes_no_answer_where_its_size_is_unknown(kind, known):
    """With the tool in the record or without it."""
    model, trials = KINDS[kind]
    error = np.array([0.4, -0.3, 0.2, 0.02, 0.01, -0.02])
    stated = [replace(trial, sensor_bias_std=np.repeat([20.0, 1.0], 3)) for trial in trials()]
    wrenches = [rotate_wrench(rotation_matrix(t.sensor_orientation), move_wrench(error, t.tool.tcp)) for t in stated]
    wrong = [
        replace(t, wrench_on_object_world=t.wrench_on_object_world + more)
        for t, more in zip(stated, wrenches, strict=True)
    ]
    tool = {} if known else {"tool": None}
    both = ([replace(trial, **tool) for trial in each] for each in (stated, wrong))
    right, found = (joint(model, each).of("mass")[0] for each in both)
    assert_allclose(found, right, rtol=0.03)  # a search ends within a third of a standard error


def test_a_trial_with_a_larger_bias_has_it_alone():
    made = turns(OBJECT, [0, 1])
    stated = [replace(trial, sensor_bias_std=np.full(6, std)) for trial, std in zip(made, (0.05, 5.0), strict=True)]
    windows = windows_of(OBJECT, stated, SHARP)
    used = windows.bias[:, 0, 0].sqrt()
    assert used.numpy() == pytest.approx(np.where(windows.trial == 0, 0.05, 5.0), rel=0.01)


@pytest.mark.slow
def test_the_misfit_counts_no_row_that_the_load_of_a_fingertip_absorbs():
    model, (on_table, scale), unknowns = problem("pushes")
    posterior = Posterior(unknowns, [on_table, scale], solve([on_table, scale], unknowns, at_truth(model, unknowns)))
    absorbed = on_table.linearized(unknowns, posterior.optimum.z).absorbed()
    rows = len(posterior.optimum.residual)
    assert posterior.freedom == pytest.approx(rows - absorbed - model.shape.n_m - model.shape.n_mu, abs=0.1)


@pytest.mark.slow
def test_the_misfit_counts_no_row_of_a_hinge_at_rest():
    model = drawn_object(0, ["11111"])
    links, hinges = np.array([0, 0, 1, 1, 2]), np.array([[-0.025, 0.0], [0.075, 0.0]])
    chained = replace(model, shape=replace(model.shape, chain=Chain(links, hinges)))
    trials = [analytic_trial(model, Slide(grasp, 0.7 * grasp, duration=4.0)) for grasp in range(3)]
    poses = [np.tile(trial.object_pose[:, None], (1, 3, 1)) for trial in trials]
    streams = [PoseStream(trial.time_s, pose, 1e-4, 1e-3) for trial, pose in zip(trials, poses, strict=True)]
    filmed = [replace(trial, camera=stream) for trial, stream in zip(trials, streams, strict=True)]
    windows = windows_of(chained, filmed, SHARP)
    assert windows.standing.all()
    rows = 6 * len(windows) + 1
    assert joint(chained, filmed).freedom == rows - model.shape.n_m - model.shape.n_mu


@pytest.mark.slow
def test_an_answer_has_the_errors_of_the_setup_with_their_standard_errors():
    trials = [replace(trial, setup=LAB) for trial in KINDS["accelerated"][1]()]
    numbers = ask(OBJECT, trials, Bayes()).diagnostics
    for name in ("table_tilt_1", "gain_5", "grasp_offset_0_1", "tcp_angle", "friction_0"):
        assert numbers[f"{name}_std"] > 0
    assert abs(numbers["table_tilt_1"]) < 3 * LAB.table_tilt and numbers["table_tilt_1_std"] <= LAB.table_tilt


@pytest.mark.parametrize(
    "error", [{"place_friction": 0.03}, {"contact_points": 6}], ids=lambda error: next(iter(error))
)
def test_an_error_that_a_lift_alone_states_is_an_unknown_on_the_table(error: dict[str, float]):
    *on_table, lift = KINDS["lifts"][1]()
    uneven = replace(lift, setup=replace(EXACT_SETUP, **error))
    found = joint(OBJECT, [*on_table, uneven])
    assert found.optimum.converged
    assert float(found.optimum.z[found.unknowns.at[next(iter(error))]].abs().max()) > 0


def patterns_of_contact() -> list[tuple[Tensor, Tensor, Tensor]]:
    """Points of each group, m, its patterns over them, and the radial one as parts of these."""
    model = ParticleModel.of(OBJECT.shape)
    points = model.points(spread=True)
    found = ContactPatterns.of(model, points)
    parts = found.of_group.reshape(*points.shape[:2], OBJECT.shape.n_m, -1)
    each = zip((model.mass_group == g for g in range(OBJECT.shape.n_m)), found.count, found.radial, strict=True)
    return [
        (points[inside].flatten(0, 1), parts[inside, :, group].flatten(0, 1)[:, : count - 1], radial[: count - 1])
        for group, (inside, count, radial) in enumerate(each)
    ]


def test_patterns_of_contact_keep_load_and_moments_but_for_two_and_the_radial_one_spreads():
    for at, ways, radial in patterns_of_contact():
        assert_allclose(ways.T @ ways, np.eye(ways.shape[1]), atol=1e-12)
        assert_allclose(ways.sum(0), 0.0, atol=1e-12)
        assert_allclose(ways[:, 2:].T @ at, 0.0, atol=1e-12)
        part, taken = ways @ radial, ways.abs().sum(1) > 0
        square = (at - at[taken].mean(0)).square().sum(1)
        assert_allclose(torch.stack([part.sum(), *(part @ at)]), 0.0, atol=1e-12)
        # the mean square distance grows by its standard deviation
        assert_allclose(part @ square, square[taken].std(correction=0), rtol=1e-6)


@pytest.mark.slow
def test_a_radius_of_contact_that_blocks_share_is_recovered():
    obj = drawn(3, 4242, "corners")
    found, model = joint(obj, lab_trials(obj, 8)), ParticleModel.of(obj.shape)
    points = model.points(spread=True)[model.mass_group == 0].flatten(0, 1)
    square = (points - points.mean(0)).square().sum(1)
    corners = 2 * (0.9 * 3 / 2 * obj.shape.cell) ** 2
    radius = (corners - square.mean()) / square.std()
    value = found.unknowns.values(found.optimum.z)["contact_radius"]
    where = found.unknowns.at["contact_radius"]
    std = RADIUS * float(found.laplace[where, where].sqrt())
    assert std < RADIUS / 2 and abs(value - radius) < 2 * std


@pytest.mark.slow
@pytest.mark.parametrize("index", [29, 66])
def test_groups_that_stand_off_their_middles_are_known_less_well(index):
    level, obj = (drawn(index, 4242, pattern) for pattern in ("corners", "pressed"))
    posterior = joint(level, lab_trials(level, 8))
    assert posterior.leaning() is posterior
    posterior = joint(obj, lab_trials(obj, 8, pattern="pressed"))
    answers = [each.estimate(obj.shape) for each in (posterior, posterior.leaning())]
    off = [found(answer).group_mass(obj.shape) - obj.group_mass for answer in answers]
    error = [claimed(answer) * obj.shape.particles_per_group for answer in answers]
    assert (error[1] > error[0]).mean() > 0.5
    assert np.square(off[1] / error[1]).mean() < 0.8 * np.square(off[0] / error[0]).mean()


@pytest.mark.slow
@pytest.mark.parametrize("setup", [EXACT_SETUP, LAB, PLASTIC], ids=["exact", "lab", "plastic"])
def test_a_posterior_of_its_own_predictions_is_calibrated(setup):
    """Truth from the prior, readings from the forward model: errors are chi-squared by the covariance."""
    model, (on_table, scale), unknowns = problem("accelerated", setup, ModelErrors())
    rng, own = np.random.default_rng(3), at_truth(model, unknowns)
    sums = []
    for _ in range(12):
        truth = torch.tensor(rng.standard_normal(len(unknowns)))
        truth[unknowns.at["mass"]] = own[unknowns.at["mass"]] + 0.2 * truth[unknowns.at["mass"]]
        truth[unknowns.at["friction"]] = own[unknowns.at["friction"]]
        found = on_table.linearized(unknowns, truth)
        read = on_table.read.flatten() + found.residual
        for rows, covariance in found.blocks:
            root = np.linalg.cholesky(covariance.numpy())
            read[rows] += torch.tensor(root @ rng.standard_normal((*rows.shape, 1)))[..., 0]
        measured = replace(on_table)
        measured.__dict__["read"] = read.reshape(on_table.read.shape)
        mass = unknowns.values(truth)["mass"]
        weighed = replace(
            scale,
            reading=float(torch.tensor(scale.weighing.count) @ mass) + scale.weighing.error * rng.standard_normal(),
        )
        both = [measured, weighed]
        posterior = Posterior(unknowns, both, solve(both, unknowns, unknowns.start(friction=0.3)))
        off, where = posterior.of("mass")[0] - mass, unknowns.at["mass"]
        sums.append(float(off @ torch.linalg.solve(posterior.covariance[where, where], off)))
    total, freedom = sum(sums), 12 * model.shape.n_m
    assert chi2.ppf(1e-3, freedom) / 2 < total < chi2.ppf(1 - 1e-3, freedom) * 1.5


@pytest.mark.slow
def test_draws_are_masses_of_the_posterior_even_where_it_is_wide():
    """Their scatter is the covariance where masses are known; elsewhere they add up to M, and none is below 0."""
    known, wide = drawn_object(2), drawn_object(0, friction_groups=2)
    narrow = joint(known, [*turns(known, noise=0.3), *accelerated(known)])
    mass, friction = narrow.draws(known.shape, 4000, 0)
    answer = narrow.estimate(known.shape)
    assert_allclose(mass.std(0), claimed(answer) * known.shape.particles_per_group, rtol=0.08)
    assert_allclose(friction.std(0), answer.diagnostics["friction_0_std"], rtol=0.08)
    broad = joint(wide, turns(wide, noise=0.3))
    mass, friction = broad.draws(wide.shape, 500, 0)
    assert (mass > 0).all() and (friction > 0).all()
    assert (mass.std(0) > 0.02).all()
    assert_allclose(mass.sum(1), wide.total_mass, atol=0.006)
    assert np.array_equal(broad.draws(wide.shape, 500, 0)[0], mass), "equal seeds give equal draws"


@pytest.mark.slow
@pytest.mark.parametrize("support", ["own_weight", "rigid"])
def test_draws_keep_what_the_trials_show(support):
    """The center of mass of one rigid body, and the drag of the groups of each friction."""
    model = drawn_object(0, friction_groups=1 if support == "rigid" else 2)
    shape, rigid = model.shape, support == "rigid"
    found = joint(model, turns(model, noise=0.05, rigid=rigid) + accelerated(model, noise=0.05, rigid=rigid), support)
    mass, friction = found.draws(shape, 2000, 0)
    answer, own = found.estimate(shape).distribution, shape.n_m + shape.n_mu
    assert answer is not None
    unit = np.concatenate([shape.particles_per_group, np.ones(shape.n_mu)])
    at = np.concatenate([answer.mass, answer.friction]) * unit
    inside = found.covariance[:own, :own].numpy() * np.outer(unit, unit) * found.explained.widening
    group = at[: shape.n_m]
    places = np.array([shape.middle_of(g) for g in range(shape.n_m)])
    slopes = np.zeros((2, own))
    slopes[:, : shape.n_m] = ((places - group @ places / group.sum()) / group.sum()).T
    stated = np.sqrt(np.diag(slopes @ inside @ slopes.T))
    assert_allclose((mass @ places / mass.sum(1, keepdims=True)).std(0), stated, rtol=0.1)
    of_group = np.array([shape.friction_group[shape.mass_group == g].max() for g in range(shape.n_m)])
    for k in range(shape.n_mu):
        ours = of_group == k
        slope = np.concatenate([at[shape.n_m + k] * ours, np.eye(shape.n_mu)[k] * group[ours].sum()])
        drag, std = friction[:, k] * mass[:, ours].sum(1), np.sqrt(slope @ inside @ slope)
        assert abs(drag.mean() - at[shape.n_m + k] * group[ours].sum()) < 0.2 * std
        assert drag.std() == pytest.approx(std, rel=0.1)


@pytest.mark.slow
def test_draws_keep_masses_that_are_better_known_than_their_friction():
    """A slick part of an object in the air."""
    model = drawn_object(0, friction_groups=2)
    model = replace(model, truth=replace(model.truth, friction=np.array([0.5, 0.03])))
    found = joint(model, [*turns(model, [0], noise=0.3), *(lifted(model, Lift(g, hold=1.4)) for g in (0, 1))])
    mass, friction = found.draws(model.shape, 4000, 0)
    answer = found.estimate(model.shape)
    own = claimed(answer) * model.shape.particles_per_group
    assert (
        answer.distribution is not None and answer.diagnostics["friction_1_std"] > 0.3 * answer.distribution.friction[1]
    )
    assert_allclose(mass.std(0), own, rtol=0.1)
    assert (np.abs(mass.mean(0) - answer.distribution.mass * model.shape.particles_per_group) < 0.15 * own).all()
    assert friction[:, 0].std() == pytest.approx(answer.diagnostics["friction_0_std"], rel=0.15)


def padded(error=0.0):
    """An object on four feet a block, and the offsets of its feet, of a standard deviation `error`, m."""
    plain, pads = drawn_object(2), np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * 0.018
    off = error * np.random.default_rng(5).standard_normal((plain.shape.n_m, 4, 2))
    feet = [plain.shape.middle_of(group) + pads + off[group] for group in range(plain.shape.n_m)]
    return plain.on_feet(feet), off


def test_masses_on_known_feet_are_recovered():
    model = padded()[0]
    answer = ask(model, trials_of(model), Bayes())
    assert answer.status == "ok"
    assert_allclose(found(answer).mass * model.shape.particles_per_group, model.group_mass, rtol=0.01)


def test_an_offset_of_a_foot_changes_the_wrench_as_its_derivative():
    (model, _), (moved, off) = padded(), padded(error=2e-4)
    windows = windows_of(model, turns(model))
    measured = OnTable.of(model.shape, windows, "own_weight", SHARP)
    theta = true_values(model) | {"carried": torch.zeros(3, dtype=torch.float64)}
    offset = {"foot_offset": torch.tensor(off.reshape(-1, 2))}
    predicted = [
        torch.vmap(lambda window, more=more: measured.wrench(theta | more, window))(measured.table.windows)
        for more in ({}, offset)
    ]
    change = windows_of(moved, turns(moved)).wrench - windows.wrench
    assert change.abs().max() > 1e-4
    assert_allclose(predicted[1] - predicted[0], change, atol=0.03 * float(change.abs().max()))


@pytest.mark.slow
@pytest.mark.parametrize("method", [Bayes(), HiddenStates()], ids=["bayes", "hidden_states"])
def test_known_feet_leave_smaller_errors_than_unknown_points(method):
    errors = replace(EXACT_SETUP, contact_points=4, foot_offset=0.0005, foot_load=0.2)
    unknown, known = (
        claimed(ask(model, [replace(trial, setup=errors) for trial in trials_of(model)], method))
        * model.shape.particles_per_group
        for model in (drawn_object(2), padded()[0])
    )
    assert (known < unknown).all() and known.sum() < 0.8 * unknown.sum()


@pytest.mark.slow
def test_feet_of_unlike_loads_are_a_pattern_of_their_group():
    plain, pads = drawn_object(2), padded()[0].shape
    rows = 0.006 * np.array([(i - 1, k - 1.5) for i in range(3) for k in range(4)])
    feet = [plain.shape.middle_of(0) + rows, *pads.particles[pads.feet].reshape(-1, 4, 2)[1:]]
    model = plain.on_feet(feet)
    unknowns = priors(model.shape, replace(EXACT_SETUP, contact_points=4, foot_load=0.2), SHARP, model.total_mass, 1)
    assert "contact_points" not in unknowns.blocks and unknowns.blocks["foot_load"].std.shape == (model.shape.n_m, 11)
    measured = OnTable.of(model.shape, windows_of(model, turns(model)), "own_weight", SHARP)
    window, theta = {name: value[0] for name, value in measured.table.windows.items()}, true_values(model)
    std = unknowns.blocks["foot_load"].std
    z = torch.randn(4000, *std.shape, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    loads = torch.stack([measured.loads(theta | {"foot_load": std * each}, window)[model.shape.feet, 0] for each in z])
    even, first = measured.loads(theta, window)[model.shape.feet, 0], 0
    for places in feet:
        own, first = slice(first, first + len(places)), first + len(places)
        assert_allclose(loads[:, own].sum(1), even[own].sum().expand(4000), rtol=1e-9)
        # balance takes three of a group's loads: a quarter of the variance is left of four
        balance = np.linalg.qr(np.column_stack([np.ones(len(places)), places]))[0]
        left = np.sqrt(1 - np.square(balance).sum(1))
        assert_allclose((loads / even)[:, own].std(0), 0.2 * left, rtol=0.06)


STD = torch.tensor([0.8, 0.3, 0.0], dtype=torch.float64)
MASS = Block(torch.tensor([0.1, 0.02, 1.0], dtype=torch.float64).log(), STD, positive=True)
OFFSET = Block(torch.tensor([0.002], dtype=torch.float64), torch.tensor([0.001], dtype=torch.float64))
Z = torch.tensor([0.4, -1.2, 0.0, 0.7], dtype=torch.float64)


def test_steps_are_straight_in_the_parameters():
    unknowns = Unknowns({"mass": MASS, "offset": OFFSET})
    step = torch.tensor([-0.5, 1.5, 3.0, 2.0], dtype=torch.float64)
    scale = torch.cat([MASS.scale(Z[:3]), OFFSET.scale(Z[3:])])
    before, after = unknowns.values(Z), unknowns.values(unknowns.stepped(Z, step))
    assert_allclose(after["mass"] - before["mass"], (scale * step)[:3], rtol=1e-12)
    assert_allclose(after["offset"] - before["offset"], (scale * step)[3:], rtol=1e-12)


def test_positive_parameters_stay_positive_and_fall_as_their_logarithm_far_down():
    step = -torch.logspace(-2, 2.5, 400, dtype=torch.float64)
    long = Block(torch.zeros(400, dtype=torch.float64), torch.full((400,), 0.5, dtype=torch.float64), positive=True)
    moved = long.stepped(torch.zeros(400, dtype=torch.float64), step)
    assert (moved.diff() < 0).all() and torch.isfinite(moved).all()
    assert_allclose(0.5 * moved[-1], 0.5 * step[-1] - 0.5 - math.log(2), rtol=1e-12)


ROWS = 60
RNG = np.random.default_rng(3)
DESIGN = torch.tensor(RNG.standard_normal((ROWS, 2)))
NOISE = torch.tensor(RNG.standard_normal(ROWS))


@dataclass(frozen=True, eq=False)
class Rows:
    """y = DESIGN[:, :n] value + noise of a stated variance."""

    y: Tensor
    variance: float
    parts: list = field(default_factory=list)

    def linearized(self, unknowns: Unknowns, z: Tensor) -> Linearized:
        slopes = DESIGN[:, : len(unknowns)]
        blocks = [(torch.arange(ROWS)[None], self.variance * torch.eye(ROWS, dtype=torch.float64)[None])]
        return Linearized(slopes @ z - self.y, slopes, blocks, lambda at: slopes @ at - self.y, lambda _: slopes)


def posterior(unknown: int, variance: float) -> Posterior:
    """Posterior of that many unknowns of standard normals; the truth is (1, -1), its noise of unit variance."""
    rows = Rows(DESIGN @ torch.tensor([1.0, -1.0], dtype=torch.float64) + NOISE, variance)
    unknowns = Unknowns({"value": Block.normal(torch.ones(unknown, dtype=torch.float64))})
    return Posterior(unknowns, [rows], solve([rows], unknowns, unknowns.start()))


def test_a_search_that_finds_no_descent_has_not_converged():
    @dataclass(frozen=True, eq=False)
    class Wrong(Rows):
        """Derivatives of the wrong sign."""

        def linearized(self, unknowns: Unknowns, z: Tensor) -> Linearized:
            found = super().linearized(unknowns, z)
            return replace(found, slopes=-found.slopes)

    unknowns = Unknowns({"value": Block.normal(1e9 * torch.ones(1, dtype=torch.float64))})
    ended = solve([Wrong(1e6 * DESIGN[:, 0], 1.0)], unknowns, unknowns.start())
    assert not ended.converged and ended.rounds == 1


@dataclass(frozen=True, eq=False)
class Gains:
    """y = f (1 + g) + noise, a gain g a reading."""

    y: Tensor
    size: float
    """Standard deviation of a gain, as a part."""
    error: float
    parts: list = field(default_factory=list)

    def linearized(self, unknowns: Unknowns, z: Tensor) -> Linearized:
        eye = torch.eye(len(self.y), dtype=torch.float64)

        def predicted(z: Tensor) -> Tensor:
            return unknowns.values(z)["friction"] * (1 + self.size * z[unknowns.at["gain"]])

        blocks = [(torch.arange(len(self.y))[None], self.error**2 * eye[None])]
        slopes = torch.func.jacfwd(predicted)
        return Linearized(predicted(z) - self.y, slopes(z), blocks, lambda z: predicted(z) - self.y, slopes)


@pytest.mark.parametrize("error", [0.005, 0.02])
def test_the_mode_is_that_of_the_marginal_density(error):
    """With the gains integrated over, readings are normal about f of variance f^2 s^2 + error^2."""
    size, y = 0.2, 0.4 * (1 + 0.2 * NOISE[:12]) + error * NOISE[12:24]
    one = torch.ones(1, dtype=torch.float64)
    gains = Block.normal(torch.ones(12, dtype=torch.float64))
    unknowns = Unknowns({"mass": Block.known(one), "friction": Block.log_normal(0.4, 1.0, 1), "gain": gains})
    rows = Gains(y, size, error)
    found = Posterior(unknowns, [rows], solve([rows], unknowns, unknowns.start(friction=0.4)))
    z = torch.linspace(-1, 1, 20001, dtype=torch.float64)[:, None]
    friction = 0.4 * z.exp()
    variance = (friction * size) ** 2 + error**2
    exact = float(z[(((y - friction) ** 2 / variance + variance.log()).sum(1) + z[:, 0] ** 2).argmin()])
    joint, marginal = (float(at[unknowns.at["friction"]]) for at in (found.optimum.z, found.mode))
    assert abs(marginal - exact) < 0.25 * abs(joint - exact)


@pytest.mark.slow
def test_an_answer_of_two_frictions_has_its_own_misfit():
    """Masses and frictions trade off; their products are well known."""
    model = blocks(["11", "10"], [1.0, 3.0, 2.0], [0.3, 0.6], [0, 1, 0])
    made = turns(model, noise=0.1) + accelerated(model, noise=0.1)
    answer = ask(model, made, Bayes())
    misfit = misfit_on("own_weight", model.shape, model.total_mass, made, found(answer))
    assert misfit is not None
    assert misfit.value == pytest.approx(answer.diagnostics["misfit"], rel=0.02)
    drag = found(answer).mass * found(answer).friction[[0, 1, 0]]
    assert_allclose(drag, model.truth.mass * model.truth.friction[[0, 1, 0]], rtol=0.005)


@pytest.mark.slow
def test_patterns_of_many_points_do_not_depend_on_their_order():
    """A bar of 8 x 64 cells: its rows are as long as a step over its points."""
    x, y = np.meshgrid(np.arange(8.0), np.arange(64.0), indexing="ij")
    places = 1e-3 * np.stack([x, y], -1)
    spread = []
    for order in (places.reshape(-1, 2), places.swapaxes(0, 1).reshape(-1, 2)):
        at, alike = torch.tensor(order), torch.zeros(len(order), dtype=torch.int64)
        model = replace(
            ParticleModel.of(OBJECT.shape),
            particles=at,
            mass_group=alike,
            friction_group=alike,
            fill=torch.ones(len(at)),
        )
        patterns = ContactPatterns.of(model, at[:, None])
        spread.append((patterns.of_group.T @ (at - at.mean(0))).norm(dim=0))
    assert_allclose(spread[0], spread[1], rtol=0.25)  # 64 points each, of 512


@pytest.mark.parametrize("unknown", [1, 2])
def test_the_evidence_of_a_linear_model_is_exact(unknown):
    found, slopes = posterior(unknown, 1.0), DESIGN[:, :unknown]
    y = found.measurements[0].y  # pyright: ignore[reportAttributeAccessIssue]
    covariance = slopes @ slopes.T + torch.eye(ROWS, dtype=torch.float64)
    exact = -(y @ torch.linalg.solve(covariance, y) + torch.linalg.slogdet(covariance)[1]) / 2
    assert found.log_evidence == pytest.approx(float(exact), abs=1e-9)


def test_a_common_factor_of_stated_errors_changes_no_choice():
    factors = {v: [posterior(n, v) for n in (1, 2)] for v in (0.1, 1.0, 10.0)}
    gain = {v: two.log_evidence_to_scale - one.log_evidence_to_scale for v, (one, two) in factors.items()}
    plain = {v: two.log_evidence - one.log_evidence for v, (one, two) in factors.items()}
    assert gain[0.1] == pytest.approx(gain[1.0], abs=1) and gain[10.0] == pytest.approx(gain[1.0], abs=1)
    assert plain[0.1] > 5 * plain[1.0] and plain[10.0] < plain[1.0] / 5
    assert gain[1.0] > 5


@pytest.mark.parametrize("support", ["own_weight", "rigid"])
def test_trials_that_contradict_each_other_leave_friction(support):
    obj = drawn_object(0, ["010", "111"])
    found = joint(obj, [*trials_of(obj), *opposed(obj)], support)
    assert float(found.of("friction")[0]) > 0.01 and not found.explained.explains
