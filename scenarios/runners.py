"""Runners of a scenario's trials: heft's simulation, or a `TrialRunner` of another package by name."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from estimators.action_selection.design import Guess
from testbed.actions.accelerate import Accelerate
from testbed.actions.base import Action
from testbed.actions.rotate import Rotate
from testbed.errors import HeftError, InfeasibleTrialError, InvalidValueError
from testbed.objects.model import ROBOTIQ_2F85, ObjectModel, ObjectShape
from testbed.plugins import RUNNER, configured, find_class, placed_errors, source_hash
from testbed.sensing.compensation import tare_samples
from testbed.simulation.settings import SimulationSettings
from testbed.trajectory import Trajectory
from testbed.trial import RIGID, Trial, TrialRunner


@dataclass(frozen=True, eq=False)
class NamedRunner:
    """Runner by "package:Class" or entry point: all that determines its trials, as plain data."""

    runner: str
    """Name of its class."""
    settings: dict[str, Any]
    """Arguments of its class."""
    source: str
    """Hash of its source."""

    @staticmethod
    def of(runner: str, settings: Mapping[str, Any]) -> NamedRunner:
        """The runner, with its source as it is now.

        Raises:
            InvalidValueError: no such runner.
        """
        return NamedRunner(runner, dict(settings), source_hash(find_class(runner, RUNNER, "runner")))

    def open(self) -> TrialRunner:
        """The runner, not yet entered.

        Raises:
            InvalidValueError: an unknown setting, or a value that the class refuses.
        """
        return configured(find_class(self.runner, RUNNER, "runner"), self.settings, "settings")

    def check(self, trial: Trial) -> None:
        """Call the runner's own `check`, where it has one.

        Raises:
            InfeasibleTrialError: as `run` would.
        """
        check = getattr(self.open(), "check", None)
        if check is not None:
            check(trial)

    def run(self, trial: Trial) -> Trajectory:
        """Run one trial, and check that its record can be used.

        Raises:
            InvalidValueError: no trajectory, or a simulated one on which no sensor's errors can be drawn.
        """
        opened = self.open()
        with placed_errors(type(opened), unless=(HeftError,)), opened as runner:
            record = runner.run(trial)
        if not isinstance(record, Trajectory):
            raise InvalidValueError(f"{self.runner}.run()", record, "a Trajectory of testbed.trajectory")
        done, asked = record.action, trial.action  # which may be clipped
        if (done.kind, done.grasp) != (asked.kind, asked.grasp):
            raise InvalidValueError(f"{self.runner}.run().action", done, f"the trial's own: {asked}")
        if record.is_clean and asked.moves:
            if record.tool is None:
                allowed = "the Tool below the sensor, whose errors are drawn on a simulated record with its tool"
                raise InvalidValueError(f"{self.runner}.run().tool", None, allowed)
            if not len(tare_samples(record)):
                raise InvalidValueError(f"{self.runner}.run().phase", "no sample of TARE", "a tare before the grip")
        return record


RunnerSettings = SimulationSettings | NamedRunner


def check_trial(trial: Trial, settings: RunnerSettings) -> None:
    """Raise InfeasibleTrialError if a runner cannot do a trial."""
    if isinstance(settings, NamedRunner):
        settings.check(trial)
    else:
        from testbed.simulation.runner import SimulationRunner  # noqa: PLC0415  without MuJoCo until it is needed

        SimulationRunner(settings).check(trial)


@dataclass(frozen=True)
class FeasibilityCheck:
    """Feasibility of an action before it is run: grip, clearance, reach, joints, torques and speeds.

    The check uses an object of uniform mass, since the truth is unknown: a trial may still be refused when it is run,
    and is then in `refused`. The object is one rigid body here: feasibility does not depend on how it rests.
    """

    shape: ObjectShape
    guess: Guess
    settings: RunnerSettings = field(default_factory=SimulationSettings)
    refused: Mapping[Action, str] = field(default_factory=dict, compare=False)
    """Actions that were refused when they were run, and why; grows as trials are made."""

    def __call__(self, action: Action) -> str:
        """Reason why the robot cannot do an action; empty where it can."""
        if action in self.refused:
            return self.refused[action]
        try:
            model = ObjectModel("guess", self.shape, self.guess.uniform(self.shape), masses_known=False)
            check_trial(Trial(model, action, RIGID), self.settings)
        except InfeasibleTrialError as error:
            return str(error)
        return ""


def feasible_grasps(name: str, check: FeasibilityCheck) -> tuple[int, ...]:
    """Grasps about which the robot can turn an object at constant and at changing speed.

    Args:
        name: name of the object.
        check: shape, weight as read and an upper friction; the true masses may still have a turn refused.

    Raises:
        InfeasibleTrialError: there is none; the message gives the reason of each.
    """
    possible, reasons = [], []
    for index, grasp in enumerate(check.shape.grasps):
        if why := check(Rotate(index)) or check(Accelerate(index)):
            reasons.append(f"{grasp.name}: {why}")
        else:
            possible.append(index)
    if not possible:
        why = "\n  ".join(reasons) or ROBOTIQ_2F85.nothing
        rigid = check.shape.chain is None  # nothing pushes links
        pushed = '; it can be pushed: kind = "push", or pushes = N, in [policy]' if rigid else ""
        raise InfeasibleTrialError(f"{name}: the bench cannot turn this object about any grasp{pushed}\n  {why}")
    return tuple(possible)


def redacted(refusal: str) -> str:
    """Refusal of a trial for a policy: the limit, without the numbers, which come from the true masses."""
    return f"{refusal.partition(':')[0]}: refused by the bench"
