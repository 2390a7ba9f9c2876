"""Nuisance parameters of the setup as unknowns beside s: sensor bias, grasp offset and friction anisotropy.

Each corrects the steady windows. A bias is left by the tare of a trial in f_x, f_y and the torque, constant in object
axes since the hand holds both sensor and object; the other components are taken to have as large a one. A grasp offset
is the distance of the object from where the hand takes it to be, one a trial, and shifts every particle against the
TCP; flat pads on flat faces hold its yaw. Anisotropy belongs to the table, not to the object: elliptic Coulomb friction
f = -N A v / sqrt(v . A v), of most dissipation within the ellipse of friction, A = mu^2 (1 + H) / sqrt(1 - h . h),
H = [[h_1, h_2], [h_2, -h_1]], h = 2 a / (1 + a . a): friction along one axis of the table to that across it is as
1 + |a| to 1 - |a|, the scale of `SetupErrors.anisotropy`. It turns against the object as that turns, and a half turn
averages it away to first order.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, fields

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from estimators.particles.friction_system import FrictionEquations, LinearSystem
from estimators.particles.windows import PLANAR, Observations
from estimators.wrench.jacobian import Window
from estimators.wrench.model import ParticleModel
from testbed.errors import InvalidValueError
from testbed.validation import is_number
from testbed.worlds.setup_errors import PARAMETERS

UNKNOWNS = ("bias", *(name for name, each in PARAMETERS.items() if each.unknown))
BIAS, OFFSET, ANISOTROPY = slice(0, 3), slice(3, 5), slice(5, 7)
"""Places of a window's seven corrections."""
STRONGEST = 0.6
"""Largest norm of the anisotropy: frictions of 1 to 4."""
NOUNS = {"bias": "bias", "grasp_offset": "grasp offset", "anisotropy": "anisotropy of friction"}
WHY_NOT = {
    "bias": "not at all: one way, a constant bias passes for friction; turn back in the same grasp",
    "grasp_offset": "no closer than assumed: turn about more points",
    "anisotropy": "no closer than assumed: half turns average it away; turn through less, from other yaws",
}
FAR = 100.0
"""Spread of a bias and of the loads that counts as nothing known, as a multiple of the largest measured."""
ROUNDING = 1e-9
"""Part of a column below which rounding alone is left."""


@dataclass(frozen=True)
class NuisancePrior:
    """Parameters of the setup that are unknown, and their spread: one standard deviation."""

    unknown: tuple[str, ...] = ()
    """Any of bias, grasp_offset, anisotropy."""
    bias: float = math.inf
    """Spread of a bias, N and N m; infinite: nothing is assumed of it."""
    grasp_offset: float = PARAMETERS["grasp_offset"].unknown
    """Spread of an offset along each axis, m."""
    anisotropy: float = PARAMETERS["anisotropy"].unknown
    """Spread of each component; 0.11 is a friction of 0.8 to 1."""

    def __post_init__(self) -> None:
        known = isinstance(self.unknown, tuple) and set(self.unknown) <= set(UNKNOWNS)
        if not known or len(set(self.unknown)) < len(self.unknown):
            raise InvalidValueError("unknown", self.unknown, f"any of {', '.join(UNKNOWNS)}, each once")
        for name in UNKNOWNS:
            value = getattr(self, name)
            if not ((is_number(value) and value > 0) or (name == "bias" and value == math.inf)):
                raise InvalidValueError(f"NuisancePrior.{name}", value, "a number > 0")


@dataclass(frozen=True, eq=False, kw_only=True)
class CorrectedWindows(Observations):
    """Windows with bias and offset taken off, on a table with anisotropic friction."""

    anisotropy: Float[Tensor, "K 2"]
    """a (cos 2 phi, sin 2 phi): phi the table's direction of most friction, most over least (1 + a) / (1 - a)."""

    by_bias: Float[Tensor, "K 6 3"]
    """Correction of each component of the wrench for a bias of 1 in f_x, f_y or the torque."""

    @property
    def unknown(self) -> tuple[str, ...]:
        """Errors of the setup whose derivatives are wanted, whether they are stated or not."""
        return "grasp_offset", "anisotropy"

    def _fields(self, model: ParticleModel) -> Window:
        return super()._fields(model) | {"anisotropy": self.anisotropy}

    def slopes(self, found: FrictionEquations) -> Float[Tensor, "K 3 7"]:
        """Derivatives of b - Q s in the corrections of each window, at the loads by which the rows are linear."""
        bias = self.by_bias[:, PLANAR] - found.response @ (self.load_kept[..., None] * (self.load_map @ self.by_bias))
        linear = found.linear.slopes
        return torch.cat([-bias, linear["grasp_offset"], -linear["anisotropy"]], -1)


def corrected(windows: Observations, by: Float[Tensor, "K 7"], *, biased: bool = False) -> CorrectedWindows:
    """Windows with the corrections made.

    Args:
        windows: as measured.
        by: bias, offset and anisotropy of each.
        biased: the bias is unknown: the part of f_z, t_x and t_y that it makes likely goes with it, and only the rest
            counts as an error.
    """
    planar, left = torch.tensor(PLANAR), windows.bias
    likely = torch.zeros_like(left[:, :, planar])
    if biased:
        stated = left[:, planar][:, :, planar]
        likely = left[:, :, planar] @ torch.linalg.pinv(stated, hermitian=True)
        left = left - likely @ stated @ likely.transpose(1, 2)
    likely = likely.index_copy(1, planar, torch.eye(3, dtype=by.dtype).expand(len(by), 3, 3))
    whole = (likely @ by[:, BIAS, None])[..., 0]
    carried = windows.load_kept * (windows.load_map @ whole[..., None])[..., 0]
    changed = {
        "wrench": windows.wrench - whole[:, PLANAR],
        "lift": windows.lift - carried[:, 0],
        "tilt": windows.tilt - carried[:, 1:],
        "grasp": windows.grasp + by[:, OFFSET],
        "bias": left,
    }
    given = {each.name: getattr(windows, each.name) for each in fields(Observations) if each.init} | changed
    return CorrectedWindows(**given, anisotropy=by[:, ANISOTROPY], by_bias=likely)  # pyright: ignore[reportArgumentType]


@dataclass(frozen=True, eq=False)
class NuisanceLayout:
    """Places of n nuisance parameters in one vector, and the windows that each corrects."""

    names: tuple[str, ...]
    """Name of each: kind, trial and component, with the unit."""
    kind: tuple[str, ...]
    trial: tuple[int, ...]
    """Trial of each; -1 for those of all trials."""
    width: Float[Tensor, "n"]
    """Spread of each beforehand."""
    whole: Float[Tensor, "n"]
    """Size that each can have: its width, and for a bias at most the largest wrench."""
    index: Int[Tensor, "K 7"]
    """Parameter of each of a window's corrections; -1 where there is none."""

    @staticmethod
    def of(prior: NuisancePrior, windows: Observations) -> NuisanceLayout:
        """The parameters of some windows."""
        largest = windows.wrench.abs().amax(0).tolist()
        force, torque = max(largest[:2]), largest[2]
        rows: list[tuple[str, int, int, str, float]] = []  # kind, trial, place, name, size
        for trial in windows.trial.unique().tolist():
            if "bias" in prior.unknown:
                for place, (axis, most) in enumerate((("fx_N", force), ("fy_N", force), ("tz_Nm", torque))):
                    rows.append(("bias", trial, place, f"bias_{trial}_{axis}", min(prior.bias, max(most, 1e-6))))
            if "grasp_offset" in prior.unknown:
                for place, axis in enumerate("xy", OFFSET.start):
                    name = f"grasp_offset_{trial}_{axis}_m"
                    rows.append(("grasp_offset", trial, place, name, prior.grasp_offset))
        if "anisotropy" in prior.unknown:
            for place, axis in enumerate("xy", ANISOTROPY.start):
                rows.append(("anisotropy", -1, place, f"anisotropy_{axis}", prior.anisotropy))
        index = torch.full((len(windows), 7), -1)
        for parameter, (_, trial, place, _, _) in enumerate(rows):
            index[(windows.trial == trial) | (trial < 0), place] = parameter
        kinds, trials, _, names, sizes = zip(*rows, strict=True)
        width = torch.tensor([getattr(prior, kind) for kind in kinds], dtype=torch.float64)
        return NuisanceLayout(names, kinds, trials, width, torch.tensor(sizes, dtype=torch.float64), index)

    def spread(self, values: Float[Tensor, "n"]) -> Float[Tensor, "K 7"]:
        """Corrections of every window."""
        return torch.where(self.index >= 0, values[self.index.clamp(min=0)], 0.0)

    def gathered(self, slopes: Float[Tensor, "K 3 7"]) -> Float[Tensor, "3K n"]:
        """Derivatives in the parameters from those in every window's own corrections."""
        one_hot = (self.index[..., None] == torch.arange(len(self.names))).double()
        return (slopes @ one_hot).reshape(-1, len(self.names))

    def anisotropy(self, values: Float[Tensor, "n"]) -> Float[Tensor, "2"]:
        """Anisotropy of the table, zero where it is not unknown."""
        places = [i for i, kind in enumerate(self.kind) if kind == "anisotropy"]
        return values[places] if places else torch.zeros(2, dtype=torch.float64)

    def bounded(self, values: Float[Tensor, "n"]) -> Float[Tensor, "n"]:
        """Values with an anisotropy of at most STRONGEST and the others within three widths."""
        of_table = torch.tensor([kind == "anisotropy" for kind in self.kind])
        norm = self.anisotropy(values).norm().clamp(min=STRONGEST)
        values = torch.where(of_table, values * STRONGEST / norm, values)
        return torch.where(of_table, values, torch.maximum(torch.minimum(values, 3 * self.width), -3 * self.width))

    def sentences(self, seen: Bool[np.ndarray, "n"]) -> tuple[str, ...]:
        """Kinds and trials that were seen, and those that were not with the reason."""
        found = []
        for kind, noun in NOUNS.items():
            of_kind = [i for i, each in enumerate(self.kind) if each == kind]
            if kind == "anisotropy" and of_kind:
                found.append(f"{noun} {'seen' if seen[of_kind].all() else WHY_NOT[kind]}")
                continue
            blind = sorted({self.trial[i] for i in of_kind if not seen[i]})
            if clear := sorted({self.trial[i] for i in of_kind} - set(blind)):
                found.append(f"{noun} of {_listed(clear)} seen")
            if blind:
                found.append(f"{noun} of {_listed(blind)} {WHY_NOT[kind]}")
        return tuple(found)


def _listed(trials: list[int]) -> str:
    """Trials by their numbers, counted from 0."""
    first = ", ".join(map(str, trials[:-1]))
    return f"trials {first} and {trials[-1]}" if first else f"trial {trials[0]}"


@dataclass(frozen=True, eq=False)
class NuisanceSystem:
    """Q s - J (n - n_0) = b of unit variance, linear about the parameters n_0 at which b was worked out."""

    system: LinearSystem
    """Q s = b at n_0."""
    slopes: Float[Tensor, "R n"]
    """J = db/dn - dQ/dn s."""
    layout: NuisanceLayout
    at: Float[Tensor, "n"]
    """n_0."""

    @staticmethod
    def of(
        equations: Callable[[Observations], FrictionEquations],
        windows: Observations,
        layout: NuisanceLayout,
        at: Float[Tensor, "n"],
    ) -> NuisanceSystem:
        """Linearize about some parameters.

        Args:
            equations: friction equations of given windows.
            windows: windows of constant speed, as measured.
            layout: the parameters.
            at: n_0, as found in the round before, or zero.
        """
        windows = corrected(windows, layout.spread(at), biased="bias" in layout.kind)
        found = equations(windows)
        system = found.whitened()
        return NuisanceSystem(system, system.whiten @ layout.gathered(windows.slopes(found)), layout, at)

    def reduced(self) -> LinearSystem:
        """The system for s alone, the parameters eliminated: for every s they take their best values."""
        first = torch.linalg.qr(self._parameter_rows() * self.layout.whole, mode="complete")[0]
        left = first[:, len(self.at) :].T
        rows = len(self.system.q)
        q = left[:, :rows] @ self.system.q
        q = torch.where(q.abs() > ROUNDING * self.system.q.norm(dim=0), q, 0.0)
        return LinearSystem(q, left @ self._targets(), left[:, :rows] @ self.system.whiten)

    def parameters(self, loads: Float[np.ndarray, "n_s"]) -> Float[Tensor, "n"]:
        """n that fits best with some loads."""
        rows = self._parameter_rows() * self.layout.whole
        missing = self._targets() - torch.cat([self.system.q @ torch.tensor(loads), torch.zeros_like(self.at)])
        step = torch.linalg.lstsq(rows, missing[:, None], driver="gelsd").solution[:, 0] * self.layout.whole
        return self.layout.bounded(self.at + step)

    def standard_error(self) -> Float[np.ndarray, "n"]:
        """Standard error of each parameter, with all loads unknown as well; infinite where it is not seen.

        A parameter is seen where the trials alone show it closer than its width, and a bias closer than the largest
        wrench.
        """
        layout, count = self.layout, self.system.q.shape[1]
        flat = torch.isinf(layout.width)
        reach = torch.where(flat, FAR * layout.whole, layout.width)
        per_load = FAR * self.system.b.norm() / self.system.q.norm(dim=0).clamp(min=1e-300)
        unit = torch.cat([per_load, reach])
        root = torch.cat([torch.cat([self.system.q, -self.slopes], 1) * unit, torch.eye(len(unit), dtype=unit.dtype)])
        inverse = torch.linalg.pinv(root)
        error = inverse[count:].norm(dim=1) * reach
        seen = torch.where(flat, error < layout.whole, error < layout.width / 2**0.5)
        return torch.where(seen, error, torch.inf).numpy()

    def _parameter_rows(self) -> Float[Tensor, "R+n n"]:
        return torch.cat([-self.slopes, torch.diag(1 / self.layout.width)])

    def _targets(self) -> Float[Tensor, "R+n"]:
        return torch.cat([self.system.b, -self.at / self.layout.width])
