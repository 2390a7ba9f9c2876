"""The [policy] table of a scenario: how actions are chosen."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Annotated, Any, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, field_validator, model_validator

from estimators.design import THOUGHT, Guess
from estimators.online_policy import OnlineTouches
from estimators.planned_policy import PlannedTouches
from estimators.protocol import ActionPolicy
from estimators.rank_driven import RankDriven, held_out_turns
from estimators.touch_plan import Goal
from scenarios.bench_check import BenchCheck
from scenarios.benches import BenchSettings
from scenarios.policies import Told, build_policy, code_of
from testbed.actions import Action, Rotate
from testbed.errors import InvalidValueError
from testbed.objects import ObjectModel, ObjectShape
from testbed.sensing import preset

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
            build_policy(self.kind, self.settings, POLICIES, self.touches, Told())
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
        settings: BenchSettings,
        sensing: str | None = None,
        refused: Mapping[Action, str] | None = None,
    ) -> ActionPolicy:
        """The policy over the grasps that may be used; of the object it is told shape and weight.

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
        check = BenchCheck(particles.shape, guess, settings, {} if refused is None else refused)
        if self.kind not in POLICIES:
            told = Told(grasps, particles.total_mass, check)
            return build_policy(self.kind, self.settings, POLICIES, self.touches, told)
        goal = Goal(self.until, self.budget_s, self.touches)
        searched = {"candidates": self.candidates, "grasps": grasps, "seed": self.seed, "feasible": check}
        if self.kind == "online":
            guess = replace(guess, sensing=preset(sensing or self.plan_for), supports=THOUGHT[self.thought or "either"])
            return OnlineTouches(guess, goal, self.criterion, **searched)
        guess = replace(guess, supports=THOUGHT[self.thought or "own_weight"])
        return PlannedTouches(guess, self.kind, self.criterion, goal, **searched)  # pyright: ignore[reportArgumentType]

    def asked(self) -> dict[str, Any]:
        """All that decides its choices, as plain data."""
        return self.model_dump() | ({} if self.kind in POLICIES else code_of(self.kind))

    def build_held_out(self, shape: ObjectShape, grasps: tuple[int, ...]) -> list[Rotate]:
        """Turns for prediction, which no method is given."""
        return held_out_turns(shape, grasps, self.held_out, self.duration, self.seed)
