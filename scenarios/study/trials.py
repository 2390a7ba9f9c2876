"""The trials of a scenario: every cell's, as its policy asks, and turns held out for prediction."""

from __future__ import annotations

from collections import deque
from dataclasses import asdict, dataclass, field

from scenarios.execution.executor import Executor, Failure
from scenarios.results.store import Store, key_of, object_request, trial_request
from scenarios.study.benches import BenchSettings, OtherBench
from scenarios.study.estimates import as_felt
from scenarios.study.experiment import Cell, Made, Progress
from testbed.actions.base import Action
from testbed.actions.weigh import Weigh
from testbed.errors import HeftError, InfeasibleTrialError
from testbed.simulation.runner import SimulationRunner
from testbed.trajectory import TrajectoryFileError
from testbed.trial import Trial

FEET_RATE = 10.0
"""At which the table's forces on the feet are kept, for looking, Hz."""


def run_trials(
    cells: list[Cell], store: Store, executor: Executor, progress: Progress, made: Made | None = None
) -> None:
    """Make the trials: some cells side by side, each cell's in order; a trial that two cells ask for is made once.

    What the bench refuses at the true masses is told to the policy, which chooses something else. A cell whose trial
    fails for good, or whose policy asks again for what was refused, has the reason in `failure`, and goes no further.
    """
    expected = sum(cell.scenario.policy.expected_trials for cell in cells)
    waiting, run = deque(cells), _Run(store, executor)
    while waiting or executor.running:
        while waiting and run.active < executor.capacity:  # the driver holds the trajectories of these and no others
            run.begin(waiting.popleft())
        if executor.running:
            key, refusal = executor.wait()
            if made is not None and refusal == "":
                made("trial", key)
            run.end(key, refusal)
        failed = sum(bool(cell.failure) for cell in cells)
        progress("trials", run.done, max(run.done + executor.running, expected), failed)
    progress("trials", run.done, run.done, sum(bool(cell.failure) for cell in cells))


@dataclass(eq=False)
class _Run:
    """Cells under way, and who waits for which trial."""

    store: Store
    executor: Executor
    active: int = 0
    """Cells begun and not yet done or given up."""
    done: int = 0
    """Trials that are there."""
    asking: dict[str, list[tuple[Cell, Action]]] = field(default_factory=dict)
    """Who asked for each trial in flight."""

    def begin(self, cell: Cell) -> None:
        if _recalled(cell, self.store):
            self.done += len(cell.keys) + len(cell.held_out_keys)
        else:
            self.active += 1
            self._go_on(cell, Weigh())

    def end(self, key: str, refusal: str | Failure) -> None:
        """A trial is made where `refusal` is empty."""
        for cell, action in self.asking.pop(key):
            if refusal == "":
                self._go_on(cell, action)
            elif isinstance(refusal, Failure):
                self._give_up(cell, f"{action.kind}: {refusal.reason}")
                self.store.put_trial_error(key, refusal.detail)
            else:
                cell.refused[action] = refusal
                self._go_on(cell, self._following(cell))

    def _go_on(self, cell: Cell, action: Action | None) -> None:
        """From this action on: take what is there, and ask for the first trial that is not."""
        while action is not None:
            trial, settings = Trial(cell.model, action, cell.support), cell.scenario.simulation.build()
            key = key_of(trial_request(trial, settings))
            if not (self.store.has_trial(key) and _taken(cell, action, key, self.store)):
                self.asking.setdefault(key, []).append((cell, action))
                if len(self.asking[key]) == 1:
                    self.executor.start(key, _tried, trial, settings, self.store)
                return
            self.done += 1
            action = self._following(cell)
        if not cell.failure:
            self.store.put_note(_key_of_cell(cell), {"keys": cell.keys, "held_out": cell.held_out_keys})
            self.active -= 1

    def _following(self, cell: Cell) -> Action | None:
        """As the cell has it; a policy that cannot go on takes its own cell with it."""
        try:
            action = cell.following()
        except HeftError as error:
            self._give_up(cell, f"policy: {error}")
            return None
        if action in cell.refused:
            self._give_up(cell, f"{action.kind}: {cell.refused[action]}")
            return None
        return action

    def _give_up(self, cell: Cell, why: str) -> None:
        cell.failure = why
        cell.trajectories.clear()
        self.active -= 1


def _taken(cell: Cell, action: Action, key: str, store: Store) -> bool:
    """Take a finished trial into the cell; False where its file is damaged and it has to be made again."""
    try:
        trajectory = store.trajectory(key)
    except TrajectoryFileError:
        return False
    if cell.content:
        cell.held_out_keys.append(key)
        return True
    if action.moves:
        cell.trajectories.append(as_felt(trajectory, *cell.felt, len(cell.keys), key) if cell.felt else trajectory)
    cell.keys.append(key)
    return True


def _recalled(cell: Cell, store: Store) -> bool:
    """Whether all trials of a cell are there from an earlier run; then it has their keys."""
    note = store.note(_key_of_cell(cell))
    if note is None or not all(store.has_sound_trial(key) for key in note["keys"] + note["held_out"]):
        return False
    cell.keys, cell.held_out_keys = note["keys"], note["held_out"]
    return True


def _key_of_cell(cell: Cell) -> str:
    asked = {
        "object": object_request(cell.model),
        "particles": object_request(cell.particles),
        "support": cell.support.name,
        "policy": cell.scenario.policy.asked(),
        "grasps": list(cell.grasps),
        "held_out": [turn.to_dict() for turn in cell.turns],
        "simulation": asdict(cell.scenario.simulation.build()),
    }
    return key_of(asked | ({"felt": list(cell.felt)} if cell.felt else {}))


def _tried(trial: Trial, settings: BenchSettings, store: Store) -> str:
    """Task: a trial; why the bench refused it, or empty where it is made."""
    try:
        simulate(trial, settings, store)
    except InfeasibleTrialError as error:
        return str(error)
    return ""


def simulate(trial: Trial, settings: BenchSettings, store: Store) -> None:
    """One physical trial, unless it is done.

    Raises:
        InfeasibleTrialError: the bench refused it; nothing has moved.
    """
    asked = trial_request(trial, settings)
    key = key_of(asked)
    if store.has_trial(key):
        return
    feet = None
    if isinstance(settings, OtherBench):
        trajectory = settings.run(trial)
    elif not trial.action.moves:
        trajectory = SimulationRunner(settings).run_clean(trial)
    else:
        runner = SimulationRunner(settings)
        trajectory, contacts = runner.run_with_contacts(trial, every=round(settings.rate / FEET_RATE))
        feet = contacts.foot_forces(trajectory.time_s)
    store.put_trial(key, trial, asked, trajectory, feet)
