"""Every method of the registry keeps the rules of the conformance kit; fields of answers are checked when made."""

import math
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from estimators import METHODS, Bayes, DiffLcp, ExplicitState, HiddenStates, Learned, MujocoSysid, SupportAware
from estimators.base import Estimate, Estimator
from estimators.baselines.base import GradientBaseline
from estimators.baselines.lcp import LcpEngine
from estimators.baselines.optimizers import CmaEs, LeastSquares, NelderMead
from estimators.baselines.sampling import RandomSearch, WeightedSampling
from estimators.hidden_states.published import PublishedHiddenStates
from estimators.testing.analytic_world import drawn_object, turns
from estimators.testing.conformance import (
    CONFORMANCE,
    WITHOUT_DRAWS,
    clean_answer,
    does_not_hide_that_trajectories_contradict_each_other,
    small_object,
)
from testbed import InvalidValueError, MassDistribution, load_object


def few_blocks(seed):
    """Four blocks: more masses than a single turn shows."""
    return drawn_object(seed, [["010", "111"], ["100", "111"], ["110", "011"]][seed % 3])


BASELINES = {
    "random_search": RandomSearch(),
    "weighted_sampling": WeightedSampling(),
    "explicit_state": ExplicitState(iterations=60),
    # the rules do not ask how good an answer is, and this one takes long
    "diff_lcp": DiffLcp(iterations=12),
}
PEERS = {"cma_es": CmaEs(iterations=600), "nelder_mead": NelderMead(iterations=600), "least_squares": LeastSquares()}
VARIANTS = {
    "hidden_states": (HiddenStates(), drawn_object),
    "descent": (HiddenStates(solver="descent"), few_blocks),
    "published": (PublishedHiddenStates(), few_blocks),
    "published, exact": (PublishedHiddenStates(solver="closed_form", gripper_load=True), drawn_object),
    "bayes": (Bayes(), few_blocks),
    "support_aware": (SupportAware(), few_blocks),
    "support_aware of materials": (SupportAware(materials_kg=(0.1, 0.4)), few_blocks),
    **{name: (kind, small_object) for name, kind in BASELINES.items()},
    **{f"{name} with M": (replace(kind, use_weight=True), small_object) for name, kind in BASELINES.items()},
    **{name: (kind, small_object) for name, kind in PEERS.items()},
}
SLOW = (
    *("descent", "published", "published, exact", "support_aware", "support_aware of materials"),
    *("weighted_sampling", "explicit_state", "diff_lcp", "cma_es", "nelder_mead"),
    *(f"{name} with M" for name in BASELINES),
)
"""Held by CI alone: each has a quick twin, in method or in one setting."""
DRAWING_NOTHING = (HiddenStates, PublishedHiddenStates, Bayes, GradientBaseline, LeastSquares, SupportAware)
WITHOUT_TRACES = ("hidden_states", "published, exact", "bayes", "support_aware", "support_aware of materials")


def traces_every_iteration(estimator, draw):
    """An iterative method has a loss for every iteration; a peer may end earlier."""
    _, answer = clean_answer(estimator, draw)
    steps = getattr(estimator, "iterations", getattr(estimator, "steps", 0))
    assert answer.traces
    for trace in answer.traces:
        assert len(trace.loss) == steps or (len(trace.loss) < steps and type(estimator) in map(type, PEERS.values()))


def slow(name, holds):
    """True for what CI alone holds; the longest rule has its quick twin in `hidden_states`."""
    longest = holds is does_not_hide_that_trajectories_contradict_each_other
    return name in SLOW or (longest and name != "hidden_states")


RULES = [
    pytest.param(estimator, draw, holds, id=f"{name}-{holds.__name__}", marks=[pytest.mark.slow] * slow(name, holds))
    for name, (estimator, draw) in VARIANTS.items()
    for holds in (
        *CONFORMANCE,
        *(() if name in WITHOUT_TRACES else (traces_every_iteration,)),
        *(WITHOUT_DRAWS if isinstance(estimator, DRAWING_NOTHING) else ()),
    )
]


@pytest.mark.parametrize(("estimator", "draw", "holds"), RULES)
def test_conformance(estimator, draw, holds):
    assert isinstance(estimator, Estimator)
    holds(estimator, draw)


def test_every_method_of_the_registry_is_held_to_the_protocol():
    held = {type(estimator) for estimator, _ in VARIANTS.values()}
    assert set(METHODS.values()) == held | {MujocoSysid, Learned}  # slow: their own tests hold them


WRONG: tuple[tuple[type, dict[str, object], str], ...] = (
    *((kind, {"iterations": 0}, "an integer >= 1") for kind in map(type, BASELINES.values())),
    *((RandomSearch, {"iterations": bad}, "an integer >= 1") for bad in (-3, 2.5, True)),
    *((RandomSearch, {"use_weight": bad}, "true or false") for bad in (1, "yes")),
    (RandomSearch, {"weighting": "none"}, "velocity"),
    *((RandomSearch, {"pivot_error": bad}, ">= 0") for bad in (-1.0, math.nan)),
    (WeightedSampling, {"grid_part": 0.0}, "> 0"),
    (WeightedSampling, {"grid_part": 1.5}, "<= 1"),
    (WeightedSampling, {"decay": 1.1}, "<= 1"),
    (WeightedSampling, {"decay": -0.5}, "> 0"),
    (WeightedSampling, {"first_deviation": 0.0}, "> 0"),
    (WeightedSampling, {"generation": 0}, "an integer >= 1"),
    (WeightedSampling, {"generation": 2.0}, "an integer >= 1"),
    *(
        (kind, {"optimizers": bad}, "adam, rmsprop, plain")
        for kind in (ExplicitState, DiffLcp)
        for bad in ((), ("sgd",))
    ),
    *((kind, {"learning_rate": bad}, "> 0") for kind in (ExplicitState, DiffLcp) for bad in (0.0, math.inf)),
    (DiffLcp, {"weighting": "covariance"}, "velocity"),
    (DiffLcp, {"samples": 0}, "an integer >= 1"),
    (DiffLcp, {"directions": 7}, "even integer >= 4"),
    (DiffLcp, {"substeps": 0}, "an integer >= 1"),
    *((LcpEngine, {"directions": bad}, "even integer >= 4") for bad in (2, 7, 8.0, True)),
    *((LcpEngine, {"substeps": bad}, "an integer >= 1") for bad in (0, 1.5, True)),
    *((HiddenStates, {"optimizers": bad}, "adam, rmsprop, plain") for bad in ((), ("newton",))),
    *((kind, {"solver": "exact"}, "closed_form") for kind in (HiddenStates, PublishedHiddenStates)),
    *((kind, {"steps": 0}, "an integer >= 1") for kind in (HiddenStates, PublishedHiddenStates)),
    (HiddenStates, {"refinements": 0}, "an integer >= 1"),
    (HiddenStates, {"pivot_error": -1.0}, ">= 0"),
    (HiddenStates, {"weight_error": 0.0}, "> 0"),
    (PublishedHiddenStates, {"optimizers": ()}, "adam, rmsprop, plain"),
    (PublishedHiddenStates, {"learning_rate": 0.0}, "> 0"),
    (PublishedHiddenStates, {"gripper_load": 1}, "true or false"),
    (Learned, {"checkpoint": 3}, ""),
    (Learned, {"draws": 2}, ""),
    (MujocoSysid, {"support": "springs"}, ""),
    (MujocoSysid, {"weighting": "velocity"}, ""),
    (MujocoSysid, {"iterations": 0}, ""),
    (Bayes, {"unknown_bias": "no"}, "true or false"),
    (SupportAware, {"materials_kg": (0.1, -1.0)}, "numbers > 0"),
    (SupportAware, {"materials_kg_m3": (1000.0,), "materials_kg": (0.1, 0.4)}, "masses or densities, not both"),
    (SupportAware, {"confidence": 1.0}, "a number > 0 and < 1"),
    (SupportAware, {"false_alarms": 0.0}, "a number > 0 and < 1"),
)


@pytest.mark.parametrize(("kind", "settings", "allowed"), WRONG)
def test_a_wrong_setting_is_refused(kind, settings, allowed):
    (name, given), *_ = settings.items()
    with pytest.raises(InvalidValueError) as refused:
        kind(**settings)
    assert refused.value.field.rpartition(".")[2] == name
    assert repr(given) in str(refused.value)
    assert allowed in refused.value.allowed


@pytest.mark.parametrize("kind", [HiddenStates, PublishedHiddenStates, Bayes, partial(RandomSearch, use_weight=True)])
@pytest.mark.parametrize("weight", [None, 0.0, -1.0, math.nan, 450.0, "1.8"])
def test_no_weight_is_refused(kind, weight):
    obj = drawn_object(0)
    with pytest.raises(InvalidValueError, match=r"^weight:"):
        kind().estimate(obj.shape, weight, turns(obj), 0)
    with pytest.raises(InvalidValueError, match=r"^shape: got ObjectModel.*; allowed: an ObjectShape"):
        kind().estimate(obj, 0.4, turns(obj), 0)


MASSES = MassDistribution(np.array([0.1, 0.2]), np.array([0.5]))


def answer(**fields: Any) -> Estimate:
    return Estimate(**{"distribution": MASSES, "status": "ok"} | fields)


@pytest.mark.parametrize(
    ("fields", "said"),
    [
        ({"status": "fine"}, "Estimate.status: got 'fine'"),
        ({"distribution": np.ones(2)}, "a MassDistribution, or None"),
        ({"distribution": None}, "a MassDistribution where the status is ok"),
        ({"distribution": MassDistribution(np.array([4e300, 0.1]), np.array([0.5]))}, "at most 1000 kg per particle"),
        ({"covariance": np.full((2, 2), np.nan)}, "Estimate.covariance: got '4 NaN'"),
        ({"covariance": np.diag([-1e-4, 1e-4])}, "variances >= 0"),
        ({"covariance": np.array([[1.0, 0.5], [0.0, 1.0]])}, "a symmetric matrix"),
        ({"covariance": np.ones(2)}, r"Estimate.covariance: got 'shape \(2,\)'"),
        ({"covariance": np.ones((2, 3))}, "as many rows as columns"),
        ({"diagnostics": [1.0]}, "a dict of numbers by name"),
        ({"diagnostics": "misfit 1"}, "a dict of numbers by name"),
        ({"diagnostics": None}, "a dict of numbers by name"),
        ({"diagnostics": {"steps": np.ones(3)}}, r"Estimate.diagnostics\['steps'\]"),
        ({"diagnostics": {3: 1.0}}, "a number, by a name"),
        ({"message": None}, "Estimate.message: got None; allowed: text"),
        ({"assumes": 3}, "Estimate.assumes: got 3; allowed: text"),
        ({"seconds": float("nan")}, "Estimate.seconds: got nan"),
        ({"traces": [1]}, "a tuple of Traces"),
        ({"hidden": {}}, "a HiddenStateEstimate, or None"),
        ({"identifiability": "rank 3"}, "an Identifiability, or None"),
    ],
)
def test_a_field_of_another_kind_is_refused_by_its_name(fields: dict[str, Any], said: str):
    with pytest.raises(InvalidValueError, match=said):
        answer(**fields)


def test_what_is_not_observed_may_have_an_infinite_error():
    found = answer(covariance=np.diag([np.inf, -1e-17]), diagnostics={"rank": 1, "left": np.float32(0.5)})
    assert found.covariance is not None
    assert found.covariance.tolist() == [[np.inf, 0.0], [0.0, 0.0]]


def test_masses_and_errors_are_those_of_whole_groups():
    obj = drawn_object(0)
    count, known = obj.shape.particles_per_group, Estimate(obj.truth, "ok", covariance=np.diag(np.full(6, 4e-6)))
    mass, error = known.group_mass(obj.shape), known.group_error(obj.shape)
    assert mass is not None and error is not None
    assert_allclose(mass, obj.group_mass)
    assert_allclose(error, 2e-3 * count)
    with pytest.raises(InvalidValueError, match=r"Estimate.table: got '6 masses, 1 frictions'; allowed: 2 and 2"):
        known.table(load_object("hammer").shape)
    none = Estimate(None, "no_data")
    assert none.group_mass(obj.shape) is None and none.group_error(obj.shape) is None
