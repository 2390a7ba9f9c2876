"""Forward model of an object on the table and of the scale against true errors of a setup, and estimates under them."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from numpy.testing import assert_allclose

from estimators import HiddenStates, LeastSquares, build_method
from estimators.hidden_states.algorithm import Solution, algorithm_1
from estimators.hidden_states.friction import closed_form
from estimators.hidden_states.trial_windows import TrialWindows
from estimators.identifiability.information import Assumptions, expected, observed
from estimators.particles.windows import PLANAR, Observations
from estimators.posterior.on_table import OnTable
from estimators.posterior.priors import priors
from estimators.testing.analytic_world import accelerated, analytic_trial, drawn_object, turns
from estimators.wrench.jacobian import zeros
from estimators.wrench.model import EXACT, ModelErrors, ParticleModel
from estimators.wrench.table import Table
from testbed import GRAVITY, Accelerate, MassDistribution, ObjectModel, Push, Rotate, Slide, Trajectory, faces, preset
from testbed.sensing.compensation import SIDEWAYS
from testbed.worlds.setup_errors import EXACT_SETUP, SetupErrors
from tests.fakes.analytic_links import analytic_links, drawn_chain
from tests.fakes.analytic_push import analytic_pushes, steady_pushes
from tests.fakes.flawed_bench import held_beside, on_anisotropic_table, on_plastic, turns_beside
from tests.helpers.answers import ask, claimed, trials_of, true_values, windows_of

OBJECT, CHAIN = drawn_object(0), drawn_chain(1)
BESIDE, BETWEEN = (0.01, 0.015), np.array([0.004, 0.003])
# grasped between particles: the drag of one at the center of a turn has no derivative
GRASPS = tuple(replace(grasp, position=grasp.position + BETWEEN) for grasp in OBJECT.shape.grasps)
APART = replace(OBJECT, shape=replace(OBJECT.shape, grasps=GRASPS))
CENTERS = np.random.default_rng(1).uniform(-0.2, 0.2, (4, 2))
PUSHES = [replace(Push.into(face), speed=0.08) for face in faces(OBJECT.shape)]
DRAG = Slide(0, np.pi / 2, duration=2.5)
SHARP = replace(EXACT, weight_error=1e-9)
KINDS = {
    "turns": lambda: turns(OBJECT),
    "slides": lambda: [analytic_trial(OBJECT, Slide(0, 0.3))],
    "accelerated": lambda: accelerated(OBJECT),
    "pushes": lambda: steady_pushes(OBJECT, CENTERS),
}


def at_truth(obj: ObjectModel, windows: Observations) -> tuple[Table, dict[str, torch.Tensor]]:
    """Forward model with the drag of every particle's own weight, and the masses."""
    model = ParticleModel.of(obj.shape)
    mass = model.particle_mass(torch.tensor(obj.truth.mass))
    drag = model.particle_friction(torch.tensor(obj.truth.friction)) * mass * GRAVITY
    return windows.table(model).dragged(drag), {"mass": mass}


def missing(obj: ObjectModel, trials: list[Trajectory]) -> np.ndarray:
    """Measured wrenches over those of the truth, N and N m, (K, 3)."""
    windows = windows_of(obj, trials)
    table, truth = at_truth(obj, windows)
    return (windows.wrench - table.rows(truth)[:, :3]).numpy()


@pytest.mark.parametrize(
    ("obj", "trials", "within"),
    [
        *(pytest.param(OBJECT, trials, 1e-7 if kind == "pushes" else 1e-9, id=kind) for kind, trials in KINDS.items()),
        pytest.param(CHAIN, lambda: [analytic_links(CHAIN, DRAG)], 1e-3, id="links", marks=pytest.mark.slow),
    ],
)
def test_the_wrench_of_given_masses_is_that_of_coulomb_and_newton(obj, trials, within):
    records = trials()
    measured = windows_of(obj, records).wrench.abs().amax(0).clamp(min=0.1).numpy()
    assert (np.abs(missing(obj, records)) <= within * measured).all()


def test_the_mean_over_parts_errs_by_less_than_half_as_many_parts_change_it():
    turn, errors = Rotate(0, pivot=tuple(OBJECT.shape.grasps[0].position + BESIDE), duration=30.0), {}
    for wander in (0.0, 0.008):
        trials = [analytic_trial(OBJECT, turn, wander=wander)]
        table, _ = at_truth(OBJECT, windows_of(OBJECT, trials))
        left_out = (table.unresolved @ table.windows["drag"][..., None])[..., 0]
        errors[wander] = np.abs(missing(OBJECT, trials)).max(), left_out.abs().max()
    assert max(errors[0.0]) < 1e-9
    assert 1e-4 < errors[0.008][0] < errors[0.008][1]


def test_friction_that_no_unknown_names_is_that_of_all_points():
    trials = [replace(trial, setup=SetupErrors(contact_points=4)) for trial in turns(OBJECT)]
    table, truth = at_truth(OBJECT, windows_of(OBJECT, trials))
    truth |= {"anisotropy": torch.tensor([0.1, 0.05]), "friction_law": torch.tensor([0.0, 0.0, 0.1])}
    assert table.points.shape[1] > 1
    assert_allclose(table.rows(truth), table.rows(truth | zeros(friction=table.points.shape[:2])), rtol=1e-12)


@pytest.mark.parametrize("departure", np.diag([0.1, 0.2, 0.15]), ids=["along", "across", "around"])
@pytest.mark.parametrize("kind", ["turns", "accelerated", "pushes"])
def test_friction_that_departs_from_coulombs_law_adds_its_own_wrench(kind, departure):
    windows = windows_of(OBJECT, [on_plastic(OBJECT, each, departure) for each in KINDS[kind]()])
    table, truth = at_truth(OBJECT, windows)
    found = table.rows(truth | {"friction_law": torch.tensor(departure)})
    assert_allclose(found[:, :3], windows.wrench, atol=1e-7 * float(windows.wrench.abs().max()))


@pytest.mark.parametrize(
    "action",
    [Rotate(0, duration=2.5, pivot=tuple(APART.shape.grasps[0].position + BESIDE)), Accelerate(1), Slide(2, 0.3)],
    ids=["turn", "accelerated", "slide"],
)
def test_an_object_beside_its_place_in_the_hand_moves_as_derived(action):
    offset = np.array([1e-5, -5e-6])
    record = replace(held_beside(APART, action, offset), action=action)
    table, truth = at_truth(APART, windows_of(APART, [record]))
    _, slopes = table.linearized(truth | zeros(grasp_offset=(2,)))
    expected = slopes["grasp_offset"].numpy() @ -offset
    assert_allclose(missing(APART, [record]), expected, atol=2e-3 * np.abs(expected).max())


def test_a_tilt_about_an_axis_of_the_table_adds_gravity_as_in_the_air():
    windows = windows_of(OBJECT, turns(OBJECT))
    table, truth = at_truth(OBJECT, windows)
    slopes = table.linearized(truth | zeros(table_tilt=(2,)))[1]["table_tilt"][:, :2]
    yaw = windows.poses[..., 2].numpy()
    in_object = np.stack([np.cos(yaw), np.sin(yaw), -np.sin(yaw), np.cos(yaw)], -1).mean(1).reshape(-1, 2, 2)
    assert_allclose(slopes, OBJECT.total_mass * in_object @ SIDEWAYS[:, :2].T, rtol=1e-9, atol=1e-9)


def test_groups_beside_their_places_move_as_derived():
    shift = 1e-5 * np.cos(np.arange(2 * APART.shape.n_m)).reshape(-1, 2)
    moved = replace(APART.shape, particles=APART.shape.particles + shift[APART.shape.mass_group])
    beside = replace(APART, shape=moved)
    records = [analytic_trial(beside, Accelerate(0)), *turns(beside, [1])]
    table, truth = at_truth(APART, windows_of(APART, records))
    _, slopes = table.linearized(truth | zeros(particle_offset=(APART.shape.n_m, 2)))
    expected = slopes["particle_offset"].numpy() @ shift.ravel()
    assert_allclose(missing(APART, records), expected, atol=2e-3 * np.abs(expected).max())


@pytest.mark.parametrize("part", [0.01, 0.1, 0.3])
def test_friction_that_differs_by_direction_is_that_of_the_ellipse(part):
    direction = 0.4
    plain = [analytic_trial(OBJECT, Slide(0, 0.3)), *turns(OBJECT, [1])]
    grained = [on_anisotropic_table(OBJECT, trial, (1 - part) / (1 + part), direction) for trial in plain]
    table, truth = at_truth(OBJECT, windows_of(OBJECT, plain))
    anisotropy = part * torch.tensor([np.cos(2 * direction), np.sin(2 * direction)])
    found = (table.rows(truth | {"anisotropy": anisotropy}) - table.rows(truth)).numpy()
    # friction of the fake world is the geometric mean of both axes, ours the arithmetic one
    even = windows_of(OBJECT, plain).wrench.numpy()
    wrench = (1 - part**2) ** 0.5 * windows_of(OBJECT, grained).wrench.numpy()
    assert_allclose(found, wrench - even, atol=2e-3 * np.abs(wrench - even).max())


def predicted_windows(trials: list[Trajectory], errors: ModelErrors, **off: torch.Tensor) -> TrialWindows:
    """Windows that show what the forward model predicts of the truth and of some errors of the setup."""
    on_table = OnTable.of(OBJECT.shape, windows_of(OBJECT, trials), "own_weight", errors)
    predicted = on_table.predicting(true_values(OBJECT) | off).windows
    return TrialWindows.about(OBJECT.shape, OBJECT.total_mass, predicted, errors)


def solved(windows: TrialWindows, guess: MassDistribution) -> Solution:
    """One round of Algorithm 1."""
    solution = algorithm_1(windows, guess, lambda system: (closed_form(system), ()))
    assert isinstance(solution, Solution)
    return solution


@pytest.mark.parametrize(
    ("trials", "rounds"),
    [
        pytest.param(KINDS["turns"], 8, id="turns"),
        pytest.param(lambda: [*turns(OBJECT, [0, 1]), *KINDS["slides"]()], 8, id="slides"),
        pytest.param(lambda: trials_of(OBJECT), 8, id="accelerated"),
        pytest.param(lambda: steady_pushes(OBJECT, np.vstack([CENTERS, -CENTERS])), 12, id="steady pushes"),
        pytest.param(lambda: analytic_pushes(OBJECT, PUSHES), 8, id="pushes", marks=pytest.mark.slow),
    ],
)
def test_masses_come_back_from_predicted_wrenches(trials, rounds):
    found = predicted_windows(trials(), SHARP)
    guess = found.first_guess()
    for _ in range(rounds):
        guess = solved(found, guess).masses.distribution
    assert_allclose(guess.mass, OBJECT.truth.mass, rtol=1e-8)


def test_masses_come_back_through_an_error_in_which_the_wrench_is_not_linear():
    setup, off = SetupErrors(anisotropy=0.2), {"anisotropy": torch.tensor([0.2, -0.1], dtype=torch.float64)}
    trials = [replace(trial, setup=setup) for trial in turns(OBJECT, noise=0.02)]
    found = predicted_windows(trials, ModelErrors(), **off)
    guess = found.first_guess()
    for _ in range(4):
        solution = solved(found, guess)
        found, guess = found.about_errors(guess, solution.H.friction_load), solution.masses.distribution
    assert found.off is not None
    assert_allclose(found.off["anisotropy"], off["anisotropy"], rtol=1e-3)
    assert_allclose(guess.mass, OBJECT.truth.mass, rtol=1e-5)


SCALED, SCALE = drawn_object(2), SetupErrors(scale=0.02)
TRIALS = [replace(trial, setup=SCALE) for trial in turns(SCALED, noise=0.05)]


@pytest.mark.parametrize(
    "method", ["hidden_states", "least_squares", pytest.param("support_aware", marks=pytest.mark.slow)]
)
def test_a_method_knows_the_object_no_better_than_the_scale(method: str):
    found = ask(SCALED, TRIALS, build_method(method, {}))
    assert found.covariance is not None
    count = SCALED.shape.particles_per_group
    assert np.sqrt(count @ found.covariance @ count) == pytest.approx(SCALE.scale, rel=0.1)


@pytest.mark.parametrize("made", [True, False], ids=["observed", "expected"])
def test_a_report_knows_the_object_no_better_than_the_scale(made: bool):
    actions, assumptions = [trial.action for trial in TRIALS], Assumptions(setup=SCALE)
    of = SCALED.shape, SCALED.truth
    report = observed(*of, TRIALS, assumptions) if made else expected(*of, actions, preset("ft300s"), assumptions)
    assert np.sqrt(report.covariance.sum()) == pytest.approx(SCALE.scale, rel=0.1)


TURNED = [
    Rotate(grasp, duration=2.5, pivot=tuple(OBJECT.shape.grasps[grasp].position + BESIDE), back=back)
    for grasp, back in ((0, True), (1, False), (2, True))
]


def test_a_repeated_record_counts_once():
    trials = turns(OBJECT)
    again = [*trials, replace(trials[0], reason="again"), *trials]
    assert torch.equal(windows_of(OBJECT, again).wrench, windows_of(OBJECT, trials).wrench)
    no_data = replace(trials[0], segment=np.full_like(trials[0].segment, -1))  # of the same wrench
    assert torch.equal(windows_of(OBJECT, [no_data, *trials]).wrench, windows_of(OBJECT, trials).wrench)


def test_windows_belong_to_their_caller():
    first = windows_of(OBJECT, trials := turns(OBJECT, [0]))
    before = first.wrench.clone()
    first.wrench.mul_(2.0)
    assert torch.equal(windows_of(OBJECT, trials).wrench, before)


def change(trials, setup=EXACT_SETUP, **errors):
    """Change of the planar wrenches that errors of a setup are predicted to make."""
    windows, theta = replace(windows_of(OBJECT, trials), setup=setup), true_values(OBJECT)
    on_table = OnTable.of(OBJECT.shape, windows, "own_weight", ModelErrors())

    def rows(theta):
        predict = torch.vmap(lambda window: on_table.predict(theta, window))
        return predict(on_table.table.windows)[:, PLANAR].numpy().ravel()

    off = {name: torch.as_tensor(value, dtype=torch.float64) for name, value in errors.items()}
    return rows(theta | off) - rows(theta)


def wrenches(trials):
    return windows_of(OBJECT, trials).wrench.numpy().ravel()


@pytest.mark.parametrize("millimeters", [0.0, 0.5, 1.0, 2.0, 5.0])
def test_a_known_foot_near_the_pivot_drags_as_in_the_mean_over_the_errors_of_its_place(millimeters):
    foot = OBJECT.shape.particles[np.argmin(np.linalg.norm(OBJECT.shape.particles - [0.0, 0.02], axis=1))]
    beside = Rotate(0, duration=2.5, pivot=(float(foot[0]) + 1e-3 * millimeters, float(foot[1])))
    model, exact = ParticleModel.of(OBJECT.shape), windows_of(OBJECT, [analytic_trial(OBJECT, beside)])
    stated = SetupErrors(grasp_offset=5e-4, particle_offset=5e-4)
    each = torch.ones(len(model.particles), dtype=torch.float64)
    sharp = exact.table(model, 1e-6).dragged(each)
    offsets = torch.tensor(np.random.default_rng(0).normal(0, 5e-4 * 2**0.5, (2000, 2)))
    mean = torch.vmap(lambda offset: sharp.rows({"grasp_offset": offset}), chunk_size=500)(offsets).mean(0)
    faded = replace(exact, setup=stated).table(model, 1e-6).dragged(each).rows({})
    assert_allclose(faded[:, :2], mean[:, :2], atol=0.12)  # a foot drags 1 N
    if 0 < millimeters < 1:
        assert float((sharp.rows({}) - mean)[:, :2].norm(dim=1).min()) > 0.4


def test_groups_of_more_friction_drag_more():
    more = replace(OBJECT, truth=replace(OBJECT.truth, mass=OBJECT.truth.mass * [1.02, 1, 1, 1, 1, 1]))
    plain, harder = ([analytic_trial(obj, Slide(0, 0.3))] for obj in (OBJECT, more))
    assert_allclose(change(plain, group_friction=[0.02, 0, 0, 0, 0, 0]), wrenches(harder) - wrenches(plain), atol=1e-6)


def test_a_gain_of_all_axes_scales_the_wrench():
    plain = [analytic_trial(OBJECT, action) for action in TURNED]
    scaled = change(plain, gain=[0.01] * 6).reshape(-1, 3)
    assert_allclose(scaled, 0.01 * wrenches(plain).reshape(-1, 3), atol=1e-5)


def test_where_all_move_alike_the_pattern_of_contact_does_not_matter():
    few = SetupErrors(contact_points=3)
    shape = priors(OBJECT.shape, few, ModelErrors(), 1.0, 1).blocks["contact_points"].mean.shape
    pattern = 0.1 * np.random.default_rng(0).standard_normal(shape)
    pattern[:, :2] = 0.0  # those that carry a group off its middle
    slid = change([analytic_trial(OBJECT, Slide(0, 0.3))], few, contact_points=pattern)
    turned = change([analytic_trial(OBJECT, TURNED[0])], few, contact_points=pattern)
    assert np.abs(slid).max() < 1e-9 and np.abs(turned).max() > 1e-3


@pytest.mark.slow
@pytest.mark.parametrize("method", [HiddenStates(), LeastSquares()], ids=["hidden_states", "least_squares"])
def test_errors_that_are_stated_widen_the_answers_own(method):
    setups = EXACT_SETUP, SetupErrors(grasp_offset=0.001, group_friction=0.03)
    exact, wide = (ask(OBJECT, [replace(t, setup=setup) for t in trials_of(OBJECT)], method) for setup in setups)
    assert exact.status == wide.status == "ok"
    assert (claimed(wide) > 2 * claimed(exact)).all()


def test_a_grasp_offset_that_is_stated_explains_the_trials_and_one_that_is_not_does_not():
    shifts = 0.0015 * np.random.default_rng(0).standard_normal((6, 2))
    turned = turns_beside(OBJECT, BESIDE)
    trials = [held_beside(OBJECT, action, shift) for action, shift in zip(turned, shifts, strict=True)]
    trials += accelerated(OBJECT)
    answer = ask(OBJECT, trials)
    assert answer.status == "unexplained" and answer.diagnostics["misfit"] > 3
    answer = ask(OBJECT, [replace(t, setup=SetupErrors(grasp_offset=0.0015)) for t in trials])
    assert answer.status == "ok" and answer.diagnostics["misfit"] < 2
