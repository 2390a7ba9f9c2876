"""Steady windows of many trials as one batch: wrench, motion, gripper's load, and the covariances of their errors."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from typing import Self

import torch
from jaxtyping import Float, Int
from torch import Tensor

from estimators.particles.motion import Motion
from estimators.wrench.jacobian import Window
from estimators.wrench.model import Inertia, ParticleModel
from estimators.wrench.support import GripperLoad
from estimators.wrench.table import Table
from testbed.worlds.setup_errors import EXACT_SETUP, SetupErrors

PLANAR = [0, 1, 5]
"""f_x, f_y and the torque about the vertical, of a wrench's six components."""
SLOWEST = 0.01
"""Rate of a hinge below which it may be at rest, rad/s."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Observations(Motion):
    """K windows of constant speed or constant acceleration. Object axes; moments about the grasp point."""

    wrench: Float[Tensor, "K 3"]
    """Mean f_x, f_y of the gripper on the object and torque about the grasp point, N and N m."""
    noise: Float[Tensor, "K 6 6"]
    """Covariance of the mean of all six components, about the TCP, from the window's own noise."""
    bias: Float[Tensor, "K 6 6"]
    """Covariance of the bias that the sensor's tare leaves in them, shared by the windows of a trajectory."""
    drift: Float[Tensor, "K 6 6"]
    """Covariance that the random walk of the sensor's zero adds per second."""
    lift: Float[Tensor, "K"]
    """Vertical force of the gripper on the object, N."""
    tilt: Float[Tensor, "K 2"]
    """(t_y + h f_x, -t_x + h f_y): moment that the feet supply where nothing accelerates, N m."""
    sensed: Float[Tensor, "K 6"]
    """Mean of all six components in the sensor's axes, about its origin, N and N m."""
    from_sensor: Float[Tensor, "K 6 6"]
    """Map from a wrench in the sensor's axes to one about the TCP in object axes."""
    tool_tilt: Float[Tensor, "K 2 6"]
    """Change of all six components by the tool's weight with a tilt of the table, as `SteadyWindow.tool_tilt`."""
    load_map: Float[Tensor, "K 3 6"]
    """Map from the wrench to lift and tilt."""
    load_kept: Float[Tensor, "K 3"]
    """Part of a trial's mean lift and tilt that shrinkage keeps, 0 to 1."""
    load_followed: Float[Tensor, "K 3"]
    """Part of their change from window to window of a trial that shrinkage keeps, 0 to 1."""
    load_size: Float[Tensor, "K 3"]
    """Standard deviation of a trial's mean lift and tilt, N and N m."""
    load_change: Float[Tensor, "K 3"]
    """Standard deviation of their change from window to window of a trial, N and N m."""
    setup: SetupErrors = EXACT_SETUP
    """Errors of the setup as stated, the largest of all trials."""
    _tables: dict[tuple[object, ...], Table] = field(default_factory=dict, init=False, repr=False)
    """Cache of forward models, by model, pivot error and spread."""

    def like(self, by_window: dict[str, Tensor]) -> Self:
        """Windows of other fields in the same setup."""
        return replace(self, **by_window)  # pyright: ignore[reportArgumentType]

    @property
    def by_window(self) -> dict[str, Tensor]:
        """Fields with a row per window."""
        return {each.name: getattr(self, each.name) for each in fields(self) if each.init and each.name != "setup"}

    def where(self, keep: Tensor) -> Self:
        """Windows that `keep` (K,) selects."""
        return self.like({name: value[keep] for name, value in self.by_window.items()})

    def merged(self, group: Int[Tensor, "K"]) -> Self:
        """Means over the windows of each group, 0 to G - 1; integers and booleans are those of its first window."""
        first = torch.stack([torch.nonzero(group == g)[0, 0] for g in range(int(group.max()) + 1)])

        def mean(values: Tensor) -> Tensor:
            whole = not values.is_floating_point()
            return values[first] if whole else torch.stack([values[group == g].mean(0) for g in range(len(first))])

        return self.like({name: mean(value) for name, value in self.by_window.items()})

    @staticmethod
    def stacked(draws: Sequence[Observations]) -> Observations:
        """Windows of D draws, equal in number, with leading axes (D, 1); the second axis broadcasts over candidates."""
        return draws[0].like(
            {name: torch.stack([getattr(d, name) for d in draws])[:, None] for name in draws[0].by_window}
        )

    @cached_property
    def drag(self) -> float:
        """Largest force measured at constant speed [N], 0 without any: a lower bound of mu M g."""
        return float(self.wrench[~self.accelerated, :2].norm(dim=1).amax() if bool((~self.accelerated).any()) else 0.0)

    @property
    def covariance(self) -> Float[Tensor, "K 3 3"]:
        """Covariance of `wrench` by the window's own noise."""
        return self.noise[:, PLANAR][:, :, PLANAR]

    @property
    def same_trial(self) -> Float[Tensor, "K K"]:
        """1 for pairs of windows of the same trial, else 0."""
        return (self.trial[:, None] == self.trial).double()

    @property
    def articulated(self) -> bool:
        """True if the object has links behind hinges."""
        return self.links.shape[-2] > 0

    @property
    def hinges(self) -> int:
        """Number of hinges: H."""
        return max(self.links.shape[-2] - 1, 0)

    def table(self, model: ParticleModel, pivot_error: float = 0.0, *, spread: bool | None = None) -> Table:
        """Forward model of the windows, without friction.

        The drag of a foot near the center of a turn fades within the error of the foot's position, since the derivative
        at one position does not show the reversal of the drag on the other side.

        Args:
            model: particles of the object.
            pivot_error: error of the center of a turn, m.
            spread: True for contact anywhere in each cell, at four quadrature points; False for contact at the middle
                of each particle; if left out, True where the setup has unknown points of contact.
        """
        asked = (model, pivot_error, spread)
        if asked not in self._tables:
            points = model.points(spread=bool(self.setup.contact_points) if spread is None else spread)
            if spread is None and points.shape[1] == 1:
                pivot_error = math.hypot(pivot_error, self.setup.place_error(on_feet=model.stands_on_feet))
            self._tables[asked] = Table(model, points, self._fields(model), pivot_error).undragged
        return self._tables[asked]

    def _fields(self, model: ParticleModel) -> Window:
        """Fields of the windows by the names of `Table`."""
        grip, count = (~self.pushed).double(), len(self)
        if self.articulated:
            motion = torch.cat([self.links, self.links[..., 5:6].square()], -1)
            off = torch.cat([self.links_with_errors, self.links_with_errors[..., 5:6].square()], -1) - motion[:, None]
            links = torch.arange(self.links.shape[2])
            held = model.link[self.held[:, :1]]
            hinge = torch.where(links > held, held, held - 1).clamp(min=0)
            trailing = (model.hinges[hinge] - self.grasp[:, None]) * (links != held)[..., None]
            near, beyond = torch.arange(self.hinges) >= held, model.link[model.mass_group] > links[:-1, None]
            change = self.hinge_rates.mean(1)
            own = {
                "trailing": trailing,
                "turning": torch.where(near, change, -change).sign() * ~self.standing,
                "trails": (beyond == near[..., None]).double() * ~self.standing[..., None],
                "held": (links == held).double(),
                "links_with_errors": off,
                "ahead": torch.zeros_like(self.twists),
            }
        else:
            rest = torch.cat([self.acceleration, self.spin_square[:, None]], 1)[:, None, None]
            still = torch.zeros(count, 1, 1, 3, dtype=torch.float64)
            motion = torch.cat([still, self.twist[:, None, None], rest], -1)
            own = {
                "trailing": still[:, 0, :, :2],
                "held": torch.ones(count, 1, dtype=torch.float64),
                # rates of a pushed object are mostly noise of the camera, and its friction leads by only 0.5 ms
                "ahead": self.twist_rates * grip[:, None, None],
            }
        return own | {
            "frames": motion[..., :3],
            "rates": motion[..., 3:6] if self.articulated else self.twists[:, :, None],
            "accelerations": motion[..., 6:],
            "grasp": self.grasp,
            "twist": self.twist,
            "poses": self.poses,
            "gripped": grip,
            "of_hand": self.from_sensor[:, :2, :3],
            "camera_errors": self.camera_errors,
            "force": self.wrench[:, :2],
        }

    def drag_rows(self, model: ParticleModel, pivot_error: float) -> Float[Tensor, "K 3 P"]:
        """Wrench about the grasp point that drags each particle against a friction of 1 N.

        Mean over each window, and over each cell where the points of contact in it are unknown.

        Args:
            model: particles of the object.
            pivot_error: error of the center of a turn, m; the drag of a particle nearer than that fades.
        """
        return self.table(model, pivot_error).drag_rows()[:, :3]

    @property
    def hinge_rates(self) -> Float[Tensor, "K S H"]:
        """Rate of each link less that of the one before, rad/s."""
        return torch.diff(self.links[..., 5], dim=2)

    @property
    def standing(self) -> Tensor:
        """True for hinges that may be at rest or reverse within a window, (K, H): their friction has no known sign."""
        rates = self.hinge_rates
        off = torch.diff(self.links_with_errors[..., 5], dim=3) - rates[:, None]
        least = rates.abs() - 3 * off.square().sum(1).sqrt()
        return ((least < SLOWEST) | (rates.sign() != rates[:, :1].sign())).any(1)

    @property
    def twist_rates(self) -> Float[Tensor, "K S 3"]:
        """Derivative of `twists` in time, m/s^2 and rad/s^2; with a single part, 0 for the velocity."""
        parts = self.twists.shape[1]
        if parts < 2:
            return torch.nn.functional.pad(self.acceleration[:, None, 2:], (2, 0))
        length = self.since_tare.diff()[:, None] / parts
        return torch.gradient(self.twists, dim=1)[0] / length

    @property
    def twist_noise(self) -> Float[Tensor, "3"]:
        """Variance of a window's mean twist by the noise of the hand's measured motion, the same in all windows.

        By fifth differences of its parts, which remove a wandering center.
        """
        parts = self.twists.shape[1]
        if parts < 6:
            return torch.zeros(3, dtype=torch.float64)
        spread = torch.diff(self.twists, 5, dim=1).square().mean(1) / (252 * parts)
        if self.camera_errors.shape[-1] == 0:
            return spread.median(0).values
        return spread.masked_fill(self.pushed[:, None], torch.nan).nanmedian(0).values.nan_to_num(0.0)

    def spin_up(self, inertia: Inertia) -> Float[Tensor, "K"]:
        """Torque I_j alpha about the grasp point, N m."""
        return self.acceleration[:, 2] * inertia.about(self.grasp)

    def gripper_load(self, model: ParticleModel, mass: Float[Tensor, "P"], height: float) -> GripperLoad:
        """Load of the gripper.

        Args:
            model: particles of the object.
            mass: mass of each particle, kg; its inertia acts at half the object's height over the feet.
            height: height of the object, m.
        """
        table = self.table(model)
        moved = height / 2 * table.motion(mass)[:, :2]
        # only the kept parts of the tilt contain the inertial moment; at constant speed it is the same both ways
        kept, followed = self.load_kept[:, 1:], self.load_followed[:, 1:]
        mean = self.same_trial / self.same_trial.sum(1, keepdim=True)  # over the windows of each trial
        change = torch.eye(len(self), dtype=torch.float64) - mean
        swung = kept * (mean @ moved) + followed * (change @ moved)
        taken = torch.where(self.accelerated[:, None] | self.articulated, swung, kept * moved)
        balanced = self.articulated and bool(self.setup.contact_points)
        return GripperLoad(self.lift, self.tilt - taken, self.held, table.lever, balanced)
