"""Experiments of a scenario: one object under one support at one point of the sweep."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, field
from functools import lru_cache, partial
from typing import Any, Protocol

from estimators.action_selection.rank import RankDriven
from estimators.base import ActionPolicy
from scenarios.config import Scenario
from scenarios.policies import PLANNED
from scenarios.results.store import Store, key_of, object_request
from scenarios.runners import feasible_grasps, redacted
from testbed.actions.base import Action
from testbed.actions.rotate import Rotate
from testbed.errors import InfeasibleTrialError, InvalidValueError
from testbed.objects.files import load_object
from testbed.objects.model import ObjectModel
from testbed.objects.random import Family
from testbed.trajectory import Trajectory
from testbed.trial import OWN_WEIGHT, Support
from testbed.worlds.draw import WorldDraw

MOST_DRAWS = 100
"""Draws of a random object before its family is given up."""


ResultCallback = Callable[[str, str], None]
"""Called with "trial" or "estimate" and its key when one is done."""


class Progress(Protocol):
    """Callback for the progress of a run."""

    def __call__(self, stage: str, done: int, total: int, failed: int = 0) -> None:
        """Take a stage (objects, trials or estimates) and its numbers: done, expected in total, and failed."""
        ...


@dataclass(eq=False)
class Experiment:
    """One object under one support, with trials that the policy chooses one after the other.

    All draws of all sensors share an experiment, unless the measured wrenches decide the actions or each draw has its
    own choice: then an experiment belongs to one draw.
    """

    scenario: Scenario
    """Scenario at its point of the sweep."""
    axes: dict[str, Any]
    """Value of each swept field."""
    model: ObjectModel
    """Object with the simulation's feet."""
    particles: ObjectModel
    """Object with the estimator's particles."""
    support: Support
    grasps: tuple[int, ...]
    """Grasps that may be used."""
    policy: ActionPolicy
    turns: tuple[Rotate, ...]
    """Turns for prediction, hidden from every method."""
    refused: dict[Action, str] = field(default_factory=dict)
    """Reasons of refused actions, without numbers, for the policy, which then chooses another."""
    weighed: list[float] = field(default_factory=list)
    """Reading of the scale [kg] for the policy; empty before the weighing."""
    made: list[Action] = field(default_factory=list)
    """Actions of the trials made so far, those for prediction too."""
    keys: list[str] = field(default_factory=list)
    """Keys of the trials made so far, the weighing first."""
    held_out_keys: list[str] = field(default_factory=list)
    """Keys of the turns made for prediction."""
    trajectories: list[Trajectory] = field(default_factory=list)
    """Trajectories for the policy: with a sensor's errors, and blinded."""
    finished: bool = False
    """True if the policy has ended."""
    failure: str = ""
    """Reason why a trial could not be made; empty if all could."""
    reasons: dict[Action, str] = field(default_factory=dict)
    """Reason of each refusal, with its numbers."""
    draw: tuple[str, int] | None = None
    """Sensor and seed of its one draw; None where all draws share it."""
    world: WorldDraw | None = None
    """Draw of the world of its trials, hidden from every method; None is the ideal one."""

    def known_actions(self) -> list[Action]:
        """Actions that do not depend on any wrench: those of the paper's policy, and the turns held out."""
        chosen = self.policy.predicted_actions(self.particles.shape) if isinstance(self.policy, RankDriven) else []
        return [*chosen, *self.turns]

    @property
    def policy_draw(self) -> tuple[str, int]:
        """Sensor and seed of the draw for the policy."""
        return self.draw or (self.scenario.policy.plan_for, self.scenario.policy.seed)

    def refuse(self, action: Action, why: str) -> None:
        """Note the refusal of an action at the true masses."""
        self.reasons[action], self.refused[action] = why, redacted(why)

    def next_action(self) -> Action | None:
        """Next action; None when done."""
        if not self.finished:
            action = self.policy.next(self.particles.shape, self.trajectories)
            if action is not None:
                return action
            self.finished = True
            self.trajectories.clear()
        turns = [turn for turn in self.turns if turn not in self.refused]
        made = len(self.held_out_keys)
        return turns[made] if made < len(turns) else None


@dataclass(frozen=True)
class InfeasibleExperiment:
    """An experiment that the robot cannot do."""

    name: str
    support: str
    axes: dict[str, Any]
    reason: str


def experiments_of(
    scenario: Scenario, store: Store, progress: Progress
) -> tuple[list[Experiment], list[InfeasibleExperiment]]:
    """Feasible and infeasible experiments: every object under every support at every point of the sweep.

    Raises:
        HeftError: an object that cannot be read; or none that can be handled.
    """
    experiments, left_out, feasible = [], [], _Grasps(store)
    load_once = lru_cache(maxsize=None)(load_object)  # for all points of a sweep
    points = scenario.points()
    total = sum(len(point.all_objects()) for _, point in points)
    done = 0
    for axes, point in points:
        settings = point.simulation.build()
        for name, load in _sources(point, feasible, store, load_once):
            try:
                model = point.truth.applied(load(point.grid.feet), store.secret)
                even = point.truth.model_copy(update={"friction_spread": 0.0})
                particles = even.applied(load(point.grid.particles), store.secret)
                own, grasps = _handled(point, model, feasible)
            except InfeasibleTrialError as error:
                left_out += [InfeasibleExperiment(name, support.name, axes, str(error)) for support in point.supports()]
            else:
                for support in own.supports():
                    for draw in own.own_draws():
                        used, turns = own.policy.split(particles.shape, grasps, draw[1] if draw else 0)
                        refused, weighed = dict[Action, str](), list[float]()
                        setup = own.world.build().stated
                        policy = own.policy.build(used, particles.shape, settings, weighed, draw, refused, setup)
                        world = own.world.draw(model, draw[1], store.secret) if draw else None
                        chosen = (used, policy, turns, refused, weighed)
                        experiments.append(
                            Experiment(own, axes, model, particles, support, *chosen, draw=draw, world=world)
                        )
            done += 1
            progress("objects", done, total)
    if not experiments:
        raise InfeasibleTrialError("no object can be handled:\n" + "\n".join(f"{c.name}: {c.reason}" for c in left_out))
    feasible.keep()
    return experiments, left_out


def link_refusal(point: Scenario, model: ObjectModel) -> str:
    """Reason why the actions of a scenario do not determine the masses of an object with hinges; empty if they do."""
    if model.shape.chain is None:
        return ""
    plans = f"a plan ({', '.join(PLANNED)})"
    if not point.policy.grips or point.policy.pushes:
        return f'{model.name}: an object with hinges is not pushed; use kind = "drag" or {plans}'
    if point.policy.of_one_body:
        needed = f'use [policy] kind = "drag" or {plans}'
        return f"{model.name}: {point.policy.kind} is for one rigid body, not for links; {needed}"
    if any(support != OWN_WEIGHT for support in point.supports()):
        return f'{model.name}: links rest on their own weight; use support = ["own_weight"]'
    return ""


def _handled(point: Scenario, model: ObjectModel, feasible: _Grasps) -> tuple[Scenario, tuple[int, ...]]:
    """Scenario for an object, with pushes where no grasp is feasible, and the feasible grasps.

    Raises:
        InfeasibleTrialError: it cannot be turned, and is not to be pushed.
    """
    if refused := link_refusal(point, model):
        raise InfeasibleTrialError(refused)
    if not point.policy.grips:
        return point, ()
    try:
        return point, feasible.of(model, point)
    except InfeasibleTrialError:
        pushed = point.policy.without_grasp
        if pushed is None:
            raise
        return point.model_copy(update={"policy": pushed}), ()


def object_paths(scenario: Scenario, load: Callable[[str], ObjectModel] = load_object) -> dict[str, str]:
    """Path, or name in the library, of each object by its name; `load` reads one as `load_object` does.

    Raises:
        HeftError: an object that cannot be read, or two of one name.
    """
    paths = {load(path).name: path for path in scenario.objects}
    if len(paths) < len(scenario.objects):
        raise InvalidValueError("objects", scenario.objects, "objects of different names")
    return paths


def _sources(
    scenario: Scenario, feasible: _Grasps, store: Store, load: Callable[..., ObjectModel]
) -> Iterator[tuple[str, Callable[[int], ObjectModel]]]:
    """Name of every object, and a function that loads it at a resolution; `load` reads one as `load_object` does."""
    for name, path in object_paths(scenario, load).items():
        yield name, partial(load, path)
    for family in scenario.random:
        for index, name in enumerate(family.names()):
            yield name, partial(load, _drawn(family, index, scenario, feasible, store))


def _drawn(family: Family, index: int, scenario: Scenario, feasible: _Grasps, store: Store) -> str:
    """File of a random object, written if missing: one that the robot can turn, or any if others are pushed.

    Raises:
        InfeasibleTrialError: none of many draws can be handled.
    """
    any_shape = scenario.policy.takes_any_shape
    drawn = {"family": family.model_dump(exclude={"count"}, exclude_none=True), "digits": len(str(family.count - 1))}
    folder = key_of(drawn | ({"any_shape": True} if any_shape else {}))
    path = store.root / "objects" / folder / f"{family.names()[index]}.toml"
    if store.has_object(path):
        return str(path)
    reason = ""
    for attempt in range(MOST_DRAWS):
        file = family.draw(index, attempt)
        try:
            if not any_shape:
                feasible.of(file.build(3, path.parent), scenario)
        except InfeasibleTrialError as error:
            reason = str(error)
            continue
        store.put_object(path, file)
        return str(path)
    raise InfeasibleTrialError(f"{family.name}: {MOST_DRAWS} draws, none of which the bench can turn: {reason}")


class _Grasps:
    """`feasible_grasps` of every object and runner, computed once and kept in the store."""

    def __init__(self, store: Store):
        self._store = store
        self._known: dict[str, dict[str, Any]] = {}
        self._new: list[str] = []

    def of(self, model: ObjectModel, point: Scenario) -> tuple[int, ...]:
        """Feasible grasps of an object; raises InfeasibleTrialError where there are none."""
        name, check = model.name, point.policy.check(model, point.simulation.build(), self._store.secret)
        assumed = object_request(ObjectModel(name, check.shape, check.guess.uniform(check.shape)))
        key = key_of({"assumed": assumed, "simulation": asdict(check.settings), "what": "grasps"})
        known = self._known.get(key) or self._store.note(key)
        if known is None:
            try:
                known = {"grasps": list(feasible_grasps(name, check))}
            except InfeasibleTrialError as error:
                known = {"reason": str(error)}
            self._new.append(key)
        self._known[key] = known
        if "reason" in known:
            raise InfeasibleTrialError(known["reason"])
        return tuple(int(grasp) for grasp in known["grasps"])

    def keep(self) -> None:
        """Write the new entries, once the whole scenario is known to be feasible."""
        for key in self._new:
            self._store.put_note(key, self._known[key])
