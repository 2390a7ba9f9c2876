"""Objects that the hand does not hold rigidly, links behind hinges and pushed ones: physics, windows, and estimates."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
from jaxtyping import Float
from numpy.testing import assert_allclose

from estimators import METHODS, Estimate, HiddenStates, build_method
from estimators.action_selection.random import RandomDrags
from estimators.evaluation.metrics import hinge_columns
from estimators.hidden_states.trial_windows import TrialWindows
from estimators.identifiability.predicted import predicted_windows
from estimators.identifiability.quasi_static import Drag
from estimators.particles.load_groups import LoadGroups, rank_of
from estimators.particles.motion import LinkMotion, Planned
from estimators.particles.windows import PLANAR, Observations
from estimators.particles.wrench import AffineLoads, WrenchModel, predicted_wrenches
from estimators.posterior import table_errors
from estimators.posterior.on_table import OnTable
from estimators.posterior.priors import priors
from estimators.testing.analytic_world import drawn_object
from estimators.wrench.jacobian import zeros
from estimators.wrench.model import EXACT, ModelErrors, ParticleModel
from estimators.wrench.support import own_weight_loads
from testbed import (
    Accelerate,
    Action,
    ObjectModel,
    Phase,
    Push,
    Rotate,
    SetupErrors,
    Slide,
    Trajectory,
    load_object,
    preset,
)
from testbed.errors import InfeasibleTrialError, InvalidValueError
from testbed.frames import perpendicular, rotation_2d
from testbed.objects.chain import Chain
from testbed.sensing.camera import CAMERAS, draw_camera
from testbed.sensing.noise import draw_sensing
from testbed.sensing.push_windows import WINDOW, push_windows, touching
from testbed.sensing.windows import PARTS, wrench_in_object
from testbed.simulation.runner import SimulationRunner
from testbed.simulation.settings import ContactSettings
from testbed.trial import RIGID, Trial
from tests.fakes.analytic_links import analytic_links, drawn_chain
from tests.fakes.analytic_push import analytic_pushes, drag_of, steady_pushes
from tests.helpers.answers import ask, claimed, found, nad, true_values, windows_of
from tests.helpers.blocks import blocks
from tests.helpers.simulated import clean

slow = pytest.mark.slow


def bar(links: list[int], masses: list[float], torques: list[float]) -> ObjectModel:
    """Bar of 30 mm blocks; `links` has the number of blocks in each link."""
    made = blocks(["1" * sum(links)], masses, 0.4, size=0.03, height=0.02)
    at = (np.cumsum(links)[:-1] - sum(links) / 2) * 0.03
    chain = Chain(np.repeat(np.arange(len(links)), links), np.column_stack([at, np.zeros(len(at))]))
    return replace(made, shape=replace(made.shape, chain=chain), hinge_friction=tuple(torques))


TWO = bar([2, 2], [0.12, 0.05, 0.2, 0.08], [0.01])
THREE = bar([2, 2, 2], [0.1, 0.12, 0.2, 0.08, 0.15, 0.06], [0.004, 0.002])
BESIDE = 0.015


def drags(obj: ObjectModel) -> list[Slide | Rotate]:
    """Slides and turns by two grasps: at the ends of two links, on the middle one of three."""
    grasps, (one, two) = obj.shape.grasps, (0, 3) if obj is TWO else (2, 3)
    pivots = {g: tuple((grasps[g].position + BESIDE).tolist()) for g in (one, two)}
    slides = [Slide(one, np.pi / 2, duration=2.5), Slide(two, -np.pi / 2, duration=2.5)]
    return [*slides, *(Rotate(g, duration=2.5, pivot=pivot) for g, pivot in pivots.items())]


def hinges_of(obj: ObjectModel, answer: Estimate) -> list[float]:
    """Frictions of all hinges, N m."""
    return [answer.diagnostics[f"hinge_{hinge}_Nm"] for hinge in range(len(obj.hinge_friction))]


def trials_of(obj: ObjectModel, **rates: float) -> list[Trajectory]:
    return [analytic_links(obj, action, **rates) for action in drags(obj)]


def planned(**fields: Any) -> Planned:
    """Window of a turn of TWO about its hinge by grasp 0, at 0.5 rad/s."""
    assert TWO.shape.chain is not None
    arm = TWO.shape.grasps[0].position - TWO.shape.chain.hinges[0]
    twists, poses = np.tile([*0.5 * perpendicular(arm), 0.5], (PARTS, 1)), np.zeros((PARTS, 3))
    return Planned(0, False, 0, None, np.array([0.0, 1.0]), twists, np.zeros(3), 0.25, poses)._replace(**fields)


@pytest.mark.parametrize(("error", "may_rest"), [(0.0, False), (0.05, False), (0.1, True)])
def test_a_link_may_rest_where_its_rate_is_within_the_errors_of_the_camera(error, may_rest):
    """The other link rests; its rate is measured as 0.2 rad/s."""
    turned, errors = np.zeros((PARTS, 2, 3)), np.zeros((2, 3, 4))
    turned[:, :, 1], errors[1, 1, 0] = (0.5, 0.2), error
    assert LinkMotion(TWO.shape, planned(turned=turned, turned_errors=errors)).may_rest == may_rest


def test_hinges_join_links_and_rates_are_those_of_places():
    chain, rng = Chain(np.array([0, 1, 2]), np.array([[0.1, 0.0], [0.2, 0.03]])), np.random.default_rng(0)
    point, step = np.array([0.14, 0.01]), 1e-5
    angle, rate, slope = rng.normal(size=(3, 3))
    angle[1] = slope[1] = 0.0
    spin, velocity, acceleration = rate[1], rng.normal(size=2), rng.normal(size=2)

    def moved(time: float) -> tuple[np.ndarray, np.ndarray]:
        """Motion, and places of two hinges on each of their links, in axes that stand still."""
        turn = spin * time  # of the link in the hand
        yaw = angle + (rate - spin) * time + slope * time**2 / 2
        hand = rotation_2d(-turn) @ (velocity + acceleration * time)
        turned = np.column_stack([yaw, rate + slope * time, slope])[None]
        links = chain.moved(
            1, point, np.array([[*hand, spin]]), np.array([*rotation_2d(-turn) @ acceleration, 0]), turned
        )[0]
        pairs = [(0, 0), (1, 0), (1, 1), (2, 1)]
        places = [rotation_2d(links[k, 0]) @ (chain.hinges[h] - point) + links[k, 1:3] for k, h in pairs]
        grasp = velocity * time + acceleration * time**2 / 2
        return links, np.array([grasp + rotation_2d(turn) @ place for place in places])

    (links, here), (_, before), (_, after) = moved(0.0), moved(-step), moved(step)
    assert_allclose(here[0], here[1], atol=1e-12)
    assert_allclose(here[2], here[3], atol=1e-12)
    for index, link in enumerate((0, 1, 1, 2)):
        u, w, x, a = links[link, 3:5], links[link, 5], here[index], links[link, 6:8]
        side = np.array([-x[1], x[0]])
        assert_allclose((after - before)[index] / (2 * step), u + w * side, atol=1e-8)
        second = (after - 2 * here + before)[index] / step**2
        assert_allclose(second, a + links[link, 8] * side - w**2 * x, atol=1e-4)


@slow
@pytest.mark.parametrize(
    ("obj", "rates", "within"),
    # at 25 Hz each of a window's ten parts is one sample, and no mean stands for several
    [(TWO, {}, 3e-4), (THREE, {"rate": 25.0, "camera_rate": 1000.0}, 1e-6)],
    ids=["two links as recorded", "three, a sample a part"],
)
def test_masses_and_hinges_are_recovered_without_noise(obj: ObjectModel, rates: dict[str, float], within: float):
    answer = ask(obj, trials_of(obj, **rates), HiddenStates(pivot_error=1e-8, refinements=5))
    assert answer.status == "ok"
    assert_allclose(found(answer).mass, obj.truth.mass, rtol=within)
    assert_allclose(hinges_of(obj, answer), obj.hinge_friction, rtol=within)


@slow
@pytest.mark.parametrize(("obj", "unknown"), [(TWO, 5), (THREE, 8)], ids=["two links", "three"])
def test_slides_and_turns_show_every_mass_and_hinge_and_one_wrench_does_not(obj: ObjectModel, unknown: int):
    trial = TrialWindows.of(obj.shape, obj.total_mass, trials_of(obj), EXACT)
    assert trial is not None
    equations = trial.friction_equations(obj.truth)
    both = torch.cat([equations.q, equations.wide["hinge_friction"]], -1).flatten(0, 1).numpy()
    columns = both / np.linalg.norm(both, axis=0)
    assert np.linalg.matrix_rank(columns, 1e-3) == unknown
    window = columns[PLANAR]  # the first window's wrench
    assert np.linalg.matrix_rank(window, 1e-3) == 3


def residuals(obj: ObjectModel, windows: Observations) -> Float[np.ndarray, "K 3+H"]:
    """Planar wrenches and hinge torques less what true masses, frictions and hinges give them."""
    trials = TrialWindows.about(obj.shape, obj.total_mass, windows, ModelErrors(pivot_error=0.0))
    found, loads = trials.friction_equations(obj.truth), torch.tensor(trials.friction_loads(obj.truth))
    hinges = found.wide["hinge_friction"] @ torch.tensor(obj.hinge_friction, dtype=torch.float64)
    return (found.b - found.q @ loads - hinges)[:, [*PLANAR, *range(6, found.b.shape[1])]].numpy()


@pytest.mark.parametrize(
    "offset", [pytest.param((1e-3, 0.0), id="along", marks=slow), pytest.param((0.0, 1e-3), id="across")]
)
def test_rows_change_with_the_place_in_the_hand_as_counted(offset: tuple[float, float]):
    drag = Rotate(0, duration=6.0, pivot=(0.0, 0.04))
    grasps = [replace(g, position=g.position + offset) for g in TWO.shape.grasps]
    off = windows_of(TWO, [analytic_links(replace(TWO, shape=replace(TWO.shape, grasps=tuple(grasps))), drag)])
    on_table = OnTable.of(TWO.shape, off, "own_weight", ModelErrors(pivot_error=0.0))
    unknowns = priors(TWO.shape, SetupErrors(grasp_offset=1e-3), ModelErrors(), TWO.total_mass, 1)
    unknowns = unknowns.given(**true_values(TWO))
    slopes = on_table.linearized(unknowns, unknowns.start()).slopes.unflatten(0, on_table.read.shape)
    # the grip is farther along: the object lies back in the hand
    expected = (-slopes[..., unknowns.at["grasp_offset"]] @ torch.tensor(offset, dtype=torch.float64) / 1e-3).numpy()
    for rows, places in ((slice(0, 3), PLANAR), (slice(3, None), slice(6, None))):
        missed = residuals(TWO, off)[:, rows]
        assert_allclose(missed, expected[:, places], atol=0.15 * np.abs(missed).max())


@slow
def test_a_hinge_that_stands_has_no_row():
    stiff = replace(TWO, hinge_friction=(1.0,))
    with pytest.raises(InvalidValueError, match="one that turns every hinge at once"):
        analytic_links(stiff, drags(stiff)[0])
    trajectory = SimulationRunner().run(Trial(stiff, Rotate(0, duration=3.0, pivot=(-0.03, 0.02))))
    trial = TrialWindows.of(stiff.shape, stiff.total_mass, [trajectory], EXACT)
    assert trial is not None and not trial.friction_equations(stiff.truth).wide["hinge_friction"].any()


@slow
def test_a_hinge_that_never_turns_is_not_observed():
    half = bar([2, 2, 2], list(THREE.truth.mass * THREE.shape.particles_per_group), [0.004, 1.0])
    more = [Rotate(0, duration=4.0, pivot=(-0.09, 0.02)), Slide(0, -np.pi / 2, duration=4.0)]
    trials = [SimulationRunner().run(Trial(half, action)) for action in [*drags(THREE), *more]]
    answer = ask(half, trials)
    assert answer.status == "ok" and answer.message == "hinge 1 stands in every window: its friction is not observed"
    columns = hinge_columns(half.hinge_friction, answer.diagnostics)
    assert_allclose(columns["hinge_Nm"], [0.004, np.nan], rtol=0.02)
    assert columns["hinge_error"] < 0.02 and np.isnan(columns["hinge_error_Nm"][1])


@slow
def test_errors_of_a_camera_count():
    exact, off = trials_of(TWO), []
    sharp = ask(TWO, exact)  # sharp poses leave the model's errors
    for draw in range(4):
        streams = [draw_camera(t.camera, CAMERAS["30hz"], 10 * draw + i) for i, t in enumerate(exact) if t.camera]
        blurred = ask(TWO, [replace(t, camera=stream) for t, stream in zip(exact, streams, strict=True)])
        added = claimed(blurred) ** 2 - claimed(sharp) ** 2
        assert (added > claimed(sharp) ** 2).all()
        off.append((found(blurred).mass - found(sharp).mass) / added**0.5)
    assert 0.2 < np.sqrt(np.mean(np.square(off))) < 1.0
    assert ask(TWO, [replace(t, camera=None) for t in exact]).status == "no_data"


@slow
def test_every_method_takes_links_or_says_why_not():
    trials = trials_of(TWO)[:2]
    # `learned` needs a trained file first: its own tests have its refusals
    for name in set(METHODS) - {"cma_es", "nelder_mead", "random_search", "weighted_sampling", "learned"}:
        answer = ask(TWO, trials, build_method(name, {}))
        knows = name in ("hidden_states", "bayes", "support_aware", "least_squares")
        assert (answer.status == "assumption_violated") == (not knows), name
        assert knows or "with hinges, which this method takes for one piece" in answer.message


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda: predicted_windows(TWO.shape, [Slide(0)], preset("ideal")), "a rigid object; see `predicted_drags`"),
        (
            lambda: SimulationRunner().run(Trial(TWO, Slide(0), RIGID)),
            "own_weight and no push, of an object with hinges",
        ),
        (lambda: Chain(np.array([0, 0]), np.array([[0.0, 0.0]])), "links 0 to 1, each with a mass group"),
    ],
)
def test_what_is_not_built_for_links_is_refused(call, said):
    with pytest.raises(InvalidValueError, match=said):
        call()


@slow
def test_a_policy_of_drags_ends_and_takes_no_refused_action():
    first = RandomDrags(3).next(TWO.shape, [])
    assert first is not None
    assert RandomDrags(3, refused={first: "out of reach"}).next(TWO.shape, []) not in (first, None)
    assert RandomDrags(3).next(TWO.shape, trials_of(TWO)[:1] * 3) is None


@slow
@pytest.mark.parametrize(
    "obj", [drawn_chain(1), drawn_chain(3), *map(load_object, ("shears", "folding_rule", "saw"))], ids=lambda o: o.name
)
def test_simulated_links_are_recovered(obj: ObjectModel):
    refused: dict[Action, str] = {}
    policy, runner, trials = RandomDrags(6, seed=1, refused=refused), SimulationRunner(), []
    while (action := policy.next(obj.shape, trials)) is not None:
        try:
            trials.append(runner.run(Trial(obj, action)))
        except InfeasibleTrialError as error:
            refused[action] = str(error)
    answer = ask(obj, trials)
    assert answer.status == "ok" and nad(obj, answer) < 0.02
    assert_allclose(hinges_of(obj, answer), obj.hinge_friction, atol=0.02 * max(obj.hinge_friction))
    assert windows_of(obj, trials).articulated


I2 = load_object("I2")


@pytest.fixture(scope="module")
def windows():
    """Windows of accelerated turns of I2 in simulation, by a perfect sensor."""
    records = [clean("I2", Accelerate(grasp)) for grasp in (0, 1, 4)]
    return windows_of(I2, [draw_sensing(record, preset("ideal"), 0) for record in records])


MASS, FRICTION = true_values(I2).values()


def missing(windows):
    """Planar forces that the true masses and frictions leave, N."""
    model = ParticleModel.of(I2.shape)
    loads = AffineLoads.of(I2.shape, model, windows, own_weight_loads)
    wrenches = WrenchModel.of(model, windows, loads, ModelErrors.pivot_error)
    return (windows.wrench - wrenches.wrench(MASS, FRICTION))[:, :2]


@pytest.mark.slow
def test_friction_leads_by_the_time_of_its_damping(windows):
    leads = np.arange(0.0, 0.041, 0.005)
    left = [float(missing(replace(windows, twists=windows.twists + t * windows.twist_rates)).norm()) for t in leads]
    assert leads[np.argmin(left)] == pytest.approx(1 / ContactSettings().friction_damping)
    assert min(left) < 0.5 * left[0]


def test_the_derivative_in_the_lead_explains_the_residual(windows):
    model, errors = ParticleModel.of(I2.shape), ModelErrors()
    loads = AffineLoads.of(I2.shape, model, windows, own_weight_loads)
    drag, mass = model.particle_friction(FRICTION) * loads.at(MASS), model.particle_mass(MASS)
    table = windows.table(model, errors.pivot_error).dragged(drag)
    column = errors.lead_error * table.linearized({"mass": mass} | zeros(lead=()))[1]["lead"][:, :2].flatten()
    left = missing(windows).flatten()
    size = float(column @ left / (column @ column))
    assert 0.5 < size < 1.5 and float((left - size * column).norm()) < 0.7 * float(left.norm())
    still = replace(windows, twists=windows.twists.mean(1, keepdim=True).expand_as(windows.twists))
    assert not still.table(model).dragged(drag).linearized(zeros(lead=()))[1]["lead"].any()


BLOCKS = drawn_object(3, ["11", "11", "11"])
"""2 x 3 blocks of known masses, which no hand can grip across."""
CENTERS = np.random.default_rng(1).uniform(-0.2, 0.2, (8, 2))


def test_a_pushed_disc():
    grid = np.arange(-40, 41) * 1e-3
    cells = np.stack(np.meshgrid(grid, grid), -1).reshape(-1, 2)
    cells = cells[np.linalg.norm(cells, axis=1) < 0.04]
    disc = Drag(cells, np.full(len(cells), 3.0 / len(cells)))
    still = np.zeros(2)
    assert disc.wrench(np.array([0.02, 0.0, 0.0]), still) == pytest.approx([3.0, 0.0, 0.0], abs=1e-9)
    assert disc.wrench(np.array([0.0, 0.0, 1.0]), still)[2] == pytest.approx(2 / 3 * 3.0 * 0.04, rel=0.01)
    # pushed through its center it does not turn; beside its center it turns away
    ahead = np.array([[1.0, 0.0], [1.0, 0.0]])
    twists = disc.pushed(np.array([[-0.04, 0.0], [-0.04, 0.01]]), 0.03 * ahead, ahead, np.array([0.4, 0.4]))
    assert twists[0] == pytest.approx([0.03, 0.0, 0.0], abs=1e-9)
    assert twists[1, 2] < -0.05


def test_friction_is_on_a_convex_limit_surface_and_along_its_normal():
    drag, rng = drag_of(BLOCKS), np.random.default_rng(0)
    twists = rng.normal(size=(60, 3)) * [0.03, 0.03, 0.5]
    wrenches = np.array([drag.wrench(twist, np.zeros(2)) for twist in twists])
    power = wrenches @ twists.T
    assert (np.diag(power)[None] >= power - 1e-12).all()  # no other wrench of the surface does more work on a twist


def test_the_fingertip_sticks_or_slides_at_the_edge_of_its_cone():
    drag, normal, point = drag_of(BLOCKS), np.array([1.0, 0.0]), np.array([-0.05, 0.02])
    angles = np.radians([-50, -20, 0, 20, 50])
    velocities = 0.03 * np.column_stack([np.cos(angles), np.sin(angles)])
    twists = drag.pushed(np.tile(point, (5, 1)), velocities, np.tile(normal, (5, 1)), np.full(5, 0.3))
    slid = []
    for velocity, twist in zip(velocities, twists, strict=True):
        force = drag.wrench(twist, point)
        assert twist[0] == pytest.approx(velocity[0]) and force[2] == pytest.approx(0, abs=1e-9)
        steep = abs(force[1]) / force[0]
        slid.append(abs(twist[1] - velocity[1]) > 1e-9)
        assert steep == pytest.approx(0.3) if slid[-1] else steep <= 0.3
        # friction at the fingertip goes against its slip
        assert not slid[-1] or force[1] * (velocity[1] - twist[1]) > 0
    assert any(slid) and not all(slid)


@pytest.mark.slow
def test_masses_from_pushes_without_noise():
    trials = steady_pushes(BLOCKS, CENTERS)
    methods = {name: (build_method(name, {}), 3e-5) for name in ("least_squares", "cma_es")}
    for name, (method, most) in ({"hidden_states": (HiddenStates(pivot_error=1e-7), 1e-6)} | methods).items():
        answer = ask(BLOCKS, trials, method)
        assert answer.status == "ok" and np.abs(found(answer).mass / BLOCKS.truth.mass - 1).max() < most, name
    answer = ask(BLOCKS, trials, build_method("support_aware", {}))
    off = np.abs(found(answer).mass - BLOCKS.truth.mass)
    assert (off < 0.5 * claimed(answer)).all()  # shrinkage toward the prior


@pytest.mark.parametrize("speed", [0.1, 0.2])
def test_a_fast_push_has_windows_over_as_long_a_way(speed):
    push = Push((0.05, -0.01), math.radians(-160), length=0.12, speed=speed, friction=3.0)
    assert push.pace == pytest.approx(0.05 / speed)
    trial = analytic_pushes(BLOCKS, [push])[0]
    windows = push_windows(trial)
    assert windows and all(np.ptp(w.since_tare) < 2 * WINDOW * push.pace for w in windows)
    predicted = predicted_wrenches(BLOCKS.shape, BLOCKS.truth, [trial])[0]
    inside, measured = ~np.isnan(predicted[:, 0]), wrench_in_object(trial)[:, [0, 1, 5]]
    assert inside.any()
    off = (predicted - measured)[inside].mean(axis=0)  # a window has one wrench, that of its mean
    assert (np.abs(off) < [0.03, 0.03, 0.1] * np.abs(measured[inside]).max(axis=0)).all()


@pytest.mark.slow
@pytest.mark.parametrize("phase", [Phase.TARE, Phase.APPROACH])
def test_noise_is_no_contact_with_and_without_a_tare(phase):
    (trial,) = analytic_pushes(BLOCKS, [Push((0.05, -0.01), math.radians(-160))])
    noise = 0.07 * np.random.default_rng(0).standard_normal(trial.wrench_on_object_world.shape)
    before = np.arange(len(noise)) < 40
    phases, segment = np.where(before, phase, trial.phase), np.where(before, -1, trial.segment)
    empty = replace(trial, phase=phases, segment=segment, wrench_on_object_world=noise)
    with pytest.raises(InvalidValueError, match="no force at the fingertip"):
        touching(empty)
    step = np.arange(len(noise))  # in contact for 0.03 s before the steady stretch
    phases, segment = np.where(step < 12, phase, trial.phase), np.where(step < 15, -1, trial.segment)
    met = trial.wrench_on_object_world * (step[:, None] >= 12)
    assert len(touching(replace(trial, phase=phases, segment=segment, wrench_on_object_world=met))) > 20


@pytest.mark.slow
def test_the_rank_of_q_grows_within_one_push():
    push = Push((0.05, -0.01), math.radians(-160), length=0.1, speed=0.05, friction=3.0)
    windows, model = windows_of(BLOCKS, analytic_pushes(BLOCKS, [push])), ParticleModel.of(BLOCKS.shape)
    assert bool(windows.pushed.all())
    q = LoadGroups.of(model).gather(windows.drag_rows(model, 0.0)).numpy()
    ranks = [rank_of(q[: count + 1].reshape(-1, 6)) for count in range(len(windows))]
    assert ranks == sorted(ranks) and ranks[0] <= 3 < ranks[-1]


def test_windows_of_a_push_are_of_its_contact_in_sight_of_the_camera_and_predicted_sample_by_sample():
    trial = steady_pushes(BLOCKS, CENTERS[:1], seconds=2.0)[0]
    predicted = predicted_wrenches(BLOCKS.shape, BLOCKS.truth, [trial])[0]
    inside = ~np.isnan(predicted[:, 0])
    assert inside.sum() > 150 and np.abs(predicted - wrench_in_object(trial)[:, [0, 1, 5]])[inside].max() < 1e-4
    wrench = np.array(trial.wrench_on_object_world)
    wrench[150:] = 0.0
    lost = replace(trial, wrench_on_object_world=wrench)
    assert touching(lost)[-1] in range(146, 153)
    assert len(push_windows(lost)) == 2 < len(push_windows(trial)) == 4
    no_contact = replace(lost, wrench_on_object_world=0 * wrench)
    for bad in (replace(trial, camera=None), replace(trial, status="fault"), no_contact):
        with pytest.raises(InvalidValueError):
            push_windows(bad)
    # frames of the first half count without any of the second
    assert trial.camera is not None
    poses = np.array(trial.camera.poses)
    poses[100:] = np.nan
    assert 0 < len(push_windows(replace(trial, camera=replace(trial.camera, poses=poses)))) < 4


@pytest.mark.slow
def test_intervals_hold_under_a_camera(monkeypatch):
    monkeypatch.setattr(table_errors, "PUSH_ERROR", 0.0)  # this world has no errors but the camera's
    rng, inside = np.random.default_rng(1), []
    for seed in range(10):
        trials = steady_pushes(BLOCKS, rng.uniform(-0.2, 0.2, (12, 2)), seconds=2.0)
        seen = [draw_camera(t.camera, CAMERAS["30hz"], 100 * seed + i) for i, t in enumerate(trials) if t.camera]
        answer = ask(BLOCKS, [replace(t, camera=c) for t, c in zip(trials, seen, strict=True)])
        inside.append(np.abs(found(answer).mass - BLOCKS.truth.mass) < 1.96 * claimed(answer))
    assert 0.88 < np.mean(inside) < 0.995
