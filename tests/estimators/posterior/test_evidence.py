"""Evidence of linear models of known evidence, and of errors that are stated too large or too small."""

from dataclasses import dataclass, field

import numpy as np
import pytest
import torch
from torch import Tensor

from estimators.posterior.posterior import Posterior
from estimators.posterior.solver import Linearized, solve
from estimators.posterior.unknowns import Block, Unknowns

ROWS = 60
RNG = np.random.default_rng(3)
DESIGN = torch.tensor(RNG.standard_normal((ROWS, 2)))
NOISE = torch.tensor(RNG.standard_normal(ROWS))


@dataclass(frozen=True, eq=False)
class Rows:
    """y = DESIGN[:, :n] value + noise of a stated variance, of which some rows may go into a load."""

    y: Tensor
    variance: float
    parts: list = field(default_factory=list)

    def linearized(self, unknowns: Unknowns, z: Tensor) -> Linearized:
        slopes = DESIGN[:, : len(unknowns)]
        blocks = [(torch.arange(ROWS)[None], self.variance * torch.eye(ROWS, dtype=torch.float64)[None])]
        return Linearized(slopes @ z - self.y, slopes, blocks, lambda other: (slopes @ other - self.y, blocks))


def posterior(unknown: int, variance: float) -> Posterior:
    """Posterior of that many unknowns of standard normals; the truth is (1, -1), its noise of unit variance."""
    rows = Rows(DESIGN @ torch.tensor([1.0, -1.0], dtype=torch.float64) + NOISE, variance)
    unknowns = Unknowns({"value": Block.normal(torch.ones(unknown, dtype=torch.float64))})
    return Posterior(unknowns, [rows], solve([rows], unknowns, unknowns.start()))


@pytest.mark.parametrize("unknown", [1, 2])
def test_the_evidence_of_a_linear_model_is_exact(unknown):
    found, slopes = posterior(unknown, 1.0), DESIGN[:, :unknown]
    y = found.measurements[0].y  # pyright: ignore[reportAttributeAccessIssue]
    covariance = slopes @ slopes.T + torch.eye(ROWS, dtype=torch.float64)
    exact = -(y @ torch.linalg.solve(covariance, y) + torch.linalg.slogdet(covariance)[1]) / 2
    assert found.log_evidence == pytest.approx(float(exact), abs=1e-9)


def test_a_common_factor_of_stated_errors_changes_no_choice():
    factors = {v: [posterior(n, v) for n in (1, 2)] for v in (0.1, 1.0, 10.0)}
    gain = {v: two.log_evidence_to_scale - one.log_evidence_to_scale for v, (one, two) in factors.items()}
    plain = {v: two.log_evidence - one.log_evidence for v, (one, two) in factors.items()}
    assert gain[0.1] == pytest.approx(gain[1.0], abs=1) and gain[10.0] == pytest.approx(gain[1.0], abs=1)
    assert plain[0.1] > 5 * plain[1.0] and plain[10.0] < plain[1.0] / 5
    assert gain[1.0] > 5
