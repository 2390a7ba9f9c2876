"""Misfit of an answer: how far its wrenches are from the measured ones in units of their errors, and why."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from scipy.stats import chi2

CHANCE = 1e-3
"""Chance that the stated errors alone give as large a misfit, below which errors are widened."""
UNEXPLAINED = 3.0
"""Misfit from which an answer does not explain the trials, where it is no chance: the status `unexplained` of every
method. Ours: three times the stated variance is more than calibration leaves, and a wrong support, sign or grasp gives
ten and more."""
SAME_INERTIA = 0.02
"""Part by which the inertia that trials show may differ from that of the masses, below which no weight is in doubt."""
NEXT = (
    "support_aware tests whether the groups rest on their own weight at all; heft doctor looks for a trial or an error "
    "of the setup that explains it"
)
"""Next step where an answer does not explain the trials."""


@dataclass(frozen=True)
class Misfit:
    """Misfit of an answer."""

    value: float
    """Squared residual over its variance, mean over degrees of freedom: about 1, or less, where the model holds."""
    freedom: int
    """Degrees of freedom: rows less unknowns."""
    inertia: float | None = None
    """Inertia that accelerated turns show over that of the masses, where it is what they do not explain."""
    least: float | None = None
    """Mean squared residual that the best friction loads leave; None where it is not asked for."""

    @property
    def by_chance(self) -> bool:
        """True if the stated errors alone may give it."""
        return self.freedom < 1 or self.value <= max(1.0, float(chi2.isf(CHANCE, self.freedom)) / self.freedom)

    @property
    def widening(self) -> float:
        """Factor of the covariance, the square of Birge's ratio; 1 where the misfit may be chance."""
        return 1.0 if self.by_chance else self.value

    @property
    def explains(self) -> bool:
        """True if the answer explains the trials, by the errors stated or nearly."""
        return self.by_chance or self.value <= UNEXPLAINED

    @property
    def status(self) -> Literal["ok", "unexplained"]:
        """Status of an answer of which nothing else is known."""
        return "ok" if self.explains else "unexplained"

    @property
    def diagnostics(self) -> dict[str, float]:
        """Entries of `Estimate.diagnostics`."""
        return {"misfit": self.value, "misfit_freedom": float(self.freedom)}

    @property
    def reason(self) -> str:
        """Why the answer does not explain the trials; empty where it does."""
        if self.explains:
            return ""
        size = f"{self.value:.2g}" if self.value < 100 else f"{self.value:.0f}"
        begin = f"the masses do not explain the trials: misfit {size} in place of 1"
        if self.least is not None and self.least <= UNEXPLAINED:
            return f"{begin}, which others do (misfit {self.least:.2g}): the search ended early"
        if self.inertia is not None and abs(self.inertia - 1) < SAME_INERTIA:
            return f"{begin}; accelerated turns show inertia of another distribution than these masses have; {NEXT}"
        if self.inertia is not None:
            found = f"accelerated turns show {100 * self.inertia:.0f} % of the inertia that these masses have"
            checks = "weigh the object again, check the torque's unit and the object's size, or ask support_aware"
            return f"{begin}; {found}: {checks}"
        return f"{begin}; {NEXT}"
