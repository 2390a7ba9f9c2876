"""Cells of a scenario: one object under one support at one point of the sweep, and what is to be done with it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, field
from functools import partial
from typing import Any, Protocol

from estimators.base import ActionPolicy
from scenarios.config import Scenario
from scenarios.results.store import Store, key_of, object_request
from scenarios.study.benches import BenchSettings, check_trial
from testbed.actions.accelerate import Accelerate
from testbed.actions.base import Action
from testbed.actions.rotate import Rotate
from testbed.errors import InfeasibleTrialError, InvalidValueError
from testbed.objects.files import load_object
from testbed.objects.model import ObjectModel
from testbed.objects.random import Family
from testbed.trajectory import Trajectory
from testbed.trial import Support, Trial

MOST_DRAWS = 100
"""Draws of a random object before its family is given up."""


Made = Callable[[str, str], None]
"""Told of each "trial" and "estimate" that is made, by its key, when it is done."""


class Progress(Protocol):
    """Told how far a run is."""

    def __call__(self, stage: str, done: int, total: int, failed: int = 0) -> None:
        """The stage (objects, trials or estimates), how many are done, are known to come, and have failed."""
        ...


@dataclass(eq=False)
class Cell:
    """One object under one support: its trials are made one after the other, as the policy sees them.

    Most policies see the physics alone, and all draws of all sensors share a cell. Where each touch follows from what
    was felt, a cell is of one draw.
    """

    scenario: Scenario
    """At its point of the sweep."""
    axes: dict[str, Any]
    """Value of each swept field."""
    model: ObjectModel
    """With the simulation's feet."""
    particles: ObjectModel
    """With the estimator's particles."""
    support: Support
    grasps: tuple[int, ...]
    """Grasps that may be used."""
    policy: ActionPolicy
    turns: tuple[Rotate, ...]
    """Turns to be made for prediction, which no method is given."""
    refused: dict[Action, str] = field(default_factory=dict)
    """What the bench refused when it was run, and why; the policy chooses something else."""
    keys: list[str] = field(default_factory=list)
    """Trials made so far; the weighing first."""
    held_out_keys: list[str] = field(default_factory=list)
    """Turns made for prediction."""
    trajectories: list[Trajectory] = field(default_factory=list)
    """What the policy sees."""
    content: bool = False
    """Whether the policy has asked for all it wants."""
    failure: str = ""
    """Why a trial of it could not be made, if one could not."""
    felt: tuple[str, int] | None = None
    """Sensor and seed of the one draw that it is of; None where all share it."""

    def following(self) -> Action | None:
        """What to do next; None when done."""
        if not self.content:
            action = self.policy.next(self.particles.shape, self.trajectories)
            if action is not None:
                return action
            self.content = True
            self.trajectories.clear()
        made = len(self.held_out_keys)
        return self.turns[made] if made < len(self.turns) else None


@dataclass(frozen=True)
class Infeasible:
    """A cell that the bench cannot do."""

    name: str
    support: str
    axes: dict[str, Any]
    reason: str


def cells_of(scenario: Scenario, store: Store, progress: Progress) -> tuple[list[Cell], list[Infeasible]]:
    """Every object under every support at every point of the sweep, and those that the bench cannot do.

    Raises:
        HeftError: an object that cannot be read; a named one that cannot be handled, where nothing is swept.
    """
    cells, left_out, feasible = [], [], _Grasps(store)
    points = scenario.points()
    total = len(points) * (len(scenario.objects) + sum(family.count for family in scenario.random))
    done = 0
    for axes, point in points:
        settings = point.simulation.build()
        for name, load in _sources(point, feasible, store):
            try:
                model = point.truth.applied(load(point.grid.feet))
                particles = point.truth.model_copy(update={"friction_spread": 0.0}).applied(load(point.grid.particles))
                grasps = feasible.of(model, settings)
            except InfeasibleTrialError as error:
                if not (axes or scenario.random):
                    raise
                left_out += [Infeasible(name, support.name, axes, str(error)) for support in point.supports()]
            else:
                for support in point.supports():
                    turns = tuple(point.policy.build_held_out(particles.shape, grasps))
                    for felt in point.own_draws():
                        refused: dict[Action, str] = {}
                        sensing = felt[0] if felt else None
                        policy = point.policy.build(grasps, particles, settings, sensing, refused)
                        one = Cell(point, axes, model, particles, support, grasps, policy, turns, refused, felt=felt)
                        cells.append(one)
            done += 1
            progress("objects", done, total)
    if not cells:
        raise InfeasibleTrialError("no object can be handled:\n" + "\n".join(f"{c.name}: {c.reason}" for c in left_out))
    feasible.keep()
    return cells, left_out


def _sources(scenario: Scenario, feasible: _Grasps, store: Store) -> Iterator[tuple[str, Callable[[int], ObjectModel]]]:
    """Name of every object, and how it is cut into a grid."""
    paths = {load_object(path).name: path for path in scenario.objects}
    if len(paths) < len(scenario.objects):
        raise InvalidValueError("objects", scenario.objects, "objects of different names")
    for name, path in paths.items():
        yield name, partial(load_object, path)
    for family in scenario.random:
        for index, name in enumerate(family.names()):
            yield name, partial(load_object, _drawn(family, index, scenario.simulation.build(), feasible, store))


def _drawn(family: Family, index: int, settings: BenchSettings, feasible: _Grasps, store: Store) -> str:
    """The file of a drawn object that the bench can handle, made if it is not there.

    Raises:
        InfeasibleTrialError: none of many draws can be handled.
    """
    folder = key_of({"family": family.model_dump(exclude={"count"}), "digits": len(str(family.count - 1))})
    path = store.root / "objects" / folder / f"{family.names()[index]}.toml"
    if path.is_file():
        return str(path)
    reason = ""
    for attempt in range(MOST_DRAWS):
        file = family.draw(index, attempt)
        try:
            feasible.of(file.build(3, path.parent), settings)
        except InfeasibleTrialError as error:
            reason = str(error)
            continue
        store.put_object(path, file)
        return str(path)
    raise InfeasibleTrialError(f"{family.name}: {MOST_DRAWS} draws, none of which the bench can turn: {reason}")


class _Grasps:
    """`feasible_grasps` of every object and bench, worked out once and kept in the store."""

    def __init__(self, store: Store):
        self._store = store
        self._new: dict[str, dict[str, Any]] = {}

    def of(self, model: ObjectModel, settings: BenchSettings) -> tuple[int, ...]:
        """Raises InfeasibleTrialError where there are none."""
        key = key_of({"object": object_request(model), "simulation": asdict(settings), "what": "grasps"})
        known = self._new.get(key) or self._store.note(key)
        if known is None:
            try:
                known = {"grasps": list(feasible_grasps(model, settings))}
            except InfeasibleTrialError as error:
                known = {"reason": str(error)}
            self._new[key] = known
        if "reason" in known:
            raise InfeasibleTrialError(known["reason"])
        return tuple(int(grasp) for grasp in known["grasps"])

    def keep(self) -> None:
        """Write what is new: not before the whole scenario is known to be sound."""
        for key, note in self._new.items():
            self._store.put_note(key, note)


def feasible_grasps(model: ObjectModel, settings: BenchSettings) -> tuple[int, ...]:
    """Grasps about which the bench can turn the object at constant and at changing speed.

    Raises:
        InfeasibleTrialError: there is none; the message gives the reason of each.
    """
    possible, reasons = [], []
    for index, grasp in enumerate(model.shape.grasps):
        try:
            for action in (Rotate(index), Accelerate(index)):
                check_trial(Trial(model, action), settings)
            possible.append(index)
        except InfeasibleTrialError as error:
            reasons.append(f"{grasp.name}: {error}")
    if not possible:
        why = "\n  ".join(reasons) or "no block has two opposite free faces"
        raise InfeasibleTrialError(f"{model.name}: the bench cannot turn this object about any grasp\n  {why}")
    return tuple(possible)
