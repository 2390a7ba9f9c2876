"""Who makes a scenario's trials: heft's simulated bench, or a `TrialRunner` of somebody else's."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from estimators.action_selection.design import Guess
from testbed.actions.base import Action
from testbed.errors import InfeasibleTrialError, InvalidValueError
from testbed.objects.model import ObjectModel, ObjectShape
from testbed.plugins import RUNNER, configured, find_class, source_hash
from testbed.simulation.runner import SimulationRunner
from testbed.simulation.settings import SimulationSettings
from testbed.trajectory import Trajectory
from testbed.trial import RIGID, Trial, TrialRunner


@dataclass(frozen=True, eq=False)
class OtherBench:
    """A runner by "package:Class" or entry point: all that decides its trials, as plain data."""

    runner: str
    settings: dict[str, Any]
    """Arguments of its class."""
    source: str
    """Hash of its source."""

    @staticmethod
    def of(runner: str, settings: Mapping[str, Any]) -> OtherBench:
        """The bench, with its source as it is now.

        Raises:
            InvalidValueError: no such runner.
        """
        return OtherBench(runner, dict(settings), source_hash(find_class(runner, RUNNER, "runner")))

    def open(self) -> TrialRunner:
        """The runner, not yet entered.

        Raises:
            InvalidValueError: an unknown setting, or a value that the class refuses.
        """
        return configured(find_class(self.runner, RUNNER, "runner"), self.settings, "settings")

    def check(self, trial: Trial) -> None:
        """What the runner's own `check` says; nothing where it has none.

        Raises:
            InfeasibleTrialError: as `run` would.
        """
        check = getattr(self.open(), "check", None)
        if check is not None:
            check(trial)

    def run(self, trial: Trial) -> Trajectory:
        """Run one trial, and look whether what comes back can be used.

        Raises:
            InvalidValueError: no trajectory, or a simulated one that errors of a sensor cannot be drawn on.
        """
        with self.open() as runner:
            record = runner.run(trial)
        if not isinstance(record, Trajectory):
            raise InvalidValueError(f"{self.runner}.run()", record, "a Trajectory of testbed.trajectory")
        simulated = record.provenance.get("runner") == "simulation"
        if simulated and record.tool is None and trial.action.moves:
            allowed = (
                "the Tool below the sensor: a sensor's errors are drawn on a simulated record before the tool is off"
            )
            raise InvalidValueError(f"{self.runner}.run().tool", None, allowed)
        return record


BenchSettings = SimulationSettings | OtherBench


def check_trial(trial: Trial, settings: BenchSettings) -> None:
    """Raises InfeasibleTrialError where a bench says beforehand that it cannot do a trial."""
    bench = settings if isinstance(settings, OtherBench) else SimulationRunner(settings)
    bench.check(trial)


@dataclass(frozen=True)
class BenchCheck:
    """Grip, clearance, reach and joints over the whole sweep, working torques, speeds: as before a trial is run.

    The truth is not known, so it is asked of an object of uniform mass: a trial may still be refused when it is run,
    which then is in `refused`. It is one rigid body here, since how it rests is no matter of the action.
    """

    shape: ObjectShape
    guess: Guess
    settings: BenchSettings = field(default_factory=SimulationSettings)
    refused: Mapping[Action, str] = field(default_factory=dict, compare=False)
    """What was refused when it was run, and why; grows as trials are made."""

    def __call__(self, action: Action) -> str:
        """Empty where the bench can do it, or why it cannot."""
        if action in self.refused:
            return self.refused[action]
        try:
            model = ObjectModel("guess", self.shape, self.guess.uniform(self.shape))
            check_trial(Trial(model, action, RIGID), self.settings)
        except InfeasibleTrialError as error:
            return str(error)
        return ""
