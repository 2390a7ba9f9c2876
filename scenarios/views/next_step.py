"""Next step after an estimate from measured trials, as a sentence."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from estimators.action_selection.design import ASSUMED_SUPPORTS, Guess
from estimators.action_selection.online import OnlinePolicy
from estimators.base import Estimate
from estimators.evaluation.statistics import Row
from estimators.identifiability.information import SUPPORTS
from estimators.particles.misfit import UNEXPLAINED
from scenarios.results.estimates import load_estimate
from scenarios.results.table import has_files
from scenarios.results.trials import trials_behind
from scenarios.views.weight_check import check_weight
from testbed.objects.model import ObjectShape
from testbed.robot.calibration.motion import wrong_motion
from testbed.sensing.presets import preset
from testbed.sensing.windows import weight_of
from testbed.trajectory import Trajectory
from viz.report.answers import Answer

ENOUGH = 0.02
"""Expected NAD below which no further trial is proposed."""
CANDIDATES = 60
"""Actions among which the next one is chosen."""


def next_step(folder: Path, rows: Sequence[Row], answer: Answer) -> str:
    """Next step after an answer, in a sentence: look for an error, weigh again, make one more trial, or stop.

    The proposed trial gains most information per second among the planner's candidates; whether the arm can reach it
    is not checked.

    Args:
        folder: results folder.
        rows: rows of results.parquet, with that of the answer.
        answer: answer of one method on one object.

    Raises:
        HeftError: a file of the folder is damaged.
    """
    identity = (answer.object, answer.support, answer.method)
    row = next(row for row in rows if has_files(row) and (row["object"], row["support"], row["method"]) == identity)
    found = load_estimate(folder, row["key"])
    if not answer.shape.grasps:
        return "next: nothing: the object has no grasp, so no turn can be planned"
    shape, (weighing, *trials) = answer.shape, trials_behind(folder, row)
    if error := _error_of_trials(folder, found, shape, weighing, trials):
        return f"next: {error}"
    supports = SUPPORTS if answer.evidence else ASSUMED_SUPPORTS.get(answer.support, SUPPORTS[:1])
    guess = Guess(weight_of(weighing), preset("ft300s").stated, supports=supports)
    stored: Any = SimpleNamespace(estimate=lambda *_: found)
    policy = OnlinePolicy(guess, candidates=CANDIDATES, estimator=stored)
    decision = policy.decide(shape, trials)
    expected = f"the expected error of the masses, taken together, is {100 * decision.nad:.2g} % of the whole"
    note = f"; {found.message}" if found.status == "ok" and found.message else ""
    if decision.action is None or (decision.answered and decision.nad < ENOUGH):
        if decision.answered and all(trial.setup.none for trial in trials):
            return (
                f"next: {expected}, if contacts, friction, grasps, arm and sensor are exact, as the trials state them: "
                f'[setup] preset = "lab" has the errors of a usual lab{note}'
            )
        return f"next: nothing more is needed: {expected}{note}" if decision.answered else f"next: {decision.why}"
    worst = [shape.group_names[g] for g in np.argsort(-decision.standard_error)[:2]]
    trial = f"next: {decision.action.describe(shape)}: it would teach most; {' and '.join(worst)} are known least"
    return f"{trial}, {expected}{note}" if decision.answered else f"{trial}; the trials give no answer yet"


def _error_of_trials(
    folder: Path, found: Estimate, shape: ObjectShape, weighing: Trajectory, trials: Sequence[Trajectory]
) -> str:
    """Description of an error of the trials (motion, weight or residual); empty without an error."""
    if wrong := wrong_motion(shape, trials):
        return f"the trials are not what their actions say: {'; '.join(wrong)}"
    weight = check_weight(shape, weight_of(weighing), trials, found)
    if weight is not None and not weight.ok:
        return weight.text
    if found.diagnostics.get("misfit", 1.0) > UNEXPLAINED or found.status in ("unexplained", "contradictory"):
        return f"the masses do not explain the trials: heft doctor {folder} says what would, and what to check"
    return ""
