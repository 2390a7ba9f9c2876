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
    """Standard deviations of the errors of a setup by name, each in the shape of its unknown; zeros are left out.

    Args:
        setup: errors as stated.
        where: kinds of measurements, as in `Parameter.shows`; errors that change none of them are left out.
        groups: number of mass groups; 0 for a body of unknown matter, whose groups have no errors.
        feet: number of feet at known places.
        trials: number of trials that are treated as independent: shared errors are sqrt(`trials`) times larger.
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
