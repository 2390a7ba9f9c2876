"""What the bench says of an action, before it is planned: asked at guessed masses and friction."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from estimators.design import Guess
from scenarios.benches import BenchSettings, check_trial
from testbed.actions import Action
from testbed.errors import InfeasibleTrialError
from testbed.objects import ObjectModel, ObjectShape
from testbed.simulation.settings import SimulationSettings
from testbed.trial import RIGID, Trial


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
