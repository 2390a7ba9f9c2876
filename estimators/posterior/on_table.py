"""Slides, turns and accelerated turns as measurements of all unknowns: all six components that the sensor shows."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property, partial

import torch
from jaxtyping import Float, Int
from torch import Tensor
from torch.func import vmap
from torch.nn.functional import pad

from estimators.particles.windows import Observations
from estimators.posterior.solver import Linearized, Rows
from estimators.posterior.table_errors import TableErrors, rows_of_planar
from estimators.posterior.unknowns import Unknowns
from estimators.wrench.jacobian import NONE, Slopes, Theta, Window, linearized, zeros
from estimators.wrench.model import MODEL_PARAMETERS, ModelErrors, ParticleModel
from estimators.wrench.sensor import flawed
from estimators.wrench.support import PUSHED, GripperLoad, Springs, Support, contact_spread, own_weight
from estimators.wrench.table import Table
from testbed.objects.model import ObjectShape
from testbed.worlds.setup_errors import PARAMETERS

MOST_POINTS = 64
"""Largest number of points of a group over which patterns of contact are defined."""
SAME_DISTANCE = 1e-9
"""Relative difference of squared distances from the middle up to which points count as equally far from it."""
WRENCHES = "the wrenches"
"""Name of the rows of a trial."""
PATTERNS = "contact_points", "foot_load"
"""Errors of the setup that act as patterns of contact: unknown points, or unequal loads on known feet."""
SHARED = {name for name, each in PARAMETERS.items() if {"table", "reading"} & set(each.shows)}
"""Unknowns that change these measurements: errors of the setup, and those below."""
SHARED |= {"mass", "friction", "com_height", "indeterminate_load", "hinge_friction", "links_carried", "rigid_share"}
SHARED |= {*PATTERNS, "contact_radius", *MODEL_PARAMETERS}
LEAST_DRAG, SMALLEST = 0.5, 1e-12
"""Least drag to which errors of the model are proportional, over the largest force measured at constant speed; and the
smallest drag, N. Contradictory trials may fit best without friction, where errors would vanish."""


@dataclass(frozen=True, eq=False)
class ContactPatterns:
    """Orthonormal patterns of load over at most `MOST_POINTS` points of each group.

    All keep the group's load. The first two are affine and move its center off the middle of the points; the others
    keep its moments too.
    """

    of_group: Float[Tensor, "P*C n_m*q"]
    """Load on each point as a part of its group's load: a column per pattern of each group."""
    count: Int[Tensor, "n_m"]
    """Number of points of each group."""
    radial: Float[Tensor, "n_m q"]
    """Combination of the patterns that changes the mean square distance of the load from its middle, moments kept.

    The change is the standard deviation of the square distance over evenly loaded points.
    """

    @staticmethod
    def of(model: ParticleModel, points: Float[Tensor, "P C 2"]) -> ContactPatterns:
        """Patterns over the points of each particle, m."""
        groups = len(model.parts)
        every = [
            torch.nonzero(((model.mass_group == g) & model.contact)[:, None].expand(points.shape[:2]))
            for g in range(groups)
        ]
        # a draw, since steps of equal length may keep to one line of a lattice
        drawn = torch.Generator().manual_seed(0)
        chosen = [at[torch.randperm(len(at), generator=drawn)[:MOST_POINTS].sort().values] for at in every]
        count = torch.tensor([len(at) for at in chosen])
        part = torch.zeros(*points.shape[:2], groups, int(count.max()) - 1, dtype=torch.float64)
        radial = torch.zeros(groups, part.shape[-1], dtype=torch.float64)
        for group, (particle, point) in enumerate(at.unbind(1) for at in chosen):
            if len(point) <= 3:
                continue
            arm = points[particle, point] - points[particle, point].mean(0)
            patterns = torch.linalg.qr(torch.cat([torch.ones_like(arm[:, :1]), arm], 1), mode="complete")[0][:, 1:]
            part[particle, point, group, : patterns.shape[1]] = patterns
            square = arm.square().sum(1)
            outward = patterns[:, 2:].T @ square
            if outward.norm() > SAME_DISTANCE * square.norm():
                radial[group, 2 : patterns.shape[1]] = outward / outward.norm() / len(point) ** 0.5
        return ContactPatterns(part.flatten(2).flatten(0, 1), count, radial)


@dataclass(frozen=True, eq=False)
class OnTable:
    """K windows of trials on the table, at constant speed or acceleration."""

    shape: ObjectShape
    windows: Observations
    table: Table
    """Forward model over half of the parts of each window, with the fields of support and sensor."""
    whole: Table
    """Forward model over all parts of the windows."""
    patterns: ContactPatterns
    errors: ModelErrors
    alone: bool = False
    """True if every trial counts as the only one: all share one set of the errors that are drawn in each trial."""
    _last: list[tuple[Tensor, TableErrors]] = field(default_factory=list, init=False, repr=False)
    """Cache of the last errors, with their frictions and masses."""

    @staticmethod
    def of(shape: ObjectShape, windows: Observations, support: str, errors: ModelErrors) -> OnTable:
        """Windows under a `JoinedSupport`."""
        model, setup = ParticleModel.of(shape), windows.setup
        table = windows.table(model, errors.pivot_error)
        balanced = windows.articulated and bool(setup.contact_points)
        alone = "own_weight" if support == "springs" else support
        loads = Support.of(alone, model, table.lever, windows.held, balanced=balanced)
        fields = {
            "per_mass": loads.per_mass,
            "response": loads.response,
            "inertial": table.inertial_rows()[:, :2] @ model.parts.T,
            "from_sensor": windows.from_sensor,
            "tcp_height": windows.load_map[:, 1, 0],
            "tool_tilt": windows.tool_tilt,
        }
        if windows.articulated:
            fields["beside"] = _moment_beyond_tare(model, table, windows)
        # links turn within a window, a rigid object hardly does
        parts = table.windows if windows.articulated else _halved(table.windows)
        fewer = Table(model, table.points, parts | fields, table.pivot_error)
        return OnTable(shape, windows, fewer, table, ContactPatterns.of(model, table.points), errors)

    @cached_property
    def springs(self) -> Springs:
        """Springs between the groups."""
        return Springs.of(self.table.model, self.shape.neighbors)

    @cached_property
    def read(self) -> Float[Tensor, "K 6+H"]:
        """Measured wrench about the TCP, N and N m, and 0 for each hinge, which has no sensor."""
        read = (self.windows.from_sensor @ self.windows.sensed[..., None])[..., 0]
        return pad(read, (0, self.windows.hinges))

    @property
    def trials(self) -> int:
        """Number of trials."""
        return int(self._trial.max()) + 1

    def predicting(self, theta: Theta, own: Theta | None = None) -> OnTable:
        """Windows whose readings are the predictions of the forward model.

        Args:
            theta: unknowns that all windows share.
            own: unknowns with a value per window.
        """
        own = own or {}
        predict = vmap(lambda own, window: self.wrench(theta | own, window), chunk_size=self.table.chunk)
        wrench = predict(own, self._windows(theta))
        table = replace(self.table, windows=self.table.windows | {"force": wrench[:, :2]})
        planned = replace(self, windows=replace(self.windows, wrench=wrench[:, :3]), table=table)
        read = planned._rows(theta, own)[0][:, :6]
        sensed = torch.linalg.solve(self.windows.from_sensor, read[..., None])[..., 0]
        return replace(planned, windows=replace(planned.windows, sensed=sensed))

    def with_load(self, part: float) -> OnTable:
        """Windows with the stated size of the gripper's load scaled by `part`."""
        windows = self.windows
        sizes = {"load_size": part * windows.load_size, "load_change": part * windows.load_change}
        return replace(self, windows=replace(windows, **sizes))

    @cached_property
    def middles(self) -> Table:
        """Forward model with contact at the middle of every particle, for the errors of the motion."""
        return self.windows.table(self.table.model, self.errors.pivot_error, spread=False)

    @cached_property
    def inertial_rows(self) -> Float[Tensor, "K 6+H n_m"]:
        """Derivatives of the rows in particle masses by inertia alone, which acts at half the object's height."""
        height = self.windows.load_map[:, 1, 0] - self.shape.height / 2
        planar = pad(self.table.inertial_rows() @ self.table.model.parts.T, (0, 0, 0, self.windows.hinges))
        return rows_of_planar(height, self.windows.hinges) @ planar

    @property
    def idle(self) -> Int[Tensor, "K"]:
        """Number of rows of each window that fit anyway.

        The load of a fingertip, and the friction of a hinge at rest, may have any size.
        """
        free = len(PUSHED) * self.windows.pushed
        return free + self.windows.standing.sum(1) if self.windows.articulated else free

    @property
    def parts(self) -> list[Rows]:
        """One part a trial, in order; the windows of a trial are consecutive."""
        trials, place, count = torch.unique_consecutive(self.windows.trial, return_inverse=True, return_counts=True)
        idle = torch.zeros_like(count).index_add(0, place, self.idle)
        rows = ((6 + self.windows.hinges) * count).tolist()
        return [Rows(WRENCHES, *each) for each in zip(rows, trials.tolist(), idle.tolist(), strict=True)]

    def linearized(self, unknowns: Unknowns, z: Float[Tensor, "n"]) -> Linearized:
        """Residual, derivatives and covariance, which contains the gripper's load, in which the rows are linear.

        Derivatives are those at the most likely load.
        """
        return self._linearized(unknowns, z, {})[0]

    def linear_in_drag(self, unknowns: Unknowns, z: Float[Tensor, "n"]) -> tuple[Linearized, Float[Tensor, "K 6+H P"]]:
        """`linearized`, and derivatives of the rows in the friction of each particle, N/N and N m/N."""
        found, slopes = self._linearized(unknowns, z, zeros(drag=(len(self.table.points),)))
        return found, slopes["drag"]

    def _linearized(self, unknowns: Unknowns, z: Float[Tensor, "n"], more: Theta) -> tuple[Linearized, Slopes]:
        """`linearized`, and derivatives in `more`, quantities that are not among the unknowns."""
        theta, own = self.at(unknowns, z)
        errors = self._errors(theta)

        def residual_at(z: Tensor) -> Tensor:
            theta, own = self.at(unknowns, z)
            rows = vmap(lambda own, window: self.predict(theta | own, window), chunk_size=self.table.chunk)
            return (rows(own, self._windows(theta)) - self.read).flatten()

        rows, carried = self._rows(theta, own)
        off, blocks = rows - self.read, errors.blocks(carried)
        load = errors.shrunken_load(off, carried, blocks)

        def columns(z: Tensor, more: Theta) -> tuple[Tensor, Slopes]:
            theta, own = self.at(unknowns, z)
            slopes = self._slopes(theta | more, own | {"carried": load})
            others = {name: slopes.pop(name) for name in more}
            if "place_friction" in slopes:
                slopes["place_friction"] = slopes["place_friction"] @ self.whole.field
            return unknowns.columns(slopes, self._trial, z).flatten(0, 1), others

        found, others = columns(z, more)
        absorbed = partial(errors.absorbed, carried, blocks)
        return Linearized(off.flatten(), found, blocks, residual_at, lambda z: columns(z, {})[0], absorbed), others

    def _errors(self, theta: Theta) -> TableErrors:
        """Errors of the rows at some masses and frictions; the last result is cached."""
        at = torch.cat([theta["friction"], theta["mass"]])
        if not (self._last and torch.equal(self._last[0][0], at)):
            model = self.table.model
            mass = model.particle_mass(theta["mass"])
            drag = model.particle_friction(theta["friction"]) * (self.table.windows["per_mass"] @ theta["mass"])
            least = LEAST_DRAG * self.windows.drag / drag.sum(-1, keepdim=True).clamp(min=SMALLEST)
            drag = drag * least.clamp(min=1.0)
            self._last[:] = [(at, TableErrors.of(self.windows, self.middles, mass, drag, self.errors))]
        return self._last[0][1]

    def _rows(self, theta: Theta, own: Theta) -> tuple[Float[Tensor, "K 6+H"], Float[Tensor, "K 6+H 3"]]:
        """Rows of a gripper without load, and their derivatives in its lift and moment."""
        loads = torch.cat([torch.zeros(1, 3, dtype=torch.float64), torch.eye(3, dtype=torch.float64)])

        def predict(own: Theta, window: Window) -> Tensor:
            return vmap(lambda load: self.predict(theta | own | {"carried": load}, window))(loads)

        found = vmap(predict, chunk_size=self.table.chunk)(own, self._windows(theta))
        return found[:, 0], (found[:, 1:] - found[:, :1]).mT

    def _windows(self, theta: Theta) -> Window:
        """Fields of the windows, with the statically indeterminate loads at some masses."""
        if "indeterminate_load" not in theta:
            return self.table.windows
        model = self.table.model
        spread = contact_spread(model, model.particle_mass(theta["mass"]))
        return self.table.windows | {"indeterminate": spread.expand(len(self.windows), -1, -1)}

    @cached_property
    def _trial(self) -> Tensor:
        """Index of each window's trial; 0 for all if each is counted `alone`."""
        trial = torch.unique(self.windows.trial, return_inverse=True)[1]
        return torch.zeros_like(trial) if self.alone else trial

    def at(self, unknowns: Unknowns, z: Float[Tensor, "n"]) -> tuple[Theta, Theta]:
        """Unknowns that all windows share, and those with a value per window, by its trial or its place."""
        shared, by_trial = unknowns.of(SHARED, z)
        own = {name: value[self._trial] for name, value in by_trial.items()}
        if "place_friction" in shared:
            own["place_friction"] = self.whole.field @ shared.pop("place_friction")
        return shared, own

    def _slopes(self, theta: Theta, own: Theta) -> Slopes:
        """Derivatives of the rows, by the chain rule over the planar wrench, which has half as many components."""

        def at(theta: Theta, window: Window) -> Theta:
            known = {"carried": window["own carried"]}
            return theta | known | {name: theta[name] + window[f"own {name}"] for name in own if name not in known}

        def wrench(theta: Theta, window: Window) -> Tensor:
            return self.wrench(at(theta, window), window)

        def reading(theta: Theta, window: Window) -> Tensor:
            return self.reading(at(theta, window), window["planar"] + theta["planar"], window)

        fields = self._windows(theta) | {f"own {name}": value for name, value in own.items()}
        start = theta | zeros(**{name: tuple(value.shape[1:]) for name, value in own.items() if name != "carried"})
        planar, inner = linearized(wrench, start, fields, self.table.chunk)
        _, outer = linearized(reading, start | zeros(planar=tuple(planar.shape[1:])), fields | {"planar": planar})
        by_planar = outer.pop("planar")
        return {name: outer[name] + by_planar @ slope for name, slope in inner.items()}

    def loads(self, theta: Theta, window: Window) -> Float[Tensor, "P C"]:
        """Normal load of each point of contact, N."""
        mass, carried = theta["mass"], self.carried(theta, window)
        load = window["per_mass"] @ mass + window["response"] @ carried
        if "rigid_share" in theta:
            load = self.springs.joined(load, theta["rigid_share"])
        if "indeterminate_load" in theta:
            load = load + window["indeterminate"] @ theta["indeterminate_load"]
        return self._at_points(theta, load)

    def _at_points(self, theta: Theta, load: Float[Tensor, "P"]) -> Float[Tensor, "P C"]:
        """Forces of points of contact from those of particles, N."""
        at_points = load[:, None] / self.table.points.shape[1]
        pattern = next((theta[name] for name in PATTERNS if name in theta), None)
        if pattern is None:
            return at_points.expand(self.table.points.shape[:2])
        group = self.table.model.mass_group
        on_group = torch.zeros(len(self.table.model.parts), dtype=torch.float64).index_add(0, group, load)
        if "contact_radius" in theta:
            pattern = pattern + theta["contact_radius"] * self.patterns.radial
        part = (self.patterns.of_group @ pattern.flatten()).reshape(self.table.points.shape[:2])
        return at_points + on_group[group, None] * part

    def carried(self, theta: Theta, window: Window) -> Float[Tensor, "3"]:
        """Lift and moment of the gripper on the feet, N and N m.

        While links move the hand keeps the tilt of its tare, and may carry the moment of their weights beyond it.
        """
        carried = theta.get("carried", torch.zeros(3, dtype=torch.float64))
        if "links_carried" not in theta:
            return carried
        moved = theta["links_carried"] * (window["beside"] @ theta["mass"])
        return carried + pad(moved, (1, 0))

    def predict(self, theta: Theta, window: Window) -> Float[Tensor, "6+H"]:
        """Wrench about the TCP that the sensor shows in one window, N and N m."""
        return self.reading(theta, self.wrench(theta, window), window)

    def wrench(self, theta: Theta, window: Window) -> Float[Tensor, "3+H"]:
        """Planar wrench of the gripper on the object about the grasp point, N and N m."""
        model = self.table.model
        friction = model.particle_friction(theta["friction"])[:, None] * self.loads(theta, window)
        if "drag" in theta:
            friction = friction + self._at_points(theta, theta["drag"])
        moved = {name: value for name, value in theta.items() if name not in ("mass", "friction")}
        mass = model.particle_mass(theta["mass"])
        return self.table.predict(moved | {"mass": mass, "friction": friction}, window)

    def reading(self, theta: Theta, planar: Float[Tensor, "3+H"], window: Window) -> Float[Tensor, "6+H"]:
        """Wrench about the TCP that the sensor shows of a planar wrench and the gripper's load, N and N m."""
        carried = self.carried(theta, window)
        height = window["tcp_height"] + theta.get("height", NONE)
        # the mass acts at half the object's height plus its error
        arm = theta["mass"] * (self.shape.height / 2 + theta.get("com_height", NONE))
        moment, tool = window["inertial"] @ arm, torch.zeros(6, dtype=torch.float64)
        if "table_tilt" in theta:
            sideways = self.table.sideways(theta["table_tilt"], window)
            moment = moment + self.table.model.particle_mass(arm).sum() * sideways
            tool = theta["table_tilt"] @ window["tool_tilt"]
        on_feet = carried[1:] + moment - height * planar[:2]
        wrench = torch.stack([planar[0], planar[1], carried[0], -on_feet[1], on_feet[0], planar[2]]) + tool
        read = window["from_sensor"] @ flawed(theta, torch.linalg.solve(window["from_sensor"], wrench))
        return torch.cat([read, planar[3:]])


def _moment_beyond_tare(model: ParticleModel, table: Table, windows: Observations) -> Float[Tensor, "K 2 n_m"]:
    """Moment of the links' weights beyond that at the tare, N m per kg of each particle mass."""
    still = GripperLoad.none(model)

    def of(mass: Tensor) -> Tensor:
        balanced = bool(windows.setup.contact_points)
        none = torch.zeros(len(windows), dtype=torch.float64), torch.zeros(len(windows), 2, dtype=torch.float64)
        moved = own_weight(model, mass, GripperLoad(*none, windows.held, table.lever, balanced))
        return moved.beside - moved.held_by(own_weight(model, mass, still))

    return torch.stack([of(mass) for mass in model.parts], -1)


def _halved(windows: Window) -> Window:
    """Windows of half as many parts, the means of pairs, over which friction hardly changes.

    An odd number of parts, as the one part of a planned turn, is kept.
    """
    parts = windows["rates"].shape[1]
    if parts % 2:
        return windows
    return windows | {
        name: windows[name].unflatten(1, (parts // 2, 2)).mean(2)
        for name in ("rates", "poses", "ahead", "frames", "accelerations")
        if windows[name].shape[1] == parts
    }
