"""Choice of the support model, and the masses under one rigid body."""

from itertools import product
from typing import Any

import numpy as np
import pytest
import torch
from numpy.testing import assert_allclose
from scipy.linalg import eigh
from scipy.special import logsumexp

from estimators.action_selection.rank import RankDriven
from estimators.base import Estimate
from estimators.posterior.estimator import Bayes, posterior_of
from estimators.posterior.support import SupportTest, support_test
from estimators.support_models.estimator import SupportAware
from estimators.support_models.materials import rank_assignments
from estimators.support_models.polytope import MassPolytope
from estimators.testing.analytic_world import drawn_object, foundation, turns
from estimators.wrench.model import ParticleModel, inertia_of
from estimators.wrench.support import SupportModel
from testbed.errors import InvalidValueError
from testbed.objects.files import load_object
from testbed.objects.model import MassDistribution, ObjectModel
from testbed.simulation.contacts import foot_stiffness
from testbed.simulation.runner import SimulationRunner
from testbed.simulation.settings import ContactSettings
from testbed.trajectory import Trajectory
from testbed.trial import Trial, parse_support
from tests.helpers.answers import ask, claimed, found, holds, nad, trials_of
from tests.helpers.blocks import blocks

SUPPORTS: tuple[SupportModel, ...] = "own_weight", "rigid"
NOISE = 0.02
"""Noise of a sample [N], and a tenth of it in N m."""
REFUTED = ("rigid", "between")
"""Findings that refute own weight."""
MATERIALS = (0.1, 0.4)
"""Masses of the library's blocks, kg."""


def also_slow(*values: object) -> list:
    """Further values of a parameter, for CI alone."""
    return [pytest.param(value, marks=pytest.mark.slow) for value in values]


def data(obj: ObjectModel, *, rigid: bool, springs: float = 0.0, noise: float = NOISE) -> list[Trajectory]:
    return trials_of(obj, rigid=rigid, springs=springs, noise=noise)


def decided(obj: ObjectModel, trajectories: list[Trajectory]) -> SupportTest:
    own, rigid = (posterior_of(obj.shape, obj.total_mass, trajectories, support) for support in SUPPORTS)
    assert own is not None and rigid is not None
    return support_test(obj.shape, obj.total_mass, trajectories, own, rigid)


def joined(obj: ObjectModel, share: float) -> list[Trajectory]:
    """Trials of groups that springs join, from own weight (0) to one rigid body (1)."""
    if share == 1:
        return data(obj, rigid=True)
    return data(obj, rigid=False, springs=share / (1 - share) / mean_work(obj))


def mean_work(obj: ObjectModel) -> float:
    """Mean work of springs as stiff as a foot, over that of the foundation, in the loads that they share."""
    sinks, springs = foundation(obj.shape)
    work = eigh(springs, sinks.T @ sinks, eigvals_only=True)
    return float(work[work > 1e-9 * work[-1]].mean())


def aware(obj: ObjectModel, *, rigid: bool = True, **settings: Any) -> Estimate:
    return ask(obj, data(obj, rigid=rigid), SupportAware(**settings))


@pytest.mark.parametrize("rigid", [True, *also_slow(False)])
@pytest.mark.parametrize("name", ["L2", *also_slow("I2", "F2")])
def test_the_support_is_found_with_and_without_acceleration(name, rigid):
    obj = load_object(name)
    test = decided(obj, data(obj, rigid=rigid))
    assert test.kind == ("rigid" if rigid else "own_weight")
    assert abs(test.rigid_share - rigid) < 3 * test.rigid_share_error < 1
    assert ("rigid" in test.sentence.split("(")[0]) == rigid
    steady = decided(obj, turns(obj, rigid=rigid, noise=NOISE))
    assert (steady.kind in REFUTED) == rigid


@pytest.mark.slow
@pytest.mark.parametrize("rigid", [False, True])
@pytest.mark.parametrize("seed", [0, 1, 2, 3])
def test_it_is_found_for_other_objects_with_two_friction_groups(seed, rigid):
    obj = drawn_object(seed, friction_groups=1 + seed % 2)
    assert (decided(obj, data(obj, rigid=rigid)).kind in REFUTED) == rigid


@pytest.mark.slow
@pytest.mark.parametrize("rigid", [False, True])
def test_one_material_throughout_drags_alike_either_way_and_it_says_so(rigid):
    obj = load_object("I1")
    test = decided(obj, data(obj, rigid=rigid))
    assert test.kind == "undecided"
    assert test.log10_bayes_factor == pytest.approx(0, abs=0.2), "neither wins by the errors that it counts"
    assert "cannot be told apart" in test.sentence
    answer = aware(obj, rigid=rigid)
    assert answer.status == "underdetermined"
    assert (claimed(answer) * obj.shape.particles_per_group > 0.02).all()  # a rigid one may hide its masses


@pytest.mark.slow
@pytest.mark.parametrize("share", [0.0, 0.3, 0.6, 1.0])
def test_the_share_of_springs_in_the_loads_is_found_within_its_error(share):
    obj = drawn_object(5)
    test = decided(obj, joined(obj, share))
    assert abs(test.rigid_share - share) < 2.5 * test.rigid_share_error < 0.5


@pytest.mark.slow
def test_springs_that_push_groups_apart_refuse_own_weight_and_are_no_answer():
    obj = drawn_object(5)
    test = decided(obj, data(obj, rigid=False, springs=-0.2 / mean_work(obj)))
    assert test.kind in REFUTED and test.shared is None
    assert test.rigid_share < -3 * test.rigid_share_error


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_own_weight_is_answered_as_by_the_posterior(seed):
    obj = drawn_object(seed)
    trajectories = data(obj, rigid=False)
    answer, plain = ask(obj, trajectories, SupportAware()), ask(obj, trajectories, Bayes())
    assert np.array_equal(found(answer).mass, found(plain).mass)
    assert answer.status == "ok"
    assert plain.assumes and not answer.assumes, "one assumes own weight, the other tests it"
    assert answer.diagnostics["log10_bayes_factor"] > 1


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(4))
def test_a_rigid_body_is_answered_by_masses_that_agree_with_what_is_known(seed):
    obj = drawn_object(seed)
    answer = aware(obj)
    whole = ObjectModel("answer", obj.shape, MassDistribution(found(answer).mass, obj.truth.friction))
    assert answer.status == "assumption_violated"
    assert_allclose(whole.total_mass, obj.total_mass, atol=3e-3)
    assert_allclose(whole.center_of_mass, obj.center_of_mass, atol=1e-3)
    # the mean of a polytope may lie anywhere within the errors of I_cm; the measurements themselves show it
    rigid, model = posterior_of(obj.shape, obj.total_mass, data(obj, rigid=True), "rigid"), ParticleModel.of(obj.shape)
    assert rigid is not None
    shown = inertia_of(model, model.particle_mass(torch.tensor(np.linalg.lstsq(*rigid.mass_equations())[0])))
    assert_allclose(shown.about_com, obj.inertia_cm, rtol=0.005)
    assert_allclose(found(answer).friction, obj.truth.friction, rtol=0.01)
    assert (np.abs(found(answer).mass - obj.truth.mass) < 3.5 * claimed(answer)).all()
    assert holds(answer, obj.group_mass, 1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("share", [0.3, 0.6, 0.9])
def test_between_the_two_supports_it_says_so_and_its_errors_hold(share):
    obj = drawn_object(5)
    answer = ask(obj, joined(obj, share), SupportAware())
    assert answer.status in ("unexplained", "assumption_violated")
    off = (found(answer).mass - obj.truth.mass) / claimed(answer)
    assert np.abs(off).max() < 3, off
    if share < 0.9:  # there it is nearly one rigid body
        assert nad(obj, answer) < 0.5 * nad(obj, ask(obj, joined(obj, share), Bayes()))


@pytest.mark.slow
@pytest.mark.parametrize("stiffness", ["300", "1000", "3000"])
def test_springs_between_blocks_are_found_in_simulation(stiffness):
    obj = load_object("F2")
    with SimulationRunner() as simulation:
        turned: list[Trajectory] = []
        policy = RankDriven(pivots=6, duration=4.0, accelerated=3)
        while (action := policy.next(obj.shape, turned)) is not None:
            turned.append(simulation.run(Trial(obj, action, parse_support(stiffness))))
    answer = ask(obj, turned, SupportAware())
    assert answer.status == "assumption_violated" and "springs between the groups" in answer.message
    stiff = float(stiffness) / foot_stiffness(obj, ContactSettings()) * mean_work(obj)
    share, error = (answer.diagnostics[name] for name in ("rigid_share", "rigid_share_error"))
    assert abs(share - stiff / (1 + stiff)) < 2.5 * error < 0.5
    assert nad(obj, answer) < 0.5 * nad(obj, ask(obj, turned, Bayes()))
    assert (np.abs(found(answer).mass - obj.truth.mass) < 3 * claimed(answer)).all()


@pytest.mark.slow
@pytest.mark.parametrize("rigid", [True, False])
@pytest.mark.parametrize("name", ["L2", "I1", "F2"])
def test_two_materials_make_it_a_finite_search(name, rigid):
    obj = load_object(name)
    answer = aware(obj, materials_kg=MATERIALS, rigid=rigid)
    assert_allclose(found(answer).mass, obj.truth.mass, rtol=1e-9)
    assert answer.diagnostics["assignment_probability"] > 0.5


@pytest.mark.slow
def test_densities_are_masses_of_the_groups_volume():
    obj = load_object("L2")
    volume = obj.shape.particles_per_group[0] * obj.shape.cell**2 * obj.shape.height
    dense = aware(obj, materials_kg_m3=tuple(m / volume for m in MATERIALS))
    assert_allclose(found(dense).mass, found(aware(obj, materials_kg=MATERIALS)).mass, rtol=1e-9)


@pytest.mark.slow
def test_the_wrong_materials_are_not_forced_on_it():
    obj = load_object("L2")
    answer = aware(obj, materials_kg=(0.15, 0.25))
    assert "no assignment of the materials" in answer.message
    assert_allclose(found(answer).mass, found(aware(obj)).mass)


@pytest.mark.slow
def test_many_assignments_that_fit_are_counted():
    """Sixteen blocks: four numbers cannot tell them."""
    rng = np.random.default_rng(3)
    obj = blocks(["10101010", "10101010", "11111111"], rng.choice(MATERIALS, 16).tolist())
    trajectories = data(obj, rigid=True, noise=1.0)
    answer = ask(obj, trajectories, SupportAware(materials_kg=MATERIALS))
    assert answer.diagnostics["assignments_holding_90"] > 1
    assert "assignments of the materials hold 90 %" in answer.message
    chosen = found(answer).mass * obj.shape.particles_per_group
    assert np.isclose(chosen[:, None], MATERIALS).any(axis=1).tolist() == [True] * 16


def brute(rows: np.ndarray, values: np.ndarray, options: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Every assignment and its probability, one by one."""
    every = np.array(list(product(range(options.shape[1]), repeat=len(options))))
    sums = np.take_along_axis(options[None], every[:, :, None], 2)[..., 0]
    log = -((sums @ rows.T - values) ** 2).sum(axis=1) / 2
    return every, np.exp(log - logsumexp(log))


@pytest.mark.parametrize(("count", "kinds", "rank"), [(1, 2, 1), (6, 2, 4), (7, 3, 4), (9, 2, 9)])
def test_ranking_is_that_of_every_assignment(count, kinds, rank):
    rng = np.random.default_rng(count)
    rows, options = rng.standard_normal((rank, count)), rng.uniform(0.1, 1.0, (count, kinds))
    values = rows @ options[:, 0] + 0.3 * rng.standard_normal(rank)
    every, probability = brute(rows, values, options)
    order = np.argsort(-probability)
    ranked = rank_assignments(rows, values, options)
    assert np.array_equal(ranked.material[:5], every[order[:5]])
    assert_allclose(ranked.probability[:5], probability[order[:5]], rtol=1e-6)
    many = ranked.holding(0.9)
    assert many == np.searchsorted(np.cumsum(probability[order]), 0.9) + 1


def test_twenty_blocks_are_ranked_and_more_are_refused():
    rng = np.random.default_rng(0)
    rows = np.vstack([1e3 * np.ones(20), 30 * rng.standard_normal((3, 20))])
    true = rng.integers(0, 2, 20)
    values = rows @ np.array(MATERIALS)[true]
    ranked = rank_assignments(rows, values, np.tile(MATERIALS, (20, 1)))
    assert np.array_equal(ranked.material[0], true)
    assert ranked.misfit < 1e-9
    with pytest.raises(InvalidValueError, match="materials"):
        rank_assignments(np.ones((1, 21)), np.ones(1), np.tile(MATERIALS, (21, 1)))


def test_a_polytope_of_one_number_is_a_simplex():
    """M alone: the mean is even, a group's variance that of a flat Dirichlet, and each may have all or nothing."""
    polytope = MassPolytope(np.full((1, 4), 1e4), np.array([1e4]))
    mean, covariance = polytope.posterior(0)
    low, high = polytope.ranges(0.9)
    assert_allclose(mean, 0.25, atol=0.01)
    assert_allclose(np.sqrt(np.diag(covariance)), np.sqrt(3 / 80), rtol=0.05)
    assert_allclose(low, 0, atol=1e-3)
    assert_allclose(high, 1, atol=1e-3)
    assert polytope.inside[1] < 1e-6


def test_a_polytope_of_full_rank_is_a_gaussian():
    rng = np.random.default_rng(1)
    rows = 50 * rng.standard_normal((5, 3))
    truth = np.array([1.0, 2.0, 3.0])
    left, strength, right = np.linalg.svd(rows, full_matrices=False)
    polytope = MassPolytope(strength[:, None] * right, left.T @ (rows @ truth))
    mean, covariance = polytope.posterior(0)
    assert_allclose(mean, truth, atol=0.01)
    assert_allclose(covariance, np.linalg.inv(rows.T @ rows), rtol=0.15, atol=1e-5)


def test_numbers_that_no_masses_have_are_shown_to_miss():
    impossible = MassPolytope(np.array([[100.0, 100.0], [0.0, 100.0]]), np.array([100.0, -50.0]))
    assert impossible.inside[1] > 3
    low, high = impossible.ranges(0.9)
    assert (low <= high + 1e-9).all()
    assert (impossible.posterior(0)[0] >= 0).all()
