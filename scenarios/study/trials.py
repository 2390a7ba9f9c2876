"""Trials of a scenario: those that each experiment's policy asks for, and turns held out for prediction."""

from __future__ import annotations

from collections import deque
from dataclasses import asdict, dataclass, field

from scenarios.execution.executor import Executor, Failure
from scenarios.results.store import Store, key_of, object_request, trial_request
from scenarios.results.trials import sensed
from scenarios.runners import NamedRunner, RunnerSettings
from scenarios.study.experiment import Experiment, Progress, ResultCallback
from testbed.actions.base import Action
from testbed.actions.weigh import Weigh
from testbed.errors import HeftError, InfeasibleTrialError
from testbed.trajectory import TrajectoryFileError
from testbed.trial import Trial

FEET_RATE = 10.0
"""Rate at which the table's forces on the feet are kept, for the viewer [Hz]."""


def run_trials(
    experiments: list[Experiment],
    store: Store,
    executor: Executor,
    progress: Progress,
    on_result: ResultCallback | None = None,
) -> None:
    """Make the trials of some experiments side by side, in order within each; one that two need is made once.

    The policy learns which actions are refused at the true masses, and chooses others. An experiment whose trial fails
    for good, or whose policy asks again for a refused action, has the reason in `failure`, and goes no further.
    """
    expected = sum(experiment.scenario.policy.expected_trials for experiment in experiments)
    waiting, run = deque(experiments), _Run(store, executor)
    while waiting or executor.running:
        while waiting and run.active < executor.capacity:  # the driver holds the trajectories of these and no others
            run.begin(waiting.popleft())
        if executor.running:
            key, refusal = executor.wait()
            if on_result is not None and refusal == "":
                on_result("trial", key)
            run.end(key, refusal)
        failed = sum(bool(experiment.failure) for experiment in experiments)
        progress("trials", run.done, max(run.done + executor.running, expected), failed)
    progress("trials", run.done, run.done, sum(bool(experiment.failure) for experiment in experiments))


@dataclass(eq=False)
class _Run:
    """Experiments under way, and the trials that they wait for."""

    store: Store
    executor: Executor
    active: int = 0
    """Experiments begun and not yet done or given up."""
    done: int = 0
    """Trials done."""
    asking: dict[str, list[tuple[Experiment, Action]]] = field(default_factory=dict)
    """Experiments that wait for each trial in flight, and the action that it makes."""

    def begin(self, experiment: Experiment) -> None:
        if _recalled(experiment, self.store):
            self.done += len(experiment.keys) + len(experiment.held_out_keys)
        else:
            self.active += 1
            self._go_on(experiment, Weigh())

    def end(self, key: str, refusal: str | Failure) -> None:
        """Take the end of a trial: made where `refusal` is empty."""
        for experiment, action in self.asking.pop(key):
            if refusal == "":
                self._go_on(experiment, action)
            elif isinstance(refusal, Failure):
                self._give_up(experiment, f"{action.kind}: {refusal.reason}")
                self.store.put_trial_error(key, refusal.detail)
            else:
                experiment.refused[action] = refusal
                self._go_on(experiment, self._next_action(experiment))

    def _go_on(self, experiment: Experiment, action: Action | None) -> None:
        """From this action on, take the trials that are there, and start the first that is not."""
        while action is not None:
            trial, settings = (
                Trial(experiment.model, action, experiment.support),
                experiment.scenario.simulation.build(),
            )
            key = key_of(trial_request(trial, settings))
            if not (self.store.has_trial(key) and _taken(experiment, action, key, self.store)):
                self.asking.setdefault(key, []).append((experiment, action))
                if len(self.asking[key]) == 1:
                    self.executor.start(key, _tried, trial, settings, self.store)
                return
            self.done += 1
            action = self._next_action(experiment)
        if not experiment.failure:
            self.store.put_note(_key_of(experiment), {"keys": experiment.keys, "held_out": experiment.held_out_keys})
            self.active -= 1

    def _next_action(self, experiment: Experiment) -> Action | None:
        """Next action; a policy that cannot go on ends its own experiment."""
        try:
            action = experiment.next_action()
        except HeftError as error:
            self._give_up(experiment, f"policy: {error}")
            return None
        if action in experiment.refused:
            self._give_up(experiment, f"{action.kind}: {experiment.refused[action]}")
            return None
        return action

    def _give_up(self, experiment: Experiment, why: str) -> None:
        experiment.failure = why
        experiment.trajectories.clear()
        self.active -= 1


def _taken(experiment: Experiment, action: Action, key: str, store: Store) -> bool:
    """Take a finished trial into the experiment; False where its file is damaged and it has to be made again."""
    try:
        trajectory = store.trajectory(key)
    except TrajectoryFileError:
        return False
    if experiment.finished:
        experiment.held_out_keys.append(key)
        return True
    if action.moves:
        experiment.trajectories.append(
            sensed(trajectory, *experiment.draw, len(experiment.keys), key) if experiment.draw else trajectory
        )
    experiment.keys.append(key)
    return True


def _recalled(experiment: Experiment, store: Store) -> bool:
    """Take all trials of an experiment from an earlier run; False where some are missing."""
    note = store.note(_key_of(experiment))
    if note is None or not all(store.has_sound_trial(key) for key in note["keys"] + note["held_out"]):
        return False
    experiment.keys, experiment.held_out_keys = note["keys"], note["held_out"]
    return True


def _key_of(experiment: Experiment) -> str:
    request = {
        "object": object_request(experiment.model),
        "particles": object_request(experiment.particles),
        "support": experiment.support.name,
        "policy": experiment.scenario.policy.request(),
        "grasps": list(experiment.grasps),
        "held_out": [turn.to_dict() for turn in experiment.turns],
        "simulation": asdict(experiment.scenario.simulation.build()),
    }
    return key_of(request | ({"felt": list(experiment.draw)} if experiment.draw else {}))


def _tried(trial: Trial, settings: RunnerSettings, store: Store) -> str:
    """Worker's task: one trial; the reason why it was refused, or empty where it is made."""
    try:
        simulate(trial, settings, store)
    except InfeasibleTrialError as error:
        return str(error)
    return ""


def simulate(trial: Trial, settings: RunnerSettings, store: Store) -> None:
    """One physical trial, unless it is done.

    Raises:
        InfeasibleTrialError: it was refused; nothing has moved.
    """
    request = trial_request(trial, settings)
    key = key_of(request)
    if store.has_trial(key):
        return
    from testbed.simulation.runner import SimulationRunner  # noqa: PLC0415  without MuJoCo until it is needed

    feet = None
    if isinstance(settings, NamedRunner):
        trajectory = settings.run(trial)
    elif not trial.action.moves:
        trajectory = SimulationRunner(settings).run_clean(trial)
    else:
        runner = SimulationRunner(settings)
        trajectory, contacts = runner.run_with_contacts(trial, every=round(settings.rate / FEET_RATE))
        feet = contacts.foot_forces(trajectory.time_s)
    store.put_trial(key, trial, request, trajectory, feet)
