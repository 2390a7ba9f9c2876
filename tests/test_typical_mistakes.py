"""Typical mistakes in Python: each is refused by its name, with what was given and what is allowed."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import heft
from estimators.action_selection.design import Guess
from estimators.action_selection.greedy import PlannedPolicy
from estimators.action_selection.plan import Goal
from estimators.posterior.estimator import posterior_of
from estimators.testing.recorded import load_block
from testbed.errors import InvalidValueError
from testbed.objects.blocks import Cell, block_object, parse_layout
from testbed.toml import InvalidFileError

HEFT: Any = heft
BLOCK = load_block("L2-own_weight")
GUESS = Guess(1.8, HEFT.preset("ft300s"))
OBJECT, SHAPE, TRIALS = BLOCK.model, BLOCK.model.shape, BLOCK.trials("ft300s")


def built(**changes: Any) -> object:
    """An object of three blocks, made with some other arguments."""
    given: dict[str, Any] = {"cells": [Cell(0, 0), Cell(1, 0), Cell(1, 1)], "size": 0.05, "height": 0.03, "grid": 3}
    given |= {"mass": [0.1, 0.2, 0.3], "friction": [0.5], "friction_group": [0, 0, 0]}
    return block_object("three", **given | changes)


MISTAKES: dict[str, tuple[Callable[[], object], str]] = {
    "a trial in place of trials": (
        lambda: HEFT.HiddenStates().estimate(SHAPE, 1.8, TRIALS[0], 0), "trajectories: got .*a list or tuple of"
    ),
    "an object in place of its shape": (
        lambda: HEFT.RandomSearch().estimate(OBJECT, 1.8, TRIALS, 0), "shape: got ObjectModel.*an ObjectShape"
    ),
    "an object for a posterior": (lambda: posterior_of(OBJECT, 1.8, TRIALS), "an ObjectShape"),  # type: ignore[arg-type]
    "an estimate in place of masses": (
        lambda: HEFT.normalized_absolute_difference(SHAPE, HEFT.Estimate(OBJECT.truth, "ok"), OBJECT.truth),
        "estimate: got Estimate.*a MassDistribution",
    ),
    "an action by its name": (lambda: HEFT.Trial(OBJECT, "rotate"), "Trial.action: got 'rotate'"),
    "a world by its name": (lambda: HEFT.Trial(OBJECT, HEFT.Rotate(1), world="lab"), "Trial.world: got 'lab'"),
    "a sensor for its name": (
        lambda: HEFT.Trial(OBJECT, HEFT.Rotate(1), sensing=HEFT.preset("ft300s")), "sensing: got .*one of ideal"
    ),
    "a seed in words": (lambda: HEFT.Trial(OBJECT, HEFT.Rotate(1), seed="a"), "Trial.seed: got 'a'"),
    "a support by its name": (lambda: HEFT.Support("rigid"), "Support.stiffness: got 'rigid'"),
    "a phase by its name": (lambda: TRIALS[0].mask("steady"), "members of heft.Phase"),  # type: ignore[arg-type]
    "errors of a sensor twice": (lambda: HEFT.draw_sensing(TRIALS[0], HEFT.preset("ft300s"), 0), "clean: got"),
    "a trajectory of no action": (lambda: replace(TRIALS[0], action="rotate"), "Trajectory.action: got 'rotate'"),  # type: ignore[arg-type]
    "grams": (lambda: Guess(1800.0, HEFT.preset("ft300s")), "Guess.weight: got 1800"),
    "a sensor's name for a plan": (lambda: Guess(1.8, "ft300s"), "Guess.sensing: got 'ft300s'"),  # type: ignore[arg-type]
    "a target in percent": (lambda: Goal(until=5), "Goal.until: got 5; allowed: a ratio"),
    "a list of grasps for a plan": (
        lambda: PlannedPolicy(GUESS, grasps=[0, 1]), r"PlannedPolicy.grasps: got \[0, 1\]; allowed: a tuple"  # type: ignore[arg-type]
    ),
    "a runner to check a plan": (
        lambda: PlannedPolicy(GUESS, feasible=HEFT.SimulationRunner()), "feasible: .*a function of an action"
    ),
    "times in milliseconds": (
        lambda: HEFT.HiddenStates().estimate(SHAPE, 1.8, [replace(t, time_s=1000 * t.time_s) for t in TRIALS], 0),
        r"trajectories\[0\].time_s: got 'a sample every 10 s'; allowed: at most 0.1 s between samples",
    ),
    "a layout in a line": (lambda: parse_layout("11"), "layout: got '11'; allowed: a list of rows"),  # type: ignore[arg-type]
    "a block twice": (lambda: built(cells=[Cell(0, 0)] * 2 + [Cell(1, 0)]), "cells: .*each place once"),
    "a block apart": (lambda: built(cells=[Cell(0, 0), Cell(5, 5), Cell(1, 0)]), "joined edge to edge"),
    "cells without names": (lambda: built(cells=[(0, 0), (1, 0), (1, 1)]), "one Cell"),
    "millimeters": (lambda: built(size=50), "size: got 50; allowed: 0.001 to 1 m"),
    "masses in grams": (lambda: built(mass=[400, 100, 300]), "mass: got 400; allowed: 0 to 100 kg"),
    "one mass for all": (lambda: built(mass=0.8), "mass: got 0.8; allowed: a list"),
    "an object's name to show": (
        lambda: HEFT.show("L2"), "what: got 'L2'; allowed: a results folder; heft.load_object"
    ),
    "a number to show": (
        lambda: HEFT.show(3), "what: got 'int'; allowed: an ObjectModel, a Trajectory, an Estimate, a dict"
    ),
    "no estimates to show": (lambda: HEFT.show({}), "what: got 'dict'"),
    "an estimate to show without its object": (
        lambda: HEFT.show(HEFT.Estimate(OBJECT.truth, "ok")),
        "obj: got 'NoneType'; allowed: the ObjectModel or ObjectShape of this Estimate",
    ),
    "another object to show": (
        lambda: HEFT.show(replace(TRIALS[0], action=HEFT.Rotate(9)), OBJECT, file="/nowhere/x.rrd"), "obj: got 'L2'"
    ),
    "a picture for a recording": (lambda: HEFT.show(OBJECT, file="x.png"), "FILE.rrd"),
    "misspelled fields of a scenario": (
        lambda: HEFT.load_scenario("blocks")[1].replaced(object=["I2"], seeds="3"), "object: no such field"
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", MISTAKES)
def test_a_typical_mistake_is_refused_by_its_name(name: str):
    call, message = MISTAKES[name]
    with pytest.raises((InvalidValueError, InvalidFileError), match=f"(?s){message}"):
        call()


def test_fields_of_a_scenario_are_replaced_and_paths_may_be_text(tmp_path):
    scenario = HEFT.load_scenario("blocks")[1].replaced(seeds=2, objects=["I2"])
    assert (scenario.seeds, scenario.objects) == (2, ["I2"])
    HEFT.save_trajectory(TRIALS[0], str(tmp_path / "turn.parquet"))
    assert np.array_equal(HEFT.load_trajectory(tmp_path / "turn.parquet").time_s, TRIALS[0].time_s)
