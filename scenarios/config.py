"""Scenario files: their tables and fields, the sweep of a field, and the library of scenarios."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from copy import deepcopy
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator, model_validator

from estimators.registry import check_method, is_method
from scenarios.catalog import LIBRARY
from scenarios.policies import FIELDS_OF, Count, Policy
from scenarios.runners import NamedRunner, RunnerSettings
from testbed.errors import InvalidValueError, nearest
from testbed.files import find_file
from testbed.objects.model import MassDistribution, ObjectModel
from testbed.objects.random import Family
from testbed.plugins import RUNNER, check_name
from testbed.sensing.presets import preset
from testbed.simulation.settings import (
    ContactSettings,
    GripSettings,
    ServoSettings,
    SimulationSettings,
)
from testbed.toml import InvalidFileError, explained, load_toml
from testbed.trial import Support, parse_support
from testbed.worlds.draw import WorldDraw
from testbed.worlds.presets import QUANTITIES, World
from testbed.worlds.presets import world as named_world
from testbed.worlds.seeds import seed_of

MOST_POINTS = 10_000
"""Points of the largest sweep."""


class Strict(BaseModel):
    """Base of the tables: unknown fields are refused, and fields are read-only."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)


class Grid(Strict):
    """Resolution of a block."""

    feet: Annotated[int, Field(ge=1, le=20)] = 3
    particles: Annotated[int, Field(ge=1, le=20)] = 3


class Simulation(Strict):
    """Settings of the simulation, each with its measured default; or a runner of another package."""

    timestep_s: Annotated[float, Field(gt=0, le=0.01)] = 0.005
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
            self.build()
            return self
        fields = set(type(self).model_fields) - {"runner", "settings"}
        if ours := sorted(name for name in fields if getattr(self, name) != type(self).model_fields[name].default):
            raise InvalidValueError("runner", self.runner, f"settings of its own in place of {', '.join(ours)}")
        check_name(self.runner, RUNNER, "runner")
        return self

    def check_code(self) -> None:
        """Import another package's runner, and check that it takes the settings.

        Raises:
            InvalidValueError: no such class, or a setting that it refuses.
        """
        if self.runner is not None:
            NamedRunner.of(self.runner, self.settings).open()

    def build(self) -> RunnerSettings:
        """Settings of the runner."""
        if self.runner is not None:
            return NamedRunner.of(self.runner, self.settings)
        return SimulationSettings(
            timestep=self.timestep_s,
            contact=ContactSettings(sag=self.sag_m),
            grip=GripSettings(mode=self.grip, force=self.grip_force_N),
            servo=ServoSettings(integral_gain=self.integral_gain, null_gain=self.null_gain),
        )


class Truth(Strict):
    """Changes to the truth of every object, hidden from every method."""

    friction: Annotated[float, Field(gt=0, le=2)] | None = None
    friction_spread: Annotated[float, Field(ge=0, le=1)] = 0.0
    seed: Annotated[int, Field(ge=0)] = 0

    def applied(self, model: ObjectModel, secret: str) -> ObjectModel:
        """Object with another friction, or with a friction for each mass group, log-normal about the object's.

        Args:
            model: the object.
            secret: secret of the run, which seeds the draw.
        """
        shape, friction = model.shape, np.array(model.truth.friction)
        if self.friction is not None:
            friction = np.full_like(friction, self.friction)
        if self.friction_spread:
            touching = shape.friction_group >= 0
            pairs = np.stack([shape.mass_group, shape.friction_group], axis=1)
            found, index = np.unique(pairs[touching], axis=0, return_inverse=True)
            groups = np.full(len(shape.particles), -1)
            groups[touching] = index
            rng = np.random.default_rng(seed_of(secret, "friction", self.seed, model.name))
            noise = rng.standard_normal(len(found))
            friction = friction[found[:, 1]] * np.exp(self.friction_spread * noise)
            shape = replace(shape, friction_group=groups)
        return replace(model, shape=shape, truth=MassDistribution(model.truth.mass, friction))


class WorldTable(Strict):
    """World by name, changes to its quantities, a restriction to one source of error, and the seed of its draws."""

    model_config = ConfigDict(extra="allow", frozen=True, strict=True)

    preset: str = "ideal"
    only: str = "all"
    seed: Annotated[int, Field(ge=0)] = 0

    @model_validator(mode="after")
    def _sound(self) -> Self:
        self.build()
        return self

    def build(self) -> World:
        """The world."""
        given: dict[str, Any] = self.model_extra or {}
        if unknown := sorted(set(given) - set(QUANTITIES)):
            allowed = f"quantities of a world{nearest(unknown[0], QUANTITIES)}: {', '.join(QUANTITIES)}"
            raise InvalidValueError("world", unknown, allowed)
        built = replace(named_world(self.preset, "preset"), **given)
        return built if self.only == "all" else World() if self.only == "none" else built.only(self.only)

    def draw(self, model: ObjectModel, number: int, secret: str) -> WorldDraw | None:
        """Draw `number` of the world for an object; None in the ideal one."""
        built = self.build()
        return None if built.none else WorldDraw.of(built, model, f"{self.seed}/{number}", secret)


class Sweep(Strict):
    """Fields of the scenario with several values each: all combinations (grid), or the values in parallel (zip)."""

    mode: Literal["grid", "zip"] = "grid"
    axes: dict[str, Annotated[list[Any], Field(min_length=1)]] = {}

    @model_validator(mode="after")
    def _sound(self) -> Self:
        if self.mode == "zip" and len({len(values) for values in self.axes.values()}) > 1:
            lengths = {name: len(values) for name, values in self.axes.items()}
            raise InvalidValueError("sweep.axes", lengths, "equally many values on every axis, to go side by side")
        points = [json.dumps(point, sort_keys=True, default=str) for point in self.points()]
        if len(set(points)) < len(points):
            raise InvalidValueError("sweep.axes", self.axes, "points that differ: no value twice")
        return self

    def points(self) -> list[dict[str, Any]]:
        """Value of each axis at every point."""
        sizes = [len(values) for values in self.axes.values()]
        if (count := max(sizes, default=1) if self.mode == "zip" else math.prod(sizes)) > MOST_POINTS:
            raise InvalidValueError("sweep.axes", f"{count} points", f"at most {MOST_POINTS} combinations")
        rows = zip(*self.axes.values(), strict=True) if self.mode == "zip" else product(*self.axes.values())
        return [dict(zip(self.axes, row, strict=True)) for row in rows] or [{}]


class Meshes(Strict):
    """Objects converted from the mesh files in the folder of the option --data."""

    files: str = "*/mesh.ply"
    notes: str = "Inertia.yaml"
    mass_kg: Annotated[float, Field(gt=0, le=50)] | None = None
    friction: Annotated[float, Field(gt=0, le=2)] = 0.5
    source: str = "mesh files, each in a folder of its object's name"
    sha256: dict[str, str] = {}


class Scenario(Strict):
    """Content of a scenario file."""

    objects: list[str] = []
    meshes: Meshes | None = None
    random: list[Family] = []
    support: Annotated[list[str | float], Field(min_length=1)] = ["own_weight"]
    sensing: Annotated[list[str], Field(min_length=1)] = ["ideal"]
    seeds: Count = 8
    grid: Grid = Grid()
    policy: Policy = Policy()
    simulation: Simulation = Simulation()
    truth: Truth = Truth()
    world: WorldTable = WorldTable()
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
            check_method(label, settings)
        if not (self.objects or self.random or self.meshes):
            allowed = "one object or more: names, paths, a [[random]] family, or [meshes]"
            raise InvalidValueError("objects", [], allowed)
        if self.simulation.runner is not None and not self.world.build().none:
            raise InvalidValueError("world.preset", self.world.preset, "ideal: another runner has a world of its own")
        names = [family.name for family in self.random]
        if len(set(names)) < len(names):
            raise InvalidValueError("random", names, "a name of its own for each family")
        self.points()
        return self

    def replaced(self, **fields: Any) -> Scenario:
        """Scenario with other values of some fields.

        Raises:
            InvalidFileError: no such field, or a value that does not fit; the message has a line for each error.
        """
        try:
            return Scenario.model_validate(self.model_dump() | fields)
        except ValidationError as error:
            raise InvalidFileError("\n".join(explained(error, Scenario))) from None

    def changed(
        self,
        seeds: int | None = None,
        objects: Sequence[str] | None = None,
        methods: Sequence[str] | None = None,
        world: str | None = None,
    ) -> Scenario:
        """Scenario with the changes of the command line.

        Raises:
            InvalidValueError: fewer than one seed, an unknown method or world, or a field that [sweep] sets.
        """
        given = (
            ("--seeds", seeds, ("seeds",)),
            ("--objects", objects, ("objects", "random")),
            ("--methods", methods, ("methods",)),
            ("--world", world, ("world", "world.preset")),
        )
        for option, value, fields in given:
            if value and (swept := [field for field in fields if field in self.sweep.axes]):
                raise InvalidValueError(option, value, f"none: [sweep] sets {swept[0]} in this scenario")
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
                check_method(label, known.get(label, {}))
        if world is not None:
            changes["world"] = WorldTable.model_validate(self.world.model_dump() | {"preset": named_world(world).name})
            if self.simulation.runner is not None:
                raise InvalidValueError("--world", world, "none: another runner has a world of its own")
        return self.model_copy(update=changes)

    def all_objects(self) -> list[str]:
        """Names and paths of its objects, then the names of the random ones."""
        return [*self.objects, *(name for family in self.random for name in family.names())]

    def supports(self) -> list[Support]:
        """Supports that carry the weight, in order."""
        return [parse_support(value) for value in self.support]

    def draws(self, sensing: str) -> int:
        """Number of draws of world and sensor; 1 of a perfect sensor in the ideal world."""
        return 1 if sensing == "ideal" and self.world.build().none else self.seeds

    def own_draws(self) -> list[tuple[str, int] | None]:
        """Sensor and seed of each draw with trials of its own; a single None where all draws share their trials."""
        if not self.policy.own_draw and self.world.build().none:
            return [None]
        return [(sensing, seed) for sensing in self.sensing for seed in range(self.draws(sensing))]

    def points(self) -> list[tuple[dict[str, Any], Scenario]]:
        """Points of the sweep: values of the axes, and the scenario at the point.

        Raises:
            InvalidValueError: an axis that is no field, or a value that does not fit its field.
        """
        if not self.sweep.axes:
            return [({}, self)]
        plain = self.model_dump() | {"sweep": {}}
        points = [(point, self._at(plain, point)) for point in self.sweep.points()]
        for name in self.sweep.axes:
            table, _, field = name.partition(".")
            if table == "policy" and all(at.policy.ignores(field) for _, at in points):
                used = [other for other, kinds in FIELDS_OF.items() if points[0][1].policy.kind in kinds]
                allowed = (
                    f"a field that policy {points[0][1].policy.kind} uses: policy.{', policy.'.join(used) or 'seed'}"
                )
                raise InvalidValueError("sweep.axes", name, allowed)
        return points

    def _at(self, plain: dict[str, Any], point: dict[str, Any]) -> Scenario:
        """Scenario at a point of the sweep."""
        changed = deepcopy(plain)
        for name, value in point.items():
            table, *path = changed, *name.split(".")
            for key in path[:-1]:
                table = table[key] if isinstance(table, dict) and isinstance(table.get(key), dict) else None
            if not isinstance(table, dict) or (
                path[-1] not in table and not {"methods", "settings", "world"} & {*path[:-1]}
            ):
                known = [key for key in plain if key != "sweep"]
                allowed = f"a field as it stands in the file, such as grid.feet; tables and fields: {', '.join(known)}"
                inner = [f"{key}.{field}" for key in known if isinstance(plain[key], dict) for field in plain[key]]
                raise InvalidValueError("sweep.axes", name, allowed + nearest(name, [*known, *inner]))
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
    """Path of an object's file in the folder of the scenario, if it exists; otherwise the name unchanged."""
    beside = folder / name
    return str(beside) if name.endswith(".toml") and beside.is_file() else name
