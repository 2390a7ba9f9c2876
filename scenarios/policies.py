"""Action policies of a scenario: the [policy] table, and policies of other packages by name."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Annotated, Any, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, field_validator, model_validator

from estimators.action_selection.candidates import ActionFamily
from estimators.action_selection.design import ASSUMED_SUPPORTS, Guess
from estimators.action_selection.greedy import PlannedPolicy
from estimators.action_selection.online import OnlinePolicy
from estimators.action_selection.plan import Goal
from estimators.action_selection.random import RandomDrags, RandomPushes
from estimators.action_selection.rank import RANK_DRIVEN, RankDriven, held_out_grasp, held_out_turns, sees_every_load
from estimators.action_selection.stop_and_go import StopAndGo
from estimators.base import ActionPolicy
from estimators.registry import POLICY
from scenarios.runners import FeasibilityCheck, RunnerSettings
from testbed.actions.base import Action
from testbed.actions.rotate import Rotate
from testbed.errors import InvalidValueError
from testbed.objects.model import ObjectModel, ObjectShape
from testbed.plugins import check_name, configured, find_class, placed_errors, source_hash
from testbed.sensing.noise import check_reading, read_scale
from testbed.sensing.presets import preset
from testbed.trajectory import Trajectory
from testbed.worlds.seeds import seed_of
from testbed.worlds.setup_errors import EXACT_SETUP, SetupErrors

Count = Annotated[int, Field(ge=1, le=100_000)]
POLICIES = (*RANK_DRIVEN, "stop_and_go", "push", "drag", "greedy", "batch", "random", "online")
"""heft's own policies."""
PLANNED = ("greedy", "batch", "random", "online")
"""Policies that choose among drawn candidates, pushes among them where `pushes` is given."""


FIELDS_OF = {
    **dict.fromkeys(("pivots", "accelerated", "most"), tuple(RANK_DRIVEN)),
    "touches": ("push", "drag", *PLANNED),
    **dict.fromkeys(("until", "budget_s", "criterion", "candidates", "assumed_support"), PLANNED),
}
"""heft's own policies that use a field, for the fields that some of them ignore."""


@dataclass(frozen=True)
class PolicyContext:
    """Arguments that heft passes to the class of a policy, where its signature has their names."""

    grasps: tuple[int, ...] = (0,)
    """Grasps that may be used."""
    weight_kg: float = 1.0
    """M as weighed [kg]."""
    feasible: Callable[[Action], str] = lambda action: ""
    """Reason why the robot cannot do an action; empty where it can."""


@dataclass(frozen=True)
class NamedPolicy:
    """Policy of another package, limited to `most` actions and to the allowed grasps."""

    name: str
    policy: ActionPolicy
    most: int
    """Largest number of actions."""
    grasps: tuple[int, ...]
    """Grasps that may be used."""

    def next(self, shape: ObjectShape, trajectories: Sequence[Trajectory]) -> Action | None:
        """Next action; None when the policy asks for no more, or after `most` trials.

        Raises:
            InvalidValueError: no action, or one of a grasp that may not be used.
            HeftError: it raised an error of its own.
        """
        if len(trajectories) >= self.most:
            return None
        field = f"{self.name}.next()"
        with placed_errors(type(self.policy), field):
            action = self.policy.next(shape, tuple(trajectories))
        if action is None:
            return None
        if not isinstance(action, Action) or not action.moves:
            raise InvalidValueError(field, action, "an action of testbed.actions on the table, or None when content")
        if action.grasp not in self.grasps:
            raise InvalidValueError(f"{field}.grasp", action.grasp, f"a grasp that may be used: {self.grasps}")
        return action


@dataclass(frozen=True, eq=False)
class AfterWeighing:
    """Policy that is built once the object is weighed."""

    build: Callable[[float], ActionPolicy]
    """Policy for a reading of the scale [kg]."""
    weighed: Sequence[float]
    """Reading of the scale [kg], once there is one."""

    @cached_property
    def policy(self) -> ActionPolicy:
        """The policy.

        Raises:
            InvalidValueError: the object has not been weighed.
        """
        if not self.weighed:
            raise InvalidValueError("policy", "no weighing", "an object that was weighed with status ok")
        return self.build(self.weighed[0])

    def next(self, shape: ObjectShape, trajectories: Sequence[Trajectory]) -> Action | None:
        """Next action of the policy."""
        return self.policy.next(shape, trajectories)


def build_policy(kind: str, settings: Mapping[str, Any], most: int, context: PolicyContext) -> ActionPolicy:
    """Build a policy by "package:Class" or entry point.

    Args:
        kind: name as the scenario has it.
        settings: arguments of its class.
        most: largest number of actions.
        context: facts beside the shape.

    Raises:
        InvalidValueError: unknown policy or setting, or a value that the class refuses.
    """
    found = find_class(kind, POLICY, "kind", POLICIES)
    return NamedPolicy(kind, configured(found, settings, "settings", given=vars(context)), most, context.grasps)


def code_of(kind: str) -> dict[str, str]:
    """Source hash of a policy of another package, which determines its actions together with the settings."""
    return {"source": source_hash(find_class(kind, POLICY, "kind"))}


class Policy(BaseModel):
    """Choice of actions: by the paper's rank, by a plan before any trial or after each, or by a class by name."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)

    kind: str = "reversed_pairs"
    pivots: Annotated[int, Field(ge=1)] | None = None
    duration: Annotated[float, Field(gt=1.5, le=60)] = 18.0
    accelerated: Annotated[int, Field(ge=0)] | None = None
    most: Count = 40
    seed: Annotated[int, Field(ge=0)] = 0
    redraw: bool = False
    lifts: Annotated[int, Field(ge=0, le=100)] | None = None
    pushes: Count | None = None
    held_out: Annotated[int, Field(ge=0, le=100)] = 2
    touches: Count = 8
    until: Annotated[float, Field(gt=0, lt=1)] | None = None
    budget_s: Annotated[float, Field(gt=0, allow_inf_nan=False)] | None = None
    criterion: Literal["I", "A", "D"] = "I"
    plan_for: str = "ft300s"
    most_friction: Annotated[float, Field(gt=0, le=2)] = 0.6
    candidates: Annotated[int, Field(ge=1, le=100_000)] = 4000
    assumed_support: Literal["own_weight", "rigid", "either"] | None = None
    settings: dict[str, Any] = {}

    @field_validator("plan_for", mode="after")
    @classmethod
    def _known_sensor(cls, name: str) -> str:
        preset(name, "")
        return name

    @model_validator(mode="after")
    def _known_kind(self) -> Self:
        if self.kind not in POLICIES:
            check_name(self.kind, POLICY, "kind", POLICIES)
        elif self.settings:
            allowed = f'none: {self.kind} has its fields in [policy]; settings are for a kind = "package:Class"'
            raise InvalidValueError("settings", self.settings, allowed)
        if self.pushes and self.kind in ("push", "drag", "stop_and_go"):
            raise InvalidValueError("pushes", self.pushes, f"none with {self.kind}: after turns by rank, or in a plan")
        alone = self.kind not in POLICIES or self.support_in_plan == "own_weight"
        if self.lifts and self.lifts_last is None and alone:
            allowed = f'with {self.kind}: none, but assumed_support = "rigid" or "either" in a plan of heft\'s own'
            raise InvalidValueError("lifts", self.lifts, allowed)
        return self

    def ignores(self, name: str) -> bool:
        """True if a field changes nothing in a policy of this kind."""
        return self.kind in POLICIES and self.kind not in FIELDS_OF.get(name, POLICIES)

    def check_code(self) -> None:
        """Import another package's policy, and check that it takes the settings.

        Raises:
            InvalidValueError: no such class, or a setting that it refuses.
        """
        if self.kind not in POLICIES:
            build_policy(self.kind, self.settings, self.touches, PolicyContext())

    @property
    def own_draw(self) -> bool:
        """True if each draw of the sensor's errors has its own trials, chosen at random or by its wrenches."""
        return self.redraw or self.kind == "online"

    def expected_trials(self, shape: ObjectShape | None = None) -> int:
        """Number of trials of an experiment where nothing fails, the weighing among them.

        Args:
            shape: object, which is pushed only if its turns leave a load open; None counts no pushes after turns.
        """
        ranked, grips = self.rank_driven, self.grips and (shape is None or len(shape.grasps) > 0)
        planned = 0 if self.kind == "stop_and_go" else self.touches
        if ranked:
            planned = (ranked.accelerated + ranked.pivots) * grips
        last = self.lifts_last or 0
        if ranked and not last and self.pushes and shape is not None and shape.stands_in_groups:
            turned = ranked.predicted_actions(shape) if grips else []
            if not sees_every_load(shape, [action for action in turned if action.dragged_steadily]):
                last = self.pushes
        return 1 + planned + last + self.held_out * grips

    @property
    def support_in_plan(self) -> str:
        """Support that a plan assumes, by name."""
        return self.assumed_support or ("either" if self.kind == "online" else "own_weight")

    @property
    def grips(self) -> bool:
        """True if the hand grips the object; a push needs no grasp, and makes no turns for prediction."""
        return self.kind != "push"

    @property
    def of_one_body(self) -> bool:
        """True if its actions determine the masses of a rigid object only, not those of links."""
        return self.lifts_last is not None

    @property
    def without_grasp(self) -> Policy | None:
        """The policy for an object that no hand can turn: `pushes` of it; None where it can only be left out."""
        if self.pushes is None:
            return None
        if self.kind in PLANNED:
            return self.model_copy(update={"touches": self.pushes, "lifts": None})
        return None if self.lifts else Policy(kind="push", touches=self.pushes, seed=self.seed)

    @property
    def takes_any_shape(self) -> bool:
        """True if an object that no hand can turn is not left out: it is pushed."""
        return not self.grips or self.without_grasp is not None

    @property
    def lifts_last(self) -> int | None:
        """Number of stop-and-go lifts after all other actions; None where a plan chooses them."""
        if self.kind == "stop_and_go":
            return 2 if self.lifts is None else self.lifts
        return (self.lifts or 0) if self.rank_driven else None

    @property
    def rank_driven(self) -> RankDriven | None:
        """The policy by rank(Q) over all grasps; None for another kind."""
        if self.kind not in RANK_DRIVEN:
            return None
        own = {name: n for name in ("pivots", "accelerated") if (n := getattr(self, name)) is not None}
        return replace(RANK_DRIVEN[self.kind], duration=self.duration, most=self.most, **own)

    def build(
        self,
        grasps: tuple[int, ...],
        shape: ObjectShape,
        settings: RunnerSettings,
        weighed: Sequence[float] = (),
        draw: tuple[str, int] | None = None,
        refused: Mapping[Action, str] | None = None,
        setup: SetupErrors = EXACT_SETUP,
    ) -> ActionPolicy:
        """The policy over the allowed grasps; of the object it gets shape and weight alone.

        Args:
            grasps: allowed grasps.
            shape: geometry with the estimator's particles.
            settings: settings of the runner, for the feasibility of actions.
            weighed: reading of the scale [kg]; it may be appended later, before the first call of `next`.
            draw: sensor and number of the draw that the trials are for; None where all draws share them.
            refused: actions that were refused when they were run, without numbers; may grow later.
            setup: errors of the setup as stated.
        """
        refused = {} if refused is None else refused
        sensing, number = draw or (self.plan_for, 0)
        seed = self.seed + (number if self.redraw else 0)
        if not self.grips:
            return RandomPushes(self.touches, seed, refused)
        if self.kind == "drag":
            return RandomDrags(self.touches, grasps, seed, refused)
        if self.lifts_last is not None:
            ranked = self.rank_driven
            before = None if ranked is None else replace(ranked, grasps=grasps, seed=seed, refused=refused)
            if before is not None and not self.lifts_last:
                pushed = self.pushes if shape.stands_in_groups else None  # else balance decides the loads, not rank(Q)
                return RandomPushes(pushed, seed, refused, before) if pushed else before
            return StopAndGo(self.lifts_last, grasps, before, refused)
        sensor = preset(sensing if self.kind == "online" else self.plan_for).stated

        def of_weight(weight: float) -> ActionPolicy:
            """The policy for a weight as read."""
            guess = Guess(weight, sensor, setup=setup)
            check = FeasibilityCheck(shape, guess, settings, refused)
            if self.kind not in POLICIES:
                return build_policy(self.kind, self.settings, self.touches, PolicyContext(grasps, weight, check))
            goal = Goal(self.until, self.budget_s, self.touches)
            family = ActionFamily(lifts=bool(self.lifts), pushes=self.pushes is not None)
            searched = (family, self.candidates, grasps, seed)
            guess = replace(guess, supports=ASSUMED_SUPPORTS[self.support_in_plan])
            if self.kind == "online":
                return OnlinePolicy(guess, goal, self.criterion, *searched, feasible=check)
            return PlannedPolicy(guess, self.kind, self.criterion, goal, *searched, feasible=check)  # pyright: ignore[reportArgumentType]

        return AfterWeighing(of_weight, weighed)

    def request(self) -> dict[str, Any]:
        """All that determines its choices, as plain data."""
        return self.model_dump() | ({} if self.kind in POLICIES else code_of(self.kind))

    def check(self, model: ObjectModel, settings: RunnerSettings, secret: str) -> FeasibilityCheck:
        """Check of actions before any trial: by the object's shape, a reading of the scale, and an upper friction.

        Args:
            model: the object.
            settings: runner of its trials.
            secret: secret of the run, which seeds the error of the reading.

        Raises:
            InfeasibleTrialError: the scale does not show the object.
        """
        sensor = preset(self.plan_for)
        reading = read_scale(model.total_mass, sensor, seed_of(secret, "scale", self.seed, model.name))
        check_reading(model.name, reading, sensor)
        return FeasibilityCheck(model.shape, Guess(reading, sensor.stated, self.most_friction), settings)

    def split(
        self, shape: ObjectShape, grasps: tuple[int, ...], number: int = 0
    ) -> tuple[tuple[int, ...], tuple[Rotate, ...]]:
        """Grasps for trials, and turns for prediction, about a grasp that no trial uses where one can be spared.

        Args:
            shape: geometry with the estimator's particles.
            grasps: feasible grasps.
            number: number of the draw that they are for.
        """
        if not self.grips or not grasps or shape.chain is not None:  # nothing predicts how links trail
            return grasps, ()
        seed = self.seed + (number if self.redraw else 0)
        spared = held_out_grasp(shape, grasps, seed) if self.held_out else None
        turned_by = grasps if spared is None else (spared,)
        turns = held_out_turns(shape, turned_by, self.held_out, self.duration, seed)
        return tuple(grasp for grasp in grasps if grasp != spared), tuple(turns)
