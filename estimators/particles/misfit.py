"""Misfit of an estimate: residual of its wrenches in units of their errors, and the likely reason."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from scipy.special import chdtri

CHANCE = 1e-3
"""Probability of a misfit as large under the stated errors, below which errors are widened."""
UNEXPLAINED = 3.0
"""Misfit above which an estimate does not explain the trials, unless by chance: the status `unexplained` of every
method. Ours: calibration leaves less than three times the stated variance, and a wrong support, sign or grasp gives ten
or more."""
SAME_INERTIA = 0.02
"""Relative difference between the inertia of trials and that of the masses below which the weight is not doubted."""
NEXT = (
    "support_aware tests whether the groups rest on their own weight at all; heft doctor looks for a trial or an error "
    "of the setup that explains it"
)
"""Next step where an estimate does not explain the trials."""


@dataclass(frozen=True)
class Misfit:
    """Misfit of an estimate."""

    value: float
    """Squared residual over its variance, mean over degrees of freedom: about 1, or less, where the model holds."""
    freedom: int
    """Degrees of freedom: rows less unknowns."""
    inertia: float | None = None
    """Inertia that accelerated turns show over that of the masses, where the inertia is the cause; else None."""
    least: float | None = None
    """Misfit of the best friction loads; None where it is not computed."""

    @property
    def by_chance(self) -> bool:
        """True if the stated errors alone explain the misfit."""
        return self.freedom < 1 or self.value <= max(1.0, float(chdtri(self.freedom, CHANCE)) / self.freedom)

    @property
    def widening(self) -> float:
        """Factor on the covariance, the square of Birge's ratio; 1 where the misfit may be chance."""
        return 1.0 if self.by_chance else self.value

    @property
    def explains(self) -> bool:
        """True if the estimate explains the trials, by the stated errors or errors slightly larger."""
        return self.by_chance or self.value <= UNEXPLAINED

    @property
    def status(self) -> Literal["ok", "unexplained"]:
        """Status of an estimate by its misfit alone."""
        return "ok" if self.explains else "unexplained"

    @property
    def diagnostics(self) -> dict[str, float]:
        """Entries of `Estimate.diagnostics`."""
        return {"misfit": self.value, "misfit_freedom": float(self.freedom)}

    @property
    def reason(self) -> str:
        """Reason why the estimate does not explain the trials; empty where it does."""
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
