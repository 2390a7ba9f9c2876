"""Trials of a scenario: those that the policy of each experiment chooses, and turns held out for prediction."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from functools import partial

from scenarios.execution.executor import Executor, Failure
from scenarios.results.marks import Marks
from scenarios.results.store import Store, key_of, object_request, trial_request
from scenarios.results.trials import sensed
from scenarios.runners import NamedRunner, RunnerSettings
from scenarios.study.experiment import Experiment, Progress, ResultCallback
from testbed.actions.base import Action
from testbed.actions.weigh import Weigh
from testbed.errors import HeftError, InfeasibleTrialError
from testbed.sensing.windows import weight_of
from testbed.trial import Trial

FEET_RATE = 10.0
"""Rate at which the table's forces on the feet are kept, for the viewer [Hz]."""


@dataclass(eq=False)
class TrialRun:
    """Concurrent trials of some experiments; a trial that two experiments share is made once.

    The known actions of an experiment are made in any order; the policy is asked for each action all the same. It
    receives the actions that are refused at the true masses, and chooses others. An experiment whose trial fails for
    good, or whose policy asks again for a refused action, ends with the reason in `failure`.
    """

    waiting: deque[Experiment]
    """Experiments not yet begun."""
    store: Store
    executor: Executor
    progress: Progress
    ended: Callable[[Experiment], None]
    """Called with each experiment whose trials exist, or that has failed."""
    on_result: ResultCallback | None = None
    marks: Marks = field(default_factory=dict)
    """Marks of the trials that are known to be whole."""
    done: int = 0
    """Trials done."""
    failed: int = 0
    """Experiments that have failed."""
    expected: int = field(init=False)
    """Number of trials where nothing fails and nothing is shared."""
    known: deque[tuple[Experiment, Action, int]] = field(default_factory=deque)
    """Known actions of the started experiments, each with the number of times that its experiment makes it before."""
    asking: dict[str, list[tuple[Experiment, Action]]] = field(default_factory=dict)
    """Experiments that wait for each running trial, and its action, by the key of the trial."""
    refusals: dict[str, str | Failure] = field(default_factory=dict)
    """Reasons why trials were refused or failed, by key."""

    def __post_init__(self) -> None:
        self.expected = sum(each.scenario.policy.expected_trials(each.particles.shape) for each in self.waiting)

    def start(self) -> bool:
        """Start the next known trial or the next experiment; False where there is neither."""
        if self.known:
            experiment, action, repeat = self.known.popleft()
            if not experiment.failure:
                self._start_trial(experiment, action, repeat)
        elif self.waiting:
            self._begin(self.waiting.popleft())
        else:
            return False
        return True

    def _begin(self, experiment: Experiment) -> None:
        if _recalled(experiment, self.store, self.marks):
            self.done += len(experiment.keys) + len(experiment.held_out_keys)
            self._end(experiment)
        else:
            known = experiment.known_actions()
            self.known.extend((experiment, action, known[:place].count(action)) for place, action in enumerate(known))
            self._advance(experiment, Weigh())

    def _start_trial(self, experiment: Experiment, action: Action, repeat: int) -> str:
        """Start a trial unless it is stored, refused or running; return its key.

        `repeat` is the number of times that its experiment makes the action before: a world errs anew each time, and so
        may a runner of another package.
        """
        settings = experiment.scenario.simulation.build()
        seed = repeat if experiment.world is not None or isinstance(settings, NamedRunner) else 0
        trial = Trial(experiment.model, action, experiment.support, seed=seed, world=experiment.world)
        key = key_of(trial_request(trial, settings))
        if not (key in self.asking or key in self.refusals or self.store.has_trial(key)):
            self.asking[key] = []
            self.executor.start(partial(self._take, key), _tried, trial, settings, self.store)
        return key

    def _take(self, key: str, refusal: str | Failure) -> None:
        """Take the outcome of a trial, which is stored where `refusal` is empty."""
        if refusal != "":
            self.refusals[key] = refusal
        elif self.on_result is not None:
            self.on_result("trial", key)
        if isinstance(refusal, Failure):
            self.store.put_error("trials", key, refusal.detail)
        for experiment, action in self.asking.pop(key):
            self._advance(experiment, action)
        self._show()

    def _advance(self, experiment: Experiment, action: Action | None) -> None:
        """Continue an experiment at an action: take the stored trials, and wait for the first that is missing."""
        while action is not None:
            key = self._start_trial(experiment, action, experiment.made.count(action))
            if key in self.asking:
                self.asking[key].append((experiment, action))
                return
            refusal = self.refusals.get(key)
            if isinstance(refusal, Failure):
                experiment.failure = f"{action.kind}: {refusal.reason}"
                break
            if refusal is not None:
                experiment.refuse(action, refusal)
            elif _taken(experiment, action, key, self.store, self.marks):
                self.done += 1
            else:
                continue
            action = _next_action(experiment)
        if not experiment.failure:
            made = {"keys": experiment.keys, "held_out": experiment.held_out_keys}
            self.store.put_note(_key_of(experiment, self.store), made)
        self._end(experiment)

    def _end(self, experiment: Experiment) -> None:
        """End an experiment whose trials exist, or that has failed."""
        self.failed += bool(experiment.failure)
        experiment.trajectories.clear()
        self.ended(experiment)
        self._show()

    def _show(self) -> None:
        over = not (self.waiting or self.asking or self.known)
        total = self.done if over else max(self.done + len(self.asking), self.expected)
        self.progress("trials", self.done, total, self.failed)


def _next_action(experiment: Experiment) -> Action | None:
    """Next action; None where there is none, or the policy fails, which sets the experiment's `failure`."""
    try:
        action = experiment.next_action()
    except HeftError as error:
        refused = [f"{action.kind}: {why}" for action, why in experiment.reasons.items()]
        experiment.failure = "; ".join([f"policy: {error}", *refused[:1]])
        return None
    if action in experiment.refused:
        experiment.failure = f"{action.kind}: {experiment.reasons[action]}"
        return None
    return action


def _taken(experiment: Experiment, action: Action, key: str, store: Store, marks: Marks) -> bool:
    """Add a stored trial to the experiment; False where its file is damaged and it has to be made again."""
    if not store.has_sound_trial(key, marks):
        return False
    trajectory = store.trajectory(key)
    experiment.made.append(action)
    if experiment.finished:
        experiment.held_out_keys.append(key)
        return True
    drawn = sensed(trajectory, *experiment.policy_draw, len(experiment.keys), key, store.secret)
    if action.moves:
        experiment.trajectories.append(drawn)
    elif drawn.ok:
        experiment.weighed.append(weight_of(drawn))
    experiment.keys.append(key)
    return True


def _recalled(experiment: Experiment, store: Store, marks: Marks) -> bool:
    """Add all trials of an experiment from an earlier run; False where some are missing."""
    note = store.note(_key_of(experiment, store))
    if note is None or not all([store.has_sound_trial(key, marks) for key in note["keys"] + note["held_out"]]):
        return False
    experiment.keys, experiment.held_out_keys = note["keys"], note["held_out"]
    return True


def _key_of(experiment: Experiment, store: Store) -> str:
    request = {
        "object": object_request(experiment.model),
        "particles": object_request(experiment.particles),
        "support": experiment.support.name,
        "policy": experiment.scenario.policy.request(),
        "grasps": list(experiment.grasps),
        "held_out": [turn.to_dict() for turn in experiment.turns],
        "simulation": asdict(experiment.scenario.simulation.build()),
    }
    drawn = {"world": experiment.world.request(experiment.model)} if experiment.world else {}
    return key_of(request | drawn | store.draws | ({"felt": list(experiment.draw)} if experiment.draw else {}))


def _tried(trial: Trial, settings: RunnerSettings, store: Store) -> str:
    """Task of a worker: make one trial; return the reason of its refusal, empty where it is stored."""
    try:
        simulate(trial, settings, store)
    except InfeasibleTrialError as error:
        return str(error)
    return ""


def simulate(trial: Trial, settings: RunnerSettings, store: Store) -> str:
    """Make and store one physical trial, unless it is done; return its key.

    Raises:
        InfeasibleTrialError: it was refused; nothing has moved.
    """
    request = trial_request(trial, settings)
    key = key_of(request)
    if store.has_sound_trial(key):
        return key
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
    return key
