"""Sizes of the errors of a setup, as unknowns of the forward model."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from testbed.worlds.parameters import FULL_SCALE
from testbed.worlds.setup_errors import PARAMETERS, SetupErrors


def stated_sizes(
    setup: SetupErrors, where: tuple[str, ...], groups: int = 0, feet: int = 0, trials: int = 1
) -> dict[str, Tensor]:
    """Standard deviations of errors of a setup by name, each in the shape of its unknown; those of 0 are left out.

    Args:
        setup: errors as stated.
        where: measurements that they change, any of those of `Parameter.shows`.
        groups: mass groups; 0 of a body of unknown matter, whose groups have no errors.
        feet: feet of known places.
        trials: trials that are taken as independent: an error that they share counts root `trials` times in each.
    """
    found = {}
    for name, described in PARAMETERS.items():
        size, shape = getattr(setup, name), described.sized(groups, feet)
        if size and 0 not in shape and set(where) & set(described.shows):
            shared = 1.0 if described.scope == "trial" else trials**0.5
            found[name] = torch.full(shape, size * shared, dtype=torch.float64)
    if "crosstalk" in found:
        found["crosstalk"] *= torch.tensor(np.outer(FULL_SCALE, 1 / FULL_SCALE) * (1 - np.eye(6)))
    return found
