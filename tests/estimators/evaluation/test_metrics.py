"""NAD and MPD, against first-order theory and another integrator; means, intervals and marks of the comparison."""

from dataclasses import replace
from functools import partial
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
import torch
from numpy.testing import assert_allclose
from rich.console import Console

from estimators.evaluation import metrics as steady_turn
from estimators.evaluation import paper
from estimators.evaluation.metrics import (
    OPEN_LOOP,
    ParticleDistance,
    SteadyTurn,
    mean_particle_distance,
    normalized_absolute_difference,
    open_loop,
)
from estimators.evaluation.statistics import Claims, draws_of, select, significantly_best, summarize
from estimators.particles.wrench import AffineLoads
from estimators.testing.analytic_world import drawn_object, turns
from estimators.wrench.model import ParticleModel, inertia_of, rotate
from estimators.wrench.support import SupportModel
from testbed import InvalidValueError, MassDistribution, ObjectModel, ObjectShape, Trajectory, load_object
from testbed.sensing.windows import steady_samples
from tests.helpers.answers import windows_of
from tests.helpers.lcp_oracle import explicit_rollout
from tests.helpers.rows import row
from viz.figures.maps import absolute_difference
from viz.report.tables import METRICS, NAD, Table, claims_table, metric_table
from viz.report.terminal import rich_table

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


SUPPORTS = "allowed: one of own_weight, rigid"
OF_OBJECT = OBJECT.shape, OBJECT.truth, []
SHORT = masses(np.ones(OBJECT.shape.n_m - 1))
REFUSED = [
    (lambda: nad(SHORT, OBJECT.truth), r"^estimate\.mass: "),
    (lambda: nad(OBJECT.truth, SHORT), r"^truth\.mass: "),
    (partial(mean_particle_distance, *OF_OBJECT, "own weight"), f"support: got 'own weight'; {SUPPORTS}"),
    (partial(mean_particle_distance, *OF_OBJECT, "springs"), f"support: got 'springs'; {SUPPORTS}"),
]


@pytest.mark.parametrize(("call", "message"), REFUSED)
def test_masses_of_another_shape_and_another_support_are_refused(call, message):
    with pytest.raises(InvalidValueError, match=message):
        call()


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


@pytest.mark.parametrize("lost", [0.02, 0.1])
def test_lost_samples_cost_nothing(lost):
    obj = load_object("L2")
    found = distance(obj, [thinned(turn, lost) for turn in turns(obj)])
    assert max(found.open_loop, found.turn) < 2 * FLOOR


def thinned(trial: Trajectory, lost: float) -> Trajectory:
    """A record without a part of its samples, at random."""
    kept = np.random.default_rng(1).random(len(trial.time_s)) > lost
    series = {n: v[kept] for n, v in vars(trial).items() if isinstance(v, np.ndarray) and len(v) == len(kept)}
    return replace(trial, **series)


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
    poses, _ = explicit_rollout(model, inertia, drag, *start, push, turn.grasp, float(turn.time[1]) / fine)
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


NAMES = ("L2", "hammer")


def test_a_summary_is_mean_spread_and_an_interval_that_holds_the_mean():
    rng = np.random.default_rng(0)
    covered = 0
    for _ in range(100):
        summary = summarize(dict(enumerate(rng.normal(3.0, 1.0, 30).tolist())))
        assert summary is not None
        covered += summary.low <= 3.0 <= summary.high
    assert 0.88 < covered / 100 < 0.99
    exact = summarize({0: 1.0, 1: 3.0, 2: np.nan})
    assert exact is not None
    assert (exact.count, exact.mean, exact.spread, exact.missing) == (2, 2.0, pytest.approx(2**0.5), 1)
    assert summarize({0: np.nan}) is None


@pytest.mark.parametrize(("draws", "enough"), [(1, False), (2, False), (4, False), (5, True), (8, True)])
def test_no_interval_and_no_mark_below_five_draws(draws, enough):
    best, other = ({s: mean * (1 + 0.01 * s) for s in range(draws)} for mean in (1.0, 2.0))
    summary = summarize(best | {99: np.nan})
    assert summary is not None and summary.count == draws
    assert np.isfinite([summary.low, summary.high]).all() == enough
    assert significantly_best({"a": best, "b": other}) == ("a" if enough else None)
    rows = [row(m, s, x / 100) for m, of in (("a", best), ("b", other)) for s, x in of.items()]
    text = text_of(metric_table(rows, NAD, "NAD", ["L2"]))
    assert f"NAD; {draws} draw" in " ".join(text.split())
    assert ("[1" in text) == ("*" in text) == enough


def test_the_best_is_marked_only_where_it_is_sure():
    rng = np.random.default_rng(1)
    common = rng.normal(0, 5, 8)
    draws = lambda mean, noise: dict(enumerate((20 + mean + common + noise * rng.normal(size=8)).tolist()))  # noqa: E731
    # paired: a difference of 1 stands out although each method scatters by 5
    assert significantly_best({"a": draws(0, 0.1), "b": draws(1, 0.1), "c": draws(3, 0.1)}) == "a"
    assert significantly_best({"a": draws(0, 3.0), "b": draws(0.1, 3.0)}) is None
    assert significantly_best({"a": draws(0, 0.1)}) is None
    least = dict(enumerate((0.1 * rng.random(6)).tolist()))
    assert significantly_best({"a": least, "b": {seed: value + 4e-17 for seed, value in least.items()}}) is None
    assert significantly_best({"a": {0: 1.0}, "b": {0: 2.0}}) is None, "one draw tells nothing"
    assert significantly_best({"a": {0: 1.0, 1: 1.0}, "b": {0: 1.0, 1: 1.0}}) is None
    assert significantly_best({"a": {0: 1.0, 1: 1.5}, "b": {0: np.nan, 1: np.nan}}) is None


@pytest.mark.slow
@pytest.mark.parametrize("methods", ["ab", "abc"])
def test_false_marks_are_rare(methods: str):
    rng = np.random.default_rng(2)
    tables = [{name: dict(enumerate(rng.normal(size=6).tolist())) for name in methods} for _ in range(400)]
    assert sum(significantly_best(table) is not None for table in tables) < 0.07 * len(tables)


def test_rows_are_selected_and_scaled():
    rows = [row("a", 0, 0.1), row("b", 0, None), row("a", 1, 0.2)]
    assert len(select(rows, method="a", seed=1)) == 1
    assert draws_of(select(rows, method="a"), "nad", 100) == {0: 10.0, 1: 20.0}
    assert np.isnan(draws_of(select(rows, method="b"), "nad")[0])


def text_of(table: Table) -> str:
    console = Console(width=120)
    with console.capture() as captured:
        console.print(rich_table(table))
    return captured.get()


def test_a_table_has_ours_the_papers_and_the_truths():
    rows = [row("hidden_states", s, 0.01 + 0.001 * s) for s in range(5)]
    rows += [row("hidden_states_published", s, 0.1 + 0.002 * s) for s in range(5)]
    rows += [row("random_search", s, 0.4 + 0.01 * s) for s in range(5)]
    rows += [row("random_search_M", s, None) for s in range(5)]
    text = text_of(metric_table(rows, NAD, "NAD", ["L2"]))
    assert "1.2±0.2*" in text
    lines = [words for line in text.splitlines() if (words := line.split()) and words[0][0] != "["]
    figures = [(above[0], line[-1]) for above, line in pairwise(lines) if line[:2] == ["paper,", "real"]]
    assert figures == [("hidden_states_published", "7.3"), ("random_search", "46.4")], "rows of their own"
    assert "underdetermined" in text
    distance = text_of(metric_table(rows, METRICS[1], "MPD", ["L2"]))
    assert "the true masses" in distance
    assert "0.3±0.0" in distance


def test_the_papers_tables_are_whole():
    assert {name: len(row) for name, row in paper.NAD.items()} == dict.fromkeys(paper.NAD, 6)
    assert {name: len(row) for name, row in paper.MPD.items()} == dict.fromkeys(paper.NAD, 8)
    assert_allclose(sum(paper.NAD["diff_lcp"].values()), 283.3)
    assert_allclose(sum(paper.MPD["hidden_states_published"].values()), 11.6)


def test_where_m_leaves_one_unknown_the_table_of_masses_says_so():
    rows = [row("hidden_states", 0, 0.01, name) for name in NAMES]
    assert "hammer: two masses, so one unknown where M is given" in text_of(metric_table(rows, NAD, "NAD"))
    assert "unknown" not in text_of(metric_table(rows, METRICS[1], "MPD"))
    assert "unknown" not in text_of(metric_table(rows[:1], NAD, "NAD"))


@pytest.mark.slow
def test_the_heatmap_shows_every_group_of_every_object_and_method():
    rows = [row(m, s, e, name) for name in NAMES for m, e in (("good", 0.01), ("bad", 0.5)) for s in (0, 1)]
    rows += [row("silent", 0, None, name) for name in NAMES]
    shapes = {name: load_object(name).shape for name in NAMES}
    figure = absolute_difference(rows, shapes, "own weight, ft300s")
    whole, bar = figure.axes
    texts = [t.get_text() for t in whole.texts]
    assert texts[0] == "L2" and texts[7] == f"{0.5 * load_object('L2').group_mass[0]:.2f}"
    assert len(texts) == 2 + (6 + 6 + 1) + (2 + 2 + 1) + 3 and texts.count("no answer") == 2
    assert "kg" in bar.get_ylabel()
    colors = whole.collections[1].get_array()
    assert colors is not None
    assert_allclose(np.unique(colors), np.unique(0.5 * load_object("L2").group_mass))
    norms = [drawn.norm for drawn in whole.collections if drawn.get_array() is not None]
    assert len(norms) == 4 and len({(norm.vmin, norm.vmax) for norm in norms}) == 1


def test_claims_are_errors_over_claimed_ones_and_an_answer_is_silent_where_ok_and_far_off():
    true = [0.1, 0.2, 0.3]
    answers: tuple[dict[str, Any], ...] = (
        {"mass_kg": [0.1, 0.2, 0.34], "mass_error_kg": [0.01] * 3, "misfit": 0.5},
        {"mass_kg": [0.11, 0.2, 0.3], "mass_error_kg": [0.01] * 3},
        {"mass_kg": [0.1, 0.2, 0.9], "mass_error_kg": [0.1] * 3, "status": "unexplained", "misfit": 4.5},
    )
    rows = [row("a", seed, 0.1, true_mass_kg=true, **answer) for seed, answer in enumerate(answers)]
    rows += [row("a", 3, None, mass_error_kg=None), row("b", 0, 0.1)]
    found = Claims.of(rows)
    assert found is not None
    assert_allclose(found.ratio, np.sqrt((16 + 1 + 36) / 9))
    assert_allclose([found.held, found.silent], [7 / 9, 1 / 3])
    assert Claims.of(rows[3:]) is None
    assert Claims.of([row("a", 0, 0.1, mass_kg=None, true_mass_kg=[0.1], mass_error_kg=[0.1])]) is None
    unseen = Claims.of([row("a", 0, 0.1, mass_kg=[0.2, 0.1], true_mass_kg=[0.1, 0.2], mass_error_kg=[None, 0.1])])
    assert unseen is not None and unseen.held == 1 and unseen.ratio == pytest.approx(1)
    for error in ([None] * 3, [np.inf] * 3):
        assert Claims.of([row("a", 0, 0.1, true_mass_kg=true, mass_error_kg=error)]) is None
    table = claims_table(rows)
    assert table is not None and claims_table(rows[3:]) is None
    ((labels, cells),) = table.rows
    assert labels == ("a",) and [cell.text for cell in cells] == ["2.43", "78 %", "50 %", "33 %", "2.5"]
