"""The trials of a scenario: every cell's, as its policy asks, and turns held out for prediction."""

from __future__ import annotations

from collections import deque
from dataclasses import asdict

from scenarios.benches import BenchSettings, OtherBench
from scenarios.cells import Cell, Made, Progress
from scenarios.estimates import as_felt
from scenarios.execution import Executor, Failure
from scenarios.store import Store, key_of, object_request, trial_request
from testbed.actions import Action, Weigh, action_to_dict
from testbed.errors import HeftError
from testbed.simulation.runner import SimulationRunner
from testbed.trajectory import TrajectoryFileError
from testbed.trial import Trial

FEET_RATE = 10.0
"""At which the table's forces on the feet are kept, for looking, Hz."""


def run_trials(
    cells: list[Cell], store: Store, executor: Executor, progress: Progress, made: Made | None = None
) -> None:
    """Make the trials: some cells side by side, each cell's in order; a trial that two cells ask for is made once.

    A cell whose trial fails for good has the reason in `failure`, and goes no further.
    """
    expected = sum(cell.scenario.policy.expected_trials for cell in cells)
    waiting, active, done = deque(cells), 0, 0
    asking: dict[str, list[tuple[Cell, Action]]] = {}

    def give_up(cell: Cell, why: str) -> None:
        nonlocal active
        cell.failure = why
        cell.trajectories.clear()
        active -= 1

    def go_on(cell: Cell, action: Action | None) -> None:
        """From this action on: take what is there, and ask for the first trial that is not."""
        nonlocal active, done
        while action is not None:
            trial, settings = Trial(cell.model, action, cell.support), cell.scenario.simulation.build()
            key = key_of(trial_request(trial, settings))
            if not (store.has_trial(key) and _taken(cell, action, key, store)):
                asking.setdefault(key, []).append((cell, action))
                if len(asking[key]) == 1:
                    executor.start(key, simulate, trial, settings, store)
                return
            done += 1
            try:
                action = cell.following()
            except HeftError as error:  # a policy that cannot go on takes its own cell with it
                give_up(cell, f"policy: {error}")
                return
        store.put_note(_key_of_cell(cell), {"keys": cell.keys, "held_out": cell.held_out_keys})
        active -= 1

    while waiting or executor.running:
        while waiting and active < executor.capacity:  # the driver holds the trajectories of these and no others
            cell = waiting.popleft()
            if _recalled(cell, store):
                done += len(cell.keys) + len(cell.held_out_keys)
            else:
                active += 1
                go_on(cell, Weigh())
        if executor.running:
            key, value = executor.wait()
            if made is not None and not isinstance(value, Failure):
                made("trial", key)
            for cell, action in asking.pop(key):
                if not isinstance(value, Failure):
                    go_on(cell, action)
                    continue
                give_up(cell, f"{type(action).__name__.lower()}: {value.reason}")
                store.put_trial_error(key, value.detail)
        failed = sum(bool(cell.failure) for cell in cells)
        progress("trials", done, max(done + executor.running, expected), failed)
    progress("trials", done, done, sum(bool(cell.failure) for cell in cells))


def _taken(cell: Cell, action: Action, key: str, store: Store) -> bool:
    """Take a finished trial into the cell; False where its file is damaged and it has to be made again."""
    try:
        trajectory = store.trajectory(key)
    except TrajectoryFileError:
        return False
    if cell.content:
        cell.held_out_keys.append(key)
        return True
    if not isinstance(action, Weigh):
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
        "held_out": [action_to_dict(turn) for turn in cell.turns],
        "simulation": asdict(cell.scenario.simulation.build()),
    }
    return key_of(asked | ({"felt": list(cell.felt)} if cell.felt else {}))


def simulate(trial: Trial, settings: BenchSettings, store: Store) -> None:
    """Task: one physical trial, unless it is done."""
    asked = trial_request(trial, settings)
    key = key_of(asked)
    if store.has_trial(key):
        return
    feet = None
    if isinstance(settings, OtherBench):
        trajectory = settings.run(trial)
    elif isinstance(trial.action, Weigh):
        trajectory = SimulationRunner(settings).run_clean(trial)
    else:
        runner = SimulationRunner(settings)
        trajectory, contacts = runner.run_with_contacts(trial, every=round(settings.rate / FEET_RATE))
        feet = contacts.foot_forces(trajectory.time_s)
    store.put_trial(key, trial, asked, trajectory, feet)
