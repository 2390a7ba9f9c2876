"""Bias, grasp offset and friction anisotropy as unknowns beside the masses, in a world of exact Coulomb friction."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
import torch
from numpy.testing import assert_allclose

from estimators.hidden_states.estimator import HiddenStates
from estimators.hidden_states.friction import closed_form_covariance
from estimators.hidden_states.masses import friction_loads
from estimators.hidden_states.nuisance import UNKNOWNS, NuisanceLayout, NuisancePrior, NuisanceSystem, corrected
from estimators.hidden_states.trial_windows import TrialWindows
from estimators.particles.friction_system import LoadGroups
from estimators.particles.observe import observe
from estimators.testing.analytic_world import accelerated, analytic_trial, drawn_object, turns
from estimators.wrench.model import ModelErrors, ParticleModel
from testbed.actions.rotate import Rotate
from testbed.objects.files import load_object
from testbed.objects.model import ObjectModel
from tests.fakes.flawed_bench import ANISOTROPY, at_tcp, biased, held_beside, on_anisotropic_table
from tests.helpers.answers import ask, found, nad

EXACT = HiddenStates(
    pivot_error=0.0,
    force_error=0.0,
    torque_error=0.0,
    height_error=0.0,
    lift_error=0.0,
    inertia_error=0.0,
    refinements=6,
    offset_error=0.01,
)
"""In this world there are no other errors."""
BIAS = np.array([0.2, -0.15, 0, 0, 0, 0.01])


def flawed(obj: ObjectModel, kinds: tuple[str, ...], seed: int = 0, noise: float = 0.0) -> tuple[list, np.ndarray]:
    """Turns there and back about three points in every grasp, and the true offset of each."""
    rng = np.random.default_rng(seed)
    trials, offsets = [], []
    for grasp in range(len(obj.shape.grasps)):
        for beside in obj.shape.cell / 2 * np.array([(1, 1), (-3, 1), (1, -5)]):
            point = obj.shape.grasps[grasp].position + beside
            action = Rotate(grasp, duration=4.0, pivot=(float(point[0]), float(point[1])), back=True)
            offset = 0.002 * rng.uniform(-1, 1, 2) if "grasp_offset" in kinds else np.zeros(2)
            trial = held_beside(obj, action, offset, noise=noise, seed=len(trials) + 100 * seed)
            trial = replace(trial, action=action)
            if "anisotropy" in kinds:
                trial = on_anisotropic_table(obj, trial, *ANISOTROPY, offset=offset)
            if "bias" in kinds:
                trial = biased(trial, BIAS * rng.uniform(-1, 1, 6))
            trials.append(trial)
            offsets.append(offset)
    return trials, np.array(offsets)


@pytest.mark.parametrize("kinds", [(kind,) for kind in UNKNOWNS] + [UNKNOWNS])
@pytest.mark.parametrize(
    "obj", [pytest.param(load_object("L2"), id="L2", marks=pytest.mark.slow), pytest.param(drawn_object(2), id="drawn")]
)
def test_unknowns_of_the_setup_are_recovered_with_the_masses(obj, kinds):
    trials, offsets = flawed(obj, kinds)
    answer = ask(obj, trials, replace(EXACT, unknown=kinds))
    numbers = answer.diagnostics
    assert nad(obj, answer) < 1e-3
    unaware = ask(obj, trials)
    assert unaware.status == "contradictory" or nad(obj, unaware) > 3e-3
    assert answer.identifiability is not None
    assert len(answer.identifiability.bench) == len(kinds)
    assert all(sentence.endswith("seen") for sentence in answer.identifiability.bench)
    if "grasp_offset" in kinds:
        names = [f"grasp_offset_{trial}_{axis}_m" for trial in range(len(trials)) for axis in "xy"]
        assert_allclose([numbers[name] for name in names], offsets.ravel(), atol=2e-5)
    if "anisotropy" in kinds:
        assert_allclose((numbers["friction_ratio"], numbers["friction_axis_rad"]), ANISOTROPY, rtol=2e-3)


def test_the_bias_of_every_trial_is_found():
    obj = load_object("I2")
    trials = [biased(t, k * BIAS) for k, t in enumerate(turns(obj))]
    numbers = ask(obj, trials, replace(EXACT, unknown=("bias",))).diagnostics
    for k in range(len(trials)):
        given = [numbers[f"bias_{k}_{axis}"] for axis in ("fx_N", "fy_N", "tz_Nm")]
        assert_allclose(given, at_tcp(trials[k], k * BIAS)[[0, 1, 5]], atol=1e-5)
        assert 0 < numbers[f"bias_{k}_fx_N_error"] < 1e-3


def test_one_way_a_bias_passes_for_friction():
    obj = load_object("L2")
    one_way = [analytic_trial(obj, replace(t.action, back=False)) for t in turns(obj) if isinstance(t.action, Rotate)]
    asked = replace(EXACT, unknown=("bias",))
    answer = ask(obj, one_way, asked)
    assert answer.status == "underdetermined"
    assert answer.distribution is None
    assert "one way" in answer.message
    errors = [value for name, value in answer.diagnostics.items() if name.endswith("_error")]
    assert len(errors) == 3 * len(one_way)
    assert np.isinf(errors).all()
    assert answer.identifiability is not None
    assert np.isinf(answer.identifiability.standard_error).all()
    assert "bias of trials 0, 1, 2, 3 and 4 not at all" in answer.identifiability.sentence
    # among turns there and back the friction is known, and so is what one way shows beyond it
    mixed = ask(obj, [*turns(obj), biased(one_way[0], BIAS)], asked)
    assert nad(obj, mixed) < 1e-3
    assert_allclose(mixed.diagnostics["bias_5_fx_N"], at_tcp(one_way[0], BIAS)[0], atol=1e-4)


def test_an_offset_that_is_not_seen_is_said_to_be_as_open_as_before():
    obj = load_object("F2")
    answer = ask(obj, turns(obj) + accelerated(obj), replace(EXACT, unknown=UNKNOWNS, offset_error=1e-6))
    assert answer.identifiability is not None
    assert "grasp offset of trials 0, 1, 2 and 3 no closer" in answer.identifiability.sentence
    assert np.isinf(answer.diagnostics["grasp_offset_0_x_m_error"])
    assert answer.hidden is not None
    assert "grasp offset of trials 0, 1, 2 and 3 no closer" in answer.hidden.unobserved
    assert "bias" not in answer.hidden.unobserved


OBJECT = drawn_object(0)
LOADS = friction_loads(OBJECT.shape, LoadGroups.of(ParticleModel.of(OBJECT.shape)).pairs, OBJECT.truth)


def linear(prior: NuisancePrior, kept: float = 1.0) -> tuple[NuisanceSystem, TrialWindows]:
    """The system about a setup with some of every unknown, and its windows."""
    errors = ModelErrors(pivot_error=1e-4, force_error=1e-3, torque_error=1e-3)
    trials = TrialWindows.of(OBJECT.shape, OBJECT.total_mass, turns(OBJECT, noise=0.05), errors)
    assert trials is not None
    w = trials.windows
    trials = replace(trials, windows=replace(w, lift=kept * w.lift, tilt=kept * w.tilt, load_kept=kept * w.load_kept))
    layout = NuisanceLayout.of(prior, trials.steady)
    at = 0.1 * layout.whole * torch.linspace(-1, 1, len(layout.whole))
    equations = partial(trials.friction_equations, OBJECT.truth)
    return NuisanceSystem.of(equations, trials.steady, layout, at), trials


@pytest.mark.parametrize(("unknown", "kept"), [(UNKNOWNS, 0.0), (("bias",), 1.0)])
def test_slopes_are_those_of_finite_differences(unknown: tuple[str, ...], kept: float):
    # how a load that the gripper carries moves with the grasp is left out
    system, trials = linear(NuisancePrior(unknown), kept)
    layout, apart = system.layout, torch.linalg.inv(system.system.whiten)

    def missing(at: torch.Tensor) -> torch.Tensor:
        equations = trials.friction_equations(OBJECT.truth, corrected(trials.steady, layout.spread(at)))
        return equations.b - equations.q @ torch.tensor(LOADS)

    for k, step in enumerate(1e-5 * layout.whole):
        to = torch.zeros(len(layout.names), dtype=torch.float64)
        to[k] = step
        slope = (missing(system.at + to) - missing(system.at - to)) / (2 * step)
        assert_allclose(apart @ system.slopes[:, k], slope, rtol=1e-5, atol=1e-6 * float(slope.abs().max()))


def test_an_unknown_of_known_size_is_as_good_as_an_error_of_that_size():
    system, _ = linear(NuisancePrior(UNKNOWNS, bias=0.02))
    added = system.slopes @ torch.diag(system.layout.width**2) @ system.slopes.T
    q = system.system.q
    information = q.T @ torch.linalg.solve(torch.eye(len(added), dtype=torch.float64) + added, q)
    assert_allclose(closed_form_covariance(system.reduced()), torch.linalg.inv(information), rtol=1e-6)


@pytest.mark.slow
def test_errors_are_the_scatter():
    obj = drawn_object(2)
    actions = [trial.action for trial in turns(obj)]
    names = [f"bias_{t}_{axis}" for t in range(2) for axis in ("fx_N", "fy_N", "tz_Nm")]
    off = []
    for seed in range(8):
        trials = [analytic_trial(obj, a, noise=0.3, seed=1000 * seed + i) for i, a in enumerate(actions)]  # pyright: ignore[reportArgumentType]
        numbers = ask(obj, trials, replace(EXACT, unknown=("bias",), refinements=1)).diagnostics
        off.append([numbers[name] / numbers[f"{name}_error"] for name in names])
    assert 0.7 < np.sqrt(np.mean(np.square(off))) < 1.3


def test_masses_and_frictions_are_never_negative():
    obj = load_object("F2")
    trials = [biased(t, BIAS) for t in turns(obj, noise=1.0)]
    answer = found(ask(obj, trials + accelerated(obj, noise=1.0), HiddenStates(unknown=UNKNOWNS)))
    assert (answer.mass >= 0).all() and (answer.friction >= 0).all()


def test_without_unknowns_their_spread_and_zero_corrections_change_nothing():
    obj = drawn_object(1)
    trials = turns(obj, noise=0.1) + accelerated(obj, noise=0.1)
    plain, other = (found(ask(obj, trials, m)) for m in (HiddenStates(), HiddenStates(offset_error=0.1)))
    assert np.array_equal(plain.mass, other.mass)
    windows, model = observe(obj.shape, trials), ParticleModel.of(obj.shape)
    assert windows is not None
    same = corrected(windows, torch.zeros(len(windows), 7, dtype=torch.float64))
    assert_allclose(same.drag_rows(model, 1e-4), windows.drag_rows(model, 1e-4), atol=1e-14)
