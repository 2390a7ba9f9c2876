"""The friction loads together with what the bench hides, as one system; solved for the one, then for the other."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from estimators.friction_loads import FrictionEquations, LinearSystem
from estimators.nuisance import Layout, corrected, ellipse
from estimators.observations import Observations
from estimators.protocol import Estimate

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
