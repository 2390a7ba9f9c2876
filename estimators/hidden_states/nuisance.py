"""What the bench itself may hide, and what takes it off the windows: the sensor's bias, the grasp's place, a grain.

Each is a correction of the steady windows. A bias is what the tare of a trial left in f_x, f_y and the torque, constant
in object axes since the hand holds both sensor and object; what it left in the others is taken to be as large. A grasp
offset is how far the object lies from where the hand takes it to be, one a trial, and shifts every particle against the
TCP; its yaw is held by flat pads on flat faces. A grain is the table's, not the object's: elliptic Coulomb friction
f = -N A v / sqrt(v . A v), of most dissipation within the ellipse of friction, A = mu^2 (1 + H) / sqrt(1 - h . h),
H = [[h_1, h_2], [h_2, -h_1]]. It turns against the object as that turns, and a half turn averages it away to first
order.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from estimators.base import Estimate
from estimators.particles.friction_system import FrictionEquations, LinearSystem
from estimators.particles.model import ParticleModel, cross
from estimators.particles.pivots import PivotInertia
from estimators.particles.windows import PLANAR, Observations
from testbed.errors import InvalidValueError
from testbed.trajectory import Trajectory
from testbed.validation import is_number

UNKNOWNS = ("bias", "grasp_offset", "anisotropy")
BIAS, OFFSET, GRAIN = slice(0, 3), slice(3, 5), slice(5, 7)
"""Places of a window's seven corrections."""
STRONGEST = 0.9
"""Length of the grain that is not gone beyond: frictions of 1 to 4.4."""
NOUNS = {"bias": "bias", "grasp_offset": "grasp offset", "anisotropy": "anisotropy of friction"}
WHY_NOT = {
    "bias": "not at all: one way, a constant bias passes for friction; turn back in the same grasp",
    "grasp_offset": "no closer than was thought before: turn about more points",
    "anisotropy": "no closer than was thought before: half turns average it away; turn through less, from other yaws",
}
YAWS, SHARES = np.polynomial.legendre.leggauss(12)


@dataclass(frozen=True)
class Nuisances:
    """Which of them are unknown, and how far they are thought to go: one standard deviation."""

    unknown: tuple[str, ...] = ()
    """Any of bias, grasp_offset, anisotropy."""
    bias: float = math.inf
    """N and N m; infinite: nothing is assumed of it."""
    grasp_offset: float = 0.003
    """Along each axis, m."""
    anisotropy: float = 0.3
    """Of each component of the grain; 0.22 is a friction of 0.8 to 1."""

    def __post_init__(self) -> None:
        known = isinstance(self.unknown, tuple) and set(self.unknown) <= set(UNKNOWNS)
        if not known or len(set(self.unknown)) < len(self.unknown):
            raise InvalidValueError("unknown", self.unknown, f"any of {', '.join(UNKNOWNS)}, each once")
        for name in UNKNOWNS:
            value = getattr(self, name)
            if not ((is_number(value) and value > 0) or (name == "bias" and value == math.inf)):
                raise InvalidValueError(f"Nuisances.{name}", value, "a number > 0")

    def loosened(
        self, pivots: PivotInertia, windows: Observations, mass: float, com: Float[np.ndarray, "2"]
    ) -> PivotInertia:
        """I_j with what an offset of the grasp may add to it: 2 M (p_j - c) . offset, another draw in every trial."""
        if "grasp_offset" not in self.unknown:
            return pivots
        at = np.linalg.norm(windows.grasp.numpy()[:, None] - pivots.pivot, axis=-1).argmin(axis=1)
        trials = np.array([len(np.unique(windows.trial.numpy()[at == j])) for j in range(len(pivots.pivot))])
        slope = 2 * mass * np.linalg.norm(pivots.pivot - com, axis=1)
        moved = (slope * self.grasp_offset) ** 2 / trials
        return PivotInertia(pivots.pivot, pivots.inertia, pivots.variance + moved, pivots.common_error)


@dataclass(frozen=True, eq=False)
class Corrected(Observations):
    """Windows with bias and offset taken off, over a table with a grain."""

    grain: Float[Tensor, "K 2"]
    """h = r (cos 2 phi, sin 2 phi): phi the table's direction of most friction, most over least ((1+r)/(1-r))^0.5."""

    def drag_rows(
        self, model: ParticleModel, pivot_error: float
    ) -> tuple[Float[Tensor, "K 3 P"], Float[Tensor, "K P"]]:
        """As of `Observations`, each particle's drag turned and stretched by the grain."""
        rows, lost = super().drag_rows(model, pivot_error)
        unit = grained(self, rows[:, :2].transpose(1, 2))
        return torch.stack([unit[..., 0], unit[..., 1], cross(self.lever(model), unit)], 1), lost


@dataclass(frozen=True, eq=False)
class Layout:
    """A vector of n unknowns, and which of them correct which window."""

    names: tuple[str, ...]
    """One a unknown: kind, trial and component, with the unit."""
    kind: tuple[str, ...]
    trial: tuple[int, ...]
    """-1 for those of all trials."""
    width: Float[Tensor, "n"]
    """How far each is thought to go."""
    whole: Float[Tensor, "n"]
    """As far as it could go by sight: the width, and of a bias the most that was felt."""
    index: Int[Tensor, "K 7"]
    """Of each window's corrections; -1 where there is none."""

    @staticmethod
    def of(nuisances: Nuisances, windows: Observations) -> Layout:
        """The unknowns of some windows."""
        names: list[str] = []
        kinds: list[str] = []
        trials: list[int] = []
        whole: list[float] = []
        index = torch.full((len(windows), 7), -1)
        felt = windows.wrench.abs().amax(0).tolist()
        most = max(felt[:2])

        def add(kind: str, trial: int, place: int, name: str, most: float) -> None:
            index[(windows.trial == trial) | (trial < 0), place] = len(names)
            names.append(name)
            kinds.append(kind)
            trials.append(trial)
            whole.append(most)

        for trial in windows.trial.unique().tolist():
            if "bias" in nuisances.unknown:
                for place, (axis, size) in enumerate((("fx_N", most), ("fy_N", most), ("tz_Nm", felt[2]))):
                    add("bias", trial, place, f"bias_{trial}_{axis}", min(nuisances.bias, max(size, 1e-6)))
            if "grasp_offset" in nuisances.unknown:
                for place, axis in enumerate("xy"):
                    add("grasp_offset", trial, 3 + place, f"grasp_offset_{trial}_{axis}_m", nuisances.grasp_offset)
        if "anisotropy" in nuisances.unknown:
            for place, axis in enumerate("xy"):
                add("anisotropy", -1, 5 + place, f"grain_{axis}", nuisances.anisotropy)
        width = torch.tensor([getattr(nuisances, kind) for kind in kinds], dtype=torch.float64)
        sizes = torch.tensor(whole, dtype=torch.float64)
        return Layout(tuple(names), tuple(kinds), tuple(trials), width, sizes, index)

    def spread(self, values: Float[Tensor, "n"]) -> Float[Tensor, "K 7"]:
        """Corrections of every window."""
        return torch.where(self.index >= 0, values[self.index.clamp(min=0)], 0.0)

    def gathered(self, slopes: Float[Tensor, "K 3 7"]) -> Float[Tensor, "3K n"]:
        """Derivatives in the unknowns from those in every window's own corrections."""
        one_hot = (self.index[..., None] == torch.arange(len(self.names))).double()
        return (slopes @ one_hot).reshape(-1, len(self.names))

    def grain(self, values: Float[Tensor, "n"]) -> Float[Tensor, "2"]:
        """The table's, zero where it is not unknown."""
        grain = [i for i, kind in enumerate(self.kind) if kind == "anisotropy"]
        return values[grain] if grain else torch.zeros(2, dtype=torch.float64)

    def in_words(self, seen: Bool[np.ndarray, "n"]) -> tuple[str, ...]:
        """What was seen of each kind, and why not where it was not."""
        said = []
        for kind, noun in NOUNS.items():
            of_kind = [i for i, each in enumerate(self.kind) if each == kind]
            if kind == "anisotropy" and of_kind:
                said.append(f"{noun} {'seen' if seen[of_kind].all() else WHY_NOT[kind]}")
                continue
            blind = sorted({self.trial[i] for i in of_kind if not seen[i]})
            if clear := sorted({self.trial[i] for i in of_kind} - set(blind)):
                said.append(f"{noun} of {_trials(clear)} seen")
            if blind:
                said.append(f"{noun} of {_trials(blind)} {WHY_NOT[kind]}")
        return tuple(said)

    def kept_within(self, values: Float[Tensor, "n"]) -> Float[Tensor, "n"]:
        """The same, no grain stronger than any, no offset that nobody would overlook."""
        of_table = torch.tensor([kind == "anisotropy" for kind in self.kind])
        values = torch.where(of_table, values * STRONGEST / self.grain(values).norm().clamp(min=STRONGEST), values)
        return torch.where(of_table, values, torch.maximum(torch.minimum(values, 3 * self.width), -3 * self.width))


def corrected(windows: Observations, by: Float[Tensor, "K 7"], *, biased: bool = False) -> Corrected:
    """Windows with the corrections made; differentiable in them.

    Args:
        windows: as measured.
        by: bias, offset and grain of each.
        biased: the bias is unknown: what it makes likely of f_z, t_x and t_y goes with it, and only what it leaves open
            of them counts as an error.
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
    given = {field.name: getattr(windows, field.name) for field in fields(Observations)}
    return Corrected(
        **given
        | {
            "wrench": windows.wrench - whole[:, PLANAR],
            "lift": windows.lift - carried[:, 0],
            "tilt": windows.tilt - carried[:, 1:],
            "grasp": windows.grasp + by[:, OFFSET],
            "bias": left,
        },
        grain=by[:, GRAIN],
    )


def grained(windows: Observations, unit: Float[Tensor, "K P 2"]) -> Float[Tensor, "K P 2"]:
    """Directions of drag from those of motion, object axes; the same without a grain.

    The mean over the yaws of each window, which is that over a turn at constant speed.
    """
    if not isinstance(windows, Corrected):
        return unit
    begin, end = windows.since_tare.T
    yaw = windows.yaw[:, :1] + (windows.twist[:, 2] * (end - begin))[:, None] * torch.tensor((1 + YAWS) / 2)
    cos, sin, (h1, h2) = torch.cos(2 * yaw), torch.sin(2 * yaw), windows.grain.T[..., None]
    ahead, aside = (each[:, None] for each in (cos * h1 + sin * h2, cos * h2 - sin * h1))  # the grain in object axes
    u, v = unit[..., :1], unit[..., 1:]
    dragged = torch.stack([(1 + ahead) * u + aside * v, aside * u + (1 - ahead) * v], -1)  # (K, P, yaws, 2)
    along = (dragged * unit[:, :, None]).sum(-1)
    scale = ((unit.square().sum(-1)[..., None] + 1e-30) / (along + 1e-30)).sqrt()
    scale = scale / (1 - windows.grain.square().sum(-1))[:, None, None] ** 0.25
    return (dragged * scale[..., None] * torch.tensor(SHARES / 2)[:, None]).sum(2)


def restated(trajectories: Sequence[Trajectory], found: Mapping[str, float]) -> list[Trajectory]:
    """Trajectories whose sensor states no less bias than was found in what is seen of it.

    f_z, t_x and t_y bias the gripper's load, which is friction's own size and no constant: their bias is not seen, but
    is as large as that of the others.

    Args:
        trajectories: as the sensor stated it.
        found: biases and their errors by name, as an answer's diagnostics have them.
    """

    def size(*axes: str) -> float:
        names = [n for n in found if n.startswith("bias_") and n.endswith(axes) and np.isfinite(found[f"{n}_error"])]
        squares = [found[name] ** 2 - found[f"{name}_error"] ** 2 for name in names]
        return math.sqrt(max(float(np.mean(squares)), 0.0)) if squares else 0.0

    least = np.repeat([size("_fx_N", "_fy_N"), size("_tz_Nm")], 3)
    return [replace(t, sensor_bias_std=np.maximum(t.sensor_bias_std, least)) for t in trajectories]


def ellipse(grain: Float[Tensor, "2"]) -> tuple[float, float]:
    """Least over most friction, and the table's direction of most, rad."""
    r = float(grain.norm())
    return math.sqrt((1 - r) / (1 + r)), math.atan2(float(grain[1]), float(grain[0])) / 2


def _trials(numbers: list[int]) -> str:
    """Trials by their numbers, counted from 0."""
    first = ", ".join(map(str, numbers[:-1]))
    return f"trials {first} and {numbers[-1]}" if first else f"trial {numbers[0]}"


FAR = 100.0
"""Of a bias and of the loads, how many times the most that was felt is as good as nothing known."""
NOTHING = 1e-9
"""Part of a column that is left where rounding is all that is left."""


@dataclass(frozen=True, eq=False)
class JointLoads:
    """Q s - J (n - n_0) = b of unit variance, linear about the unknowns n_0 that b was worked out with."""

    system: LinearSystem
    """Q s = b at n_0."""
    slopes: Float[Tensor, "R n"]
    """J = db/dn - dQ/dn s."""
    layout: Layout
    at: Float[Tensor, "n"]
    """n_0."""

    @staticmethod
    def of(
        equations: Callable[[Observations], FrictionEquations],
        windows: Observations,
        layout: Layout,
        at: Float[Tensor, "n"],
        loads: Float[np.ndarray, "n_s"],
    ) -> JointLoads:
        """Linearised about some unknowns and loads.

        Args:
            equations: the friction equations of windows.
            windows: of constant speed, as measured.
            layout: what is unknown.
            at: n_0, as found in the round before, or zero.
            loads: s, as found or guessed, N.
        """
        by = layout.spread(at).requires_grad_()
        found = equations(corrected(windows, by, biased="bias" in layout.kind))
        missing = (found.b - found.q @ torch.tensor(loads)).reshape(-1, 3)
        each = [torch.autograd.grad(missing[:, i].sum(), by, retain_graph=i < 2)[0] for i in range(3)]
        system = found.whitened()
        whiten = system.whiten.detach()
        plain = LinearSystem(system.q.detach(), system.b.detach(), whiten)
        return JointLoads(plain, whiten @ layout.gathered(torch.stack(each, 1)), layout, at)

    def reduced(self) -> LinearSystem:
        """What is left for s when the unknowns fit as well as they can and like: their best is put in for every s."""
        first = torch.linalg.qr(self._unknown_rows() * self.layout.whole, mode="complete")[0]
        left = first[:, len(self.at) :].T
        rows = len(self.system.q)
        q = left[:, :rows] @ self.system.q
        q = torch.where(q.abs() > NOTHING * self.system.q.norm(dim=0), q, 0.0)
        return LinearSystem(q, left @ self._felt(), left[:, :rows] @ self.system.whiten)

    def unknowns(self, loads: Float[np.ndarray, "n_s"]) -> Float[Tensor, "n"]:
        """n that fits best with some loads."""
        rows = self._unknown_rows() * self.layout.whole
        missing = self._felt() - torch.cat([self.system.q @ torch.tensor(loads), torch.zeros_like(self.at)])
        step = torch.linalg.lstsq(rows, missing[:, None], driver="gelsd").solution[:, 0] * self.layout.whole
        return self.layout.kept_within(self.at + step)

    def standard_error(self) -> Float[np.ndarray, "n"]:
        """Of each unknown, with all loads unknown as well; infinite where the trials say less than was thought before.

        Seen is what the trials alone tell closer than its width, and of a bias than the most that was felt.
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

    @property
    def grain(self) -> Float[Tensor, "2"]:
        """Of the table, as b was worked out with; zero where it is not unknown."""
        return self.layout.grain(self.at)

    def told(self, estimate: Estimate, loads: Float[np.ndarray, "n_s"]) -> Estimate:
        """An answer with the unknowns that fit its loads, their errors, and in its report which of them were seen."""
        values, errors = self.unknowns(loads), self.standard_error()
        numbers = dict(zip(self.layout.names, values.tolist(), strict=True))
        numbers |= {f"{name}_error": float(e) for name, e in zip(self.layout.names, errors, strict=True)}
        if "anisotropy" in self.layout.kind:
            numbers["friction_ratio"], numbers["friction_axis_rad"] = ellipse(self.layout.grain(values))
        report, hidden, said = estimate.identifiability, estimate.hidden, self.layout.in_words(np.isfinite(errors))
        blind = [each for each in said if not each.endswith(" seen")]
        return replace(
            estimate,
            message="; ".join(filter(None, [estimate.message, *(blind if estimate.distribution is None else ())])),
            identifiability=replace(report, bench=said) if report else None,
            hidden=replace(hidden, unobserved="; ".join(filter(None, [hidden.unobserved, *blind]))) if hidden else None,
            diagnostics=estimate.diagnostics | numbers,
        )

    def _unknown_rows(self) -> Float[Tensor, "R+n n"]:
        return torch.cat([-self.slopes, torch.diag(1 / self.layout.width)])

    def _felt(self) -> Float[Tensor, "R+n"]:
        return torch.cat([self.system.b, -self.at / self.layout.width])
