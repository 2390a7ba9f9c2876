"""The [policy] table of a scenario: how actions are chosen."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import deepcopy
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Annotated, Any, Literal, Self
from zlib import crc32

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator, model_validator

from estimators.action_selection.design import ASSUMED_SUPPORTS, Guess
from estimators.action_selection.greedy import PlannedPolicy
from estimators.action_selection.online import OnlinePolicy
from estimators.action_selection.plan import Goal
from estimators.action_selection.rank import RankDriven, held_out_turns
from estimators.base import ActionPolicy
from estimators.registry import build_method, is_method
from scenarios.policies import PolicyContext, build_policy, code_of
from scenarios.runners import FeasibilityCheck, NamedRunner, RunnerSettings
from testbed.actions.base import Action
from testbed.actions.rotate import Rotate
from testbed.errors import InvalidValueError
from testbed.objects.files import find_file, library_names
from testbed.objects.model import MassDistribution, ObjectModel, ObjectShape
from testbed.objects.random import Family
from testbed.plugins import nearest
from testbed.sensing.presets import preset
from testbed.simulation.settings import (
    ContactSettings,
    GripSettings,
    ServoSettings,
    SimulationSettings,
)
from testbed.toml import explained, load_toml
from testbed.trial import Support, parse_support

Count = Annotated[int, Field(ge=1, le=100_000)]


POLICIES = ("paper", "greedy", "batch", "random", "online")
"""heft's own policies."""


class Policy(BaseModel):
    """How actions are chosen: by the paper's rank, by a plan before any touch or after each, or by code of your own."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    kind: str = "paper"
    pivots: Annotated[int, Field(ge=1)] = 6
    duration: Annotated[float, Field(gt=1.5, le=60)] = 18.0
    accelerated: Annotated[int, Field(ge=0)] = 6
    most: Count = 40
    seed: Annotated[int, Field(ge=0)] = 0
    held_out: Annotated[int, Field(ge=0, le=100)] = 2
    touches: Count = 8
    until: Annotated[float, Field(gt=0, lt=1)] | None = None
    budget_s: Annotated[float, Field(gt=0, allow_inf_nan=False)] | None = None
    criterion: Literal["I", "A", "D"] = "I"
    plan_for: str = "ft300s"
    candidates: Annotated[int, Field(ge=1, le=100_000)] = 4000
    thought: Literal["own_weight", "rigid", "either"] | None = None
    settings: dict[str, Any] = {}

    @field_validator("plan_for", mode="after")
    @classmethod
    def _known_sensor(cls, name: str) -> str:
        preset(name)
        return name

    @model_validator(mode="after")
    def _known_kind(self) -> Self:
        if self.kind not in POLICIES:
            build_policy(self.kind, self.settings, POLICIES, self.touches, PolicyContext())
        elif self.settings:
            allowed = f'none: {self.kind} has its fields in [policy]; settings are for a kind = "package:Class"'
            raise InvalidValueError("settings", self.settings, allowed)
        return self

    @property
    def own_draw(self) -> bool:
        """Whether each draw of a sensor's errors has trials of its own: what was felt decides the next."""
        return self.kind == "online"

    @property
    def expected_trials(self) -> int:
        """Trials a cell where nothing goes wrong, the weighing among them."""
        chosen = self.accelerated + self.pivots if self.kind == "paper" else self.touches
        return 1 + chosen + self.held_out

    def build(
        self,
        grasps: tuple[int, ...],
        particles: ObjectModel,
        settings: RunnerSettings,
        sensing: str | None = None,
        refused: Mapping[Action, str] | None = None,
    ) -> ActionPolicy:
        """The policy over the grasps that may be used; of the object it is context shape and weight.

        Args:
            grasps: which may be used.
            particles: the object, with the estimator's particles.
            settings: of the bench, which is asked what it can do.
            sensing: how a policy feels whose draws have trials of their own; `plan_for` if left out.
            refused: what the bench refused when it was run; may grow later.
        """
        if self.kind == "paper":
            return RankDriven(self.pivots, self.duration, self.accelerated, self.most, self.seed, grasps)
        guess = Guess(particles.total_mass, preset(self.plan_for))
        check = FeasibilityCheck(particles.shape, guess, settings, {} if refused is None else refused)
        if self.kind not in POLICIES:
            context = PolicyContext(grasps, particles.total_mass, check)
            return build_policy(self.kind, self.settings, POLICIES, self.touches, context)
        goal = Goal(self.until, self.budget_s, self.touches)
        searched = {"candidates": self.candidates, "grasps": grasps, "seed": self.seed, "feasible": check}
        if self.kind == "online":
            guess = replace(
                guess, sensing=preset(sensing or self.plan_for), supports=ASSUMED_SUPPORTS[self.thought or "either"]
            )
            return OnlinePolicy(guess, goal, self.criterion, **searched)
        guess = replace(guess, supports=ASSUMED_SUPPORTS[self.thought or "own_weight"])
        return PlannedPolicy(guess, self.kind, self.criterion, goal, **searched)  # pyright: ignore[reportArgumentType]

    def asked(self) -> dict[str, Any]:
        """All that decides its choices, as plain data."""
        return self.model_dump() | ({} if self.kind in POLICIES else code_of(self.kind))

    def build_held_out(self, shape: ObjectShape, grasps: tuple[int, ...]) -> list[Rotate]:
        """Turns for prediction, which no method is given."""
        return held_out_turns(shape, grasps, self.held_out, self.duration, self.seed)


LIBRARY = Path(__file__).parent / "library"


class Strict(BaseModel):
    """Every field is known, and nothing changes after reading."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class Grid(Strict):
    """How finely a block is cut."""

    feet: Annotated[int, Field(ge=1, le=20)] = 3
    particles: Annotated[int, Field(ge=1, le=20)] = 3


class Simulation(Strict):
    """Settings of the simulated bench, what is left out keeping its measured default; or somebody else's bench."""

    timestep_s: Annotated[float, Field(gt=0, le=0.002)] = 0.001
    grip: Literal["friction", "weld"] = "friction"
    grip_force_N: Annotated[float, Field(ge=20, le=235)] = GripSettings().force
    sag_m: Annotated[float, Field(gt=0, le=0.01)] = ContactSettings().sag
    integral_gain: Annotated[float, Field(ge=0, le=10)] = ServoSettings().integral_gain
    null_gain: Annotated[float, Field(ge=0, le=2)] = ServoSettings().null_gain
    runner: str | None = None
    settings: dict[str, Any] = {}

    @model_validator(mode="after")
    def _one_bench(self) -> Self:
        if self.runner is None:
            if self.settings:
                allowed = "none: the simulated bench has its fields in [simulation]; settings are for a runner"
                raise InvalidValueError("settings", self.settings, allowed)
            return self
        fields = set(type(self).model_fields) - {"runner", "settings"}
        if ours := sorted(name for name in fields if getattr(self, name) != type(self).model_fields[name].default):
            raise InvalidValueError("runner", self.runner, f"settings of its own in place of {', '.join(ours)}")
        NamedRunner.of(self.runner, self.settings).open()
        return self

    def build(self) -> RunnerSettings:
        """The bench's settings."""
        if self.runner is not None:
            return NamedRunner.of(self.runner, self.settings)
        return SimulationSettings(
            timestep=self.timestep_s,
            contact=ContactSettings(sag=self.sag_m),
            grip=GripSettings(mode=self.grip, force=self.grip_force_N),
            servo=ServoSettings(integral_gain=self.integral_gain, null_gain=self.null_gain),
        )


class Truth(Strict):
    """Changes to what is true of every object, which no method is context."""

    friction: Annotated[float, Field(gt=0, le=2)] | None = None
    friction_spread: Annotated[float, Field(ge=0, le=1)] = 0.0
    seed: Annotated[int, Field(ge=0)] = 0

    def applied(self, model: ObjectModel) -> ObjectModel:
        """The object with another friction, or with one of its own under every group (log-normal about the group's)."""
        shape, friction = model.shape, np.array(model.truth.friction)
        if self.friction is not None:
            friction = np.full_like(friction, self.friction)
        if self.friction_spread:
            touching = shape.friction_group >= 0
            pairs = np.stack([shape.mass_group, shape.friction_group], axis=1)
            found, index = np.unique(pairs[touching], axis=0, return_inverse=True)
            groups = np.full(len(shape.particles), -1)
            groups[touching] = index
            noise = np.random.default_rng([self.seed, crc32(model.name.encode())]).standard_normal(len(found))
            friction = friction[found[:, 1]] * np.exp(self.friction_spread * noise)
            shape = replace(shape, friction_group=groups)
        return replace(model, shape=shape, truth=MassDistribution(model.truth.mass, friction))


class Sweep(Strict):
    """Fields of the scenario that take several values: every combination (grid), or side by side (zip)."""

    mode: Literal["grid", "zip"] = "grid"
    axes: dict[str, Annotated[list[Any], Field(min_length=1)]] = {}

    @model_validator(mode="after")
    def _same_length(self) -> Self:
        if self.mode == "zip" and len({len(values) for values in self.axes.values()}) > 1:
            lengths = {name: len(values) for name, values in self.axes.items()}
            raise InvalidValueError("sweep.axes", lengths, "equally many values on every axis, to go side by side")
        return self

    def points(self) -> list[dict[str, Any]]:
        """Value of each axis, at every point."""
        rows = zip(*self.axes.values(), strict=True) if self.mode == "zip" else product(*self.axes.values())
        return [dict(zip(self.axes, row, strict=True)) for row in rows] or [{}]


class Scenario(Strict):
    """A whole scenario file."""

    objects: list[str] = []
    random: list[Family] = []
    support: Annotated[list[str | float], Field(min_length=1)] = ["own_weight"]
    sensing: Annotated[list[str], Field(min_length=1)] = ["ideal"]
    seeds: Count = 8
    grid: Grid = Grid()
    policy: Policy = Policy()
    simulation: Simulation = Simulation()
    truth: Truth = Truth()
    sweep: Sweep = Sweep()
    methods: Annotated[dict[str, dict[str, Any]], Field(min_length=1)] = {"hidden_states": {}}

    @field_validator("sensing", mode="after")
    @classmethod
    def _known_sensing(cls, names: list[str]) -> list[str]:
        for name in names:
            preset(name)
        return names

    @field_validator("support", mode="after")
    @classmethod
    def _known_support(cls, values: list[str | float]) -> list[str | float]:
        for value in values:
            parse_support(value)
        return values

    @model_validator(mode="after")
    def _whole(self) -> Self:
        for label, settings in self.methods.items():
            build_method(label, settings)
        if not (self.objects or self.random):
            raise InvalidValueError("objects", [], "one object or more: names, paths, or a [[random]] family")
        names = [family.name for family in self.random]
        if len(set(names)) < len(names):
            raise InvalidValueError("random", names, "a name of its own for each family")
        self.points()
        return self

    def changed(
        self,
        seeds: int | None = None,
        objects: Sequence[str] | None = None,
        methods: Sequence[str] | None = None,
    ) -> Scenario:
        """The scenario with the command line's changes.

        Raises:
            InvalidValueError: fewer than one seed, or an unknown method.
        """
        if seeds is not None and seeds < 1:
            raise InvalidValueError("--seeds", seeds, "an integer >= 1")
        changes: dict[str, object] = {} if seeds is None else {"seeds": seeds}
        if objects:
            changes |= {"objects": list(objects), "random": []}
        if methods:
            known = self.methods
            if unknown := [label for label in methods if not (label in known or is_method(label))]:
                allowed = f"some of the scenario's {', '.join(known)}{nearest(unknown[0], known)}; or any other method"
                raise InvalidValueError("--methods", " ".join(unknown), f"{allowed} by name or package:Class")
            changes["methods"] = {label: known.get(label, {}) for label in methods}
            for label in methods:
                build_method(label, known.get(label, {}))
        return self.model_copy(update=changes)

    def supports(self) -> list[Support]:
        """Who carries the weight, in order."""
        return [parse_support(value) for value in self.support]

    def draws(self, sensing: str) -> int:
        """Sensing draws of each trial: a perfect sensor needs one."""
        return 1 if sensing == "ideal" else self.seeds

    def own_draws(self) -> list[tuple[str, int] | None]:
        """Sensor and seed of every draw that has trials of its own; one None where all draws share theirs."""
        if not self.policy.own_draw:
            return [None]
        return [(sensing, seed) for sensing in self.sensing for seed in range(self.draws(sensing))]

    def points(self) -> list[tuple[dict[str, Any], Scenario]]:
        """Every point of the sweep: the axes' values, and the scenario there.

        Raises:
            InvalidValueError: an axis that is no field, or a value that does not fit its field.
        """
        if not self.sweep.axes:
            return [({}, self)]
        plain = self.model_dump() | {"sweep": {}}
        return [(point, self._at(plain, point)) for point in self.sweep.points()]

    def _at(self, plain: dict[str, Any], point: dict[str, Any]) -> Scenario:
        """The scenario with some fields changed."""
        changed = deepcopy(plain)
        for name, value in point.items():
            table, *path = changed, *name.split(".")
            for key in path[:-1]:
                table = table[key] if isinstance(table, dict) and isinstance(table.get(key), dict) else None
            if not isinstance(table, dict) or (path[-1] not in table and not {"methods", "settings"} & {*path[:-1]}):
                known = [key for key in plain if key != "sweep"]
                allowed = f"a field as it stands in the file, such as grid.feet; tables and fields: {', '.join(known)}"
                raise InvalidValueError("sweep.axes", name, allowed)
            table[path[-1]] = value
        try:
            return Scenario.model_validate(changed)
        except ValidationError as error:
            allowed = "; ".join(explained(error, Scenario))
            raise InvalidValueError("sweep.axes", point, f"values that fit their fields: {allowed}") from None


def load_scenario(name_or_path: str) -> tuple[str, Scenario]:
    """A scenario of the library by name, or of a TOML file by path, with its name.

    Paths of objects are looked up beside the scenario's file first, then in the working folder.

    Raises:
        InvalidValueError: no such scenario.
        InvalidFileError: not TOML, or not fitting the schema.
    """
    path = find_file(name_or_path, LIBRARY, "scenario")
    scenario = load_toml(path, Scenario)
    return path.stem, scenario.model_copy(update={"objects": [_beside(name, path.parent) for name in scenario.objects]})


def _beside(name: str, folder: Path) -> str:
    """An object's path as seen from the scenario's folder, where there is such a file; else the name as it is."""
    beside = folder / name
    return str(beside) if name.endswith(".toml") and beside.is_file() else name


def scenario_names() -> list[str]:
    """Names of the scenarios in the library."""
    return library_names(LIBRARY)
