"""Scenarios as TOML files: which objects, supports and sensors, which actions, which methods."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, field_validator, model_validator

from estimators.diff_lcp import DiffLcp
from estimators.explicit_state import ExplicitState
from estimators.hidden_states import HiddenStatesEstimator
from estimators.protocol import Estimator
from estimators.random_search import RandomSearch
from estimators.rank_driven import RankDriven, held_out_turns
from estimators.weighted_sampling import WeightedSampling
from testbed.actions import Rotate
from testbed.errors import InvalidValueError
from testbed.object_files import load_toml
from testbed.objects import ObjectShape
from testbed.resources import find_file, library_names
from testbed.sensing import preset
from testbed.simulation.settings import ContactSettings, GripSettings, ServoSettings, SimulationSettings
from testbed.trial import Support, parse_support

METHODS: dict[str, type[Estimator]] = {
    "hidden_states": HiddenStatesEstimator,
    "random_search": RandomSearch,
    "weighted_sampling": WeightedSampling,
    "explicit_state": ExplicitState,
    "diff_lcp": DiffLcp,
}
"""Methods by name; their settings are the fields of the class."""
LIBRARY = Path(__file__).parent / "library"

Count = Annotated[int, Field(ge=1, le=100_000)]


class Strict(BaseModel):
    """Every field is known, and nothing changes after reading."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class Grid(Strict):
    """How finely a block is cut."""

    feet: Annotated[int, Field(ge=1, le=20)] = 3
    particles: Annotated[int, Field(ge=1, le=20)] = 3


class Policy(Strict):
    """Settings of the rank-driven choice of actions."""

    pivots: Annotated[int, Field(ge=1)] = 6
    duration: Annotated[float, Field(gt=1.5, le=60)] = 18.0
    accelerated: Annotated[int, Field(ge=0)] = 6
    most: Count = 40
    seed: Annotated[int, Field(ge=0)] = 0
    held_out: Annotated[int, Field(ge=0, le=100)] = 2

    @property
    def expected_trials(self) -> int:
        """Trials a cell where nothing goes wrong, the weighing among them."""
        return 1 + self.accelerated + self.pivots + self.held_out

    def build(self, grasps: tuple[int, ...]) -> RankDriven:
        """The policy over the grasps that may be used."""
        return RankDriven(**self.model_dump(exclude={"held_out"}), grasps=grasps)

    def build_held_out(self, shape: ObjectShape, grasps: tuple[int, ...]) -> list[Rotate]:
        """Turns for prediction, which no method is given."""
        return held_out_turns(shape, grasps, self.held_out, self.duration, self.seed)


class Simulation(Strict):
    """Settings of the simulated bench; what is left out keeps its measured default."""

    timestep_s: Annotated[float, Field(gt=0, le=0.002)] = 0.001
    grip: Literal["friction", "weld"] = "friction"
    grip_force_N: Annotated[float, Field(ge=20, le=235)] = GripSettings().force
    sag_m: Annotated[float, Field(gt=0, le=0.01)] = ContactSettings().sag
    integral_gain: Annotated[float, Field(ge=0, le=10)] = ServoSettings().integral_gain
    null_gain: Annotated[float, Field(ge=0, le=2)] = ServoSettings().null_gain

    def build(self) -> SimulationSettings:
        """The runner's settings."""
        return SimulationSettings(
            timestep=self.timestep_s,
            contact=ContactSettings(sag=self.sag_m),
            grip=GripSettings(mode=self.grip, force=self.grip_force_N),
            servo=ServoSettings(integral_gain=self.integral_gain, null_gain=self.null_gain),
        )


class Scenario(Strict):
    """A whole scenario file."""

    objects: Annotated[list[str], Field(min_length=1)]
    support: Annotated[list[str | float], Field(min_length=1)] = ["own_weight"]
    sensing: Annotated[list[str], Field(min_length=1)] = ["ideal"]
    seeds: Count = 8
    grid: Grid = Grid()
    policy: Policy = Policy()
    simulation: Simulation = Simulation()
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
    def _known_methods(self) -> Self:
        for name in self.methods:
            self.method(name)
        return self

    def supports(self) -> list[Support]:
        """Who carries the weight, in order."""
        return [parse_support(value) for value in self.support]

    def kind(self, label: str) -> str:
        """Which method a label stands for: the setting `method`, or the label itself."""
        return str(self.methods.get(label, {}).get("method", label))

    def method(self, label: str) -> Estimator:
        """A method by its label, with the scenario's settings.

        Raises:
            InvalidValueError: unknown method or setting, or a value out of range.
        """
        name, settings = self.kind(label), dict(self.methods.get(label, {}))
        settings.pop("method", None)
        if name not in METHODS:
            raise InvalidValueError(
                "methods", name, f"one of {', '.join(METHODS)}, or any label with a method of these"
            )
        kind = METHODS[name]
        known = [f.name for f in fields(kind)]  # pyright: ignore[reportArgumentType]
        if unknown := sorted(set(settings) - set(known)):
            raise InvalidValueError(f"methods.{label}", ", ".join(unknown), f"settings method, {', '.join(known)}")
        return kind(**{key: tuple(v) if isinstance(v, list) else v for key, v in settings.items()})


def load_scenario(name_or_path: str) -> tuple[str, Scenario]:
    """A scenario of the library by name, or of a TOML file by path, with its name.

    Raises:
        InvalidValueError: no such scenario.
        InvalidFileError: not TOML, or not fitting the schema.
    """
    path = find_file(name_or_path, LIBRARY, "scenario")
    return path.stem, load_toml(path, Scenario)


def scenario_names() -> list[str]:
    """Names of the scenarios in the library."""
    return library_names(LIBRARY)
