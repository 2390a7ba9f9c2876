"""Eight cases that hold the rows, errors and answers of a kind of trial, and the numbers that are kept of each."""

import json
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from estimators import Estimate, build_method, observe
from estimators.hidden_states.trial_windows import TrialWindows
from estimators.identifiability.information import Assumptions, expected
from estimators.particles.lifts import lifts_among
from estimators.particles.wrench import predicted_wrenches
from estimators.testing.analytic_world import analytic_trial, drawn_object, turns
from estimators.testing.recorded import load_block
from estimators.wrench.model import RIGID, ModelErrors
from scenarios.config import Sweep, load_scenario
from scenarios.study.run import run_scenario
from testbed import Accelerate, Lift, ObjectModel, Push, Rotate, Slide, Trajectory, faces, preset, world
from testbed.sensing.camera import CAMERAS, draw_camera
from testbed.worlds.setup_errors import EXACT_SETUP, SetupErrors
from tests.fakes.analytic_links import analytic_links, drawn_chain
from tests.fakes.analytic_push import analytic_pushes
from tests.fakes.lifted_world import lifted
from tests.helpers.answers import shown_in_the_air
from tests.helpers.runs import quiet

LAB, ROUGH = world("lab").stated, world("rough").stated
Frozen = dict[str, np.ndarray]


@dataclass(frozen=True, eq=False)
class Case:
    """Trials of one object, whose actions are predicted too, and the methods whose answers are kept."""

    model: ObjectModel
    trials: list[Trajectory]
    methods: tuple[str, ...]
    support: str = "own_weight"


def recorded(block: str, kinds: tuple[type, ...], setup: SetupErrors, *methods: str) -> Case:
    """Trials of some kinds of a known block, which stays as it is whatever the simulator does."""
    known = load_block(block)
    trials = [replace(t, setup=setup) for t in known.trials("ft300s", 3) if isinstance(t.action, kinds)]
    return Case(known.model, trials, methods, known.support)


def slid() -> Case:
    obj = drawn_object(2)
    actions = [Slide(g, direction) for g, direction in ((0, 0.3), (1, 2.0), (0, -1.2))]
    trials = [analytic_trial(obj, a, lift=0.2, moment=(0.01, -0.02), noise=0.05, seed=i) for i, a in enumerate(actions)]
    trials += turns(obj, [0, 1], noise=0.05)
    return Case(obj, [replace(t, setup=LAB) for t in trials], ("hidden_states",))


def in_the_air() -> Case:
    obj = drawn_object(1)
    trials = [lifted(obj, Lift(0, hold=1.4), errors=1.0, seed=1), *turns(obj, noise=0.05)]
    return Case(obj, [replace(t, setup=LAB) for t in trials], ("support_aware",))


def pushed() -> Case:
    obj = drawn_object(3, ["11", "11", "11"])
    trials = analytic_pushes(obj, [Push.into(face) for face in faces(obj.shape)])
    return Case(obj, seen(trials), ("hidden_states",))


def in_links() -> Case:
    obj = drawn_chain(1)
    last = len(obj.shape.grasps) - 1
    actions = [Slide(0, np.pi / 2, duration=2.5), Slide(last, -np.pi / 2, duration=2.5)]
    actions += [
        Rotate(g, duration=2.5, pivot=tuple((obj.shape.grasps[g].position + 0.015).tolist())) for g in (0, last)
    ]
    return Case(obj, seen([analytic_links(obj, a) for a in actions]), ("hidden_states",))


def seen(trials: list[Trajectory]) -> list[Trajectory]:
    """The trials as a camera of 30 Hz sees them, in a stated lab."""
    made = []
    for index, trial in enumerate(trials):
        assert trial.camera is not None
        made.append(replace(trial, camera=draw_camera(trial.camera, CAMERAS["30hz"], index), setup=LAB))
    return made


CASES: dict[str, Callable[[], Case]] = {
    "turns": lambda: recorded("L2-own_weight", (Rotate,), LAB, "hidden_states"),
    "slides": slid,
    "accelerated": lambda: recorded("I2-own_weight", (Rotate, Accelerate), EXACT_SETUP, "hidden_states"),
    "lifts": in_the_air,
    "pushes": pushed,
    "links": in_links,
    "lab": lambda: recorded("F2-own_weight", (Rotate, Accelerate), LAB, "hidden_states"),
    "rough": lambda: recorded("I2-rigid", (Rotate, Accelerate), ROUGH, "support_aware"),
}


def frozen(case: Case) -> Frozen:
    """Rows, errors, sensitivities and answers of a case, by name."""
    model, shape = case.model, case.model.shape
    errors = RIGID if case.support == "rigid" else ModelErrors()
    found: Frozen = {}
    if shape.stands_in_groups and case.support == "own_weight":
        found |= of_equations(case, errors)
    predicted = predicted_wrenches(shape, model.truth, case.trials)
    found["wrench"] = np.array([np.nanmean(part, axis=0) for part in predicted if np.isfinite(part).any()])
    if lifts_among(shape, case.trials):
        rows, values = shown_in_the_air(shape, model.total_mass, case.trials)
        found["lifts"] = np.column_stack([rows.T @ rows, rows.T @ values])
    sensing = preset("ft300s")
    assumed = Assumptions(case.support, setup=case.trials[0].setup)
    report = expected(shape, model.truth, [t.action for t in case.trials], sensing, assumed)
    found["planned"] = np.append(report.standard_error, report.hinge_error)
    for name in case.methods:
        found |= of_answer(name, build_method(name, {}).estimate(shape, model.total_mass, case.trials, 0))
    return found


def of_equations(case: Case, errors: ModelErrors) -> Frozen:
    """Q, b and their covariance, effects of errors with wide priors, and I_j, at the true masses."""
    model, shape = case.model, case.model.shape
    windows = observe(shape, case.trials, errors)
    assert windows is not None
    trials = TrialWindows.about(shape, model.total_mass, windows, errors)
    equations = trials.friction_equations(model.truth)
    found = {"q": equations.q.numpy(), "b": equations.b.numpy(), "covariance": equations.covariance.numpy()}
    found |= {name: effects.numpy() for name, effects in equations.wide.items()}
    pivots = trials.pivot_inertias(model.truth, trials.friction_loads(model.truth))
    if pivots is not None:
        found |= {"inertia": pivots.inertia, "inertia_covariance": pivots.covariance}
    return found


def of_answer(name: str, answer: Estimate) -> Frozen:
    """Masses, frictions, covariance and misfit of an answer."""
    assert answer.distribution is not None, answer.message
    found = {f"{name}.mass": answer.distribution.mass, f"{name}.friction": answer.distribution.friction}
    if answer.covariance is not None:
        found[f"{name}.covariance"] = answer.covariance
    numbers = sorted(k for k in answer.diagnostics if k == "misfit" or k.startswith("hinge_"))
    return found | {f"{name}.{k}": np.array(answer.diagnostics[k]) for k in numbers}


SWEEPS: dict[str, dict[str, object]] = {
    "blocks": {"objects": ["I2"], "support": ["own_weight"], "seeds": 1},
    "lab_fixed": {"objects": ["L2"], "support": ["own_weight"], "seeds": 1},
    "push": {"random": [], "sensing": ["ft300s"], "seeds": 1, "sweep": Sweep()},
    "articulated": {"sensing": ["ft300s"], "seeds": 1},
}
"""Parts of the library's scenarios."""
METHODS = ("hidden_states", "support_aware")
"""Methods whose answers are frozen: where the search of least_squares ends depends on the rounding of a processor."""
ROW = ("object", "support", "sensing", "method", "status", "nad", "misfit", "hinge_Nm")
"""Columns that are frozen; errors of support_aware come from draws, which rounding changes."""


def rows_of(name: str, out: Path) -> list[dict[str, object]]:
    """Rows of a small run of a scenario of the library."""
    scenario = load_scenario(name)[1]
    methods = {method: settings for method, settings in scenario.methods.items() if method in METHODS}
    changes = {"objects": scenario.objects[:1], "methods": methods} | SWEEPS[name]
    rows = run_scenario(scenario.model_copy(update=changes), out, 0, quiet, executor="inline", secret="goldens")
    return json.loads(str(rows[list(ROW)].to_json(orient="records", double_precision=15)))
