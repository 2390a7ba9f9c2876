"""The trials of a scenario: every object under every support, as the policy asks, and turns held out for prediction."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass, field
from typing import Any

from estimators.protocol import ActionPolicy
from scenarios.execution import Submit, finished
from scenarios.schema import Scenario
from scenarios.store import Store, key_of, trial_request
from testbed.actions import Accelerate, Action, Rotate, Weigh
from testbed.errors import InfeasibleTrialError
from testbed.object_files import load_object
from testbed.objects import ObjectModel
from testbed.simulation.runner import SimulationRunner
from testbed.simulation.settings import SimulationSettings
from testbed.trajectory import Trajectory, TrajectoryFileError
from testbed.trial import Support, Trial

Progress = Callable[[str, int, int], None]
"""Told the stage ("trials" or "estimates"), how many are done, and how many there are as far as is known."""


@dataclass(eq=False)
class Cell:
    """One object under one support: its trials are made one after the other, as the policy sees them."""

    model: ObjectModel
    """With the simulation's feet."""
    particles: ObjectModel
    """With the estimator's particles."""
    support: Support
    policy: ActionPolicy
    held_out: list[Rotate]
    """Turns that are still to be made for prediction."""
    keys: list[str] = field(default_factory=list)
    """Trials made so far; the weighing first."""
    held_out_keys: list[str] = field(default_factory=list)
    """Turns made for prediction."""
    trajectories: list[Trajectory] = field(default_factory=list)
    """What the policy sees."""
    content: bool = False
    """Whether the policy has asked for all it wants."""

    def following(self) -> Action | None:
        """What to do next; None when done."""
        if not self.content:
            action = self.policy.next(self.particles.shape, self.trajectories)
            if action is not None:
                return action
            self.content = True
            self.trajectories.clear()
        return self.held_out.pop(0) if self.held_out else None


def cells_of(scenario: Scenario, settings: SimulationSettings) -> list[Cell]:
    """Every object under every support.

    Raises:
        HeftError: an object that cannot be read or handled.
    """
    cells = []
    for name in scenario.objects:
        model, particles = load_object(name, scenario.grid.feet), load_object(name, scenario.grid.particles)
        grasps = feasible_grasps(model, settings)
        for support in scenario.supports():
            held_out = scenario.policy.build_held_out(particles.shape, grasps)
            cells.append(Cell(model, particles, support, scenario.policy.build(grasps), held_out))
    return cells


def feasible_grasps(model: ObjectModel, settings: SimulationSettings) -> tuple[int, ...]:
    """Grasps about which the bench can turn the object at constant and at changing speed.

    Raises:
        InfeasibleTrialError: there is none; the message gives the reason of each.
    """
    runner = SimulationRunner(settings)
    possible, reasons = [], []
    for index, grasp in enumerate(model.shape.grasps):
        try:
            for action in (Rotate(index), Accelerate(index)):
                runner.check(Trial(model, action))
            possible.append(index)
        except InfeasibleTrialError as error:
            reasons.append(f"{grasp.name}: {error}")
    if not possible:
        why = "\n  ".join(reasons) or "no block has two opposite free faces"
        raise InfeasibleTrialError(f"{model.name}: the bench cannot turn this object about any grasp\n  {why}")
    return tuple(possible)


def run_trials(
    cells: list[Cell], settings: SimulationSettings, store: Store, submit: Submit, progress: Progress, expected: int
) -> None:
    """Make the trials: all cells side by side, each cell's in order."""
    running: dict[Future[Any], tuple[Cell, Action]] = {}
    done = 0

    def submit_trial(cell: Cell, action: Action) -> None:
        running[submit(simulate, Trial(cell.model, action, cell.support), settings, store)] = cell, action

    for cell in cells:
        submit_trial(cell, Weigh())
    while running:
        for future in finished(set(running)):
            cell, action = running.pop(future)
            key = future.result()
            try:
                trajectory = store.trajectory(key)
            except TrajectoryFileError:  # damaged since it was made: made again
                submit_trial(cell, action)
                continue
            (cell.held_out_keys if cell.content else cell.keys).append(key)
            if not (cell.content or isinstance(action, Weigh)):
                cell.trajectories.append(trajectory)
            done += 1
            following = cell.following()
            if following is not None:
                submit_trial(cell, following)
        progress("trials", done, max(done + len(running), expected))
    progress("trials", done, done)


def simulate(trial: Trial, settings: SimulationSettings, store: Store) -> str:
    """Task: one physical trial, unless it is done; returns its key."""
    asked = trial_request(trial, settings)
    key = key_of(asked)
    if not store.has_trial(key):
        store.put_trial(key, asked, SimulationRunner(settings).run_clean(trial))
    return key
