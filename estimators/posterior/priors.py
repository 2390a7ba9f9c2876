"""Priors of all unknowns of an object in a setup."""

from __future__ import annotations

import numpy as np
import torch

from estimators.particles.links import HINGE_PRIOR
from estimators.particles.setup_effects import SHARES
from estimators.posterior.on_table import OnTable
from estimators.posterior.unknowns import Block, Unknowns
from estimators.wrench.model import MODEL_PARAMETERS, ModelErrors
from estimators.wrench.setup import stated_sizes
from testbed.objects.model import ObjectShape
from testbed.worlds.setup_errors import PARAMETERS, SetupErrors

MASS_STD, FRICTION_STD = 1.2, 1.0
"""Standard deviations of the logarithms of a group's mass and of a friction. Ours."""
FRICTION = 0.4
"""Median friction. Ours."""
LEAN = 0.25
"""Affine part of a contact pattern, which carries a group off the middle of its feet, as a part of any other. Ours."""


def priors(shape: ObjectShape, setup: SetupErrors, errors: ModelErrors, weight: float, on_table: OnTable) -> Unknowns:
    """Unknowns of an object: masses, frictions, and every error of the setup and of the model that is not 0.

    Args:
        shape: geometry and groups.
        setup: errors of the setup, standard deviations.
        errors: errors of the model.
        weight: M, kg.
        on_table: trials on the table.
    """
    typical = weight / float(shape.particles_per_group.sum())
    blocks = {
        "mass": Block.log_normal(typical * np.exp(-0.5), MASS_STD, shape.n_m),
        "friction": Block.log_normal(FRICTION, FRICTION_STD, shape.n_mu),
    }
    if setup.contact_points:
        # the variance of a pattern over n points, of which as many as the points of the model are taken
        size = (
            (SHARES / (setup.contact_points * on_table.points)).sqrt()[:, None].repeat(1, on_table.patterns.shape[-1])
        )
        size[:, :2] *= LEAN
        blocks["contact_pattern"] = Block.normal(size)
    for name, size in stated_sizes(setup, ("table", "air", "reading"), shape.n_m).items():
        blocks[name] = Block.normal(size, on_table.trials if PARAMETERS[name].scope == "trial" else None)
    for name in MODEL_PARAMETERS:
        if size := getattr(errors, f"{name}_error"):
            blocks[name] = Block.normal(torch.tensor(size, dtype=torch.float64))
    if (shape.fill < 1).any():  # matter that fills its cells in part may lie at any height in them
        blocks["com_height"] = Block.normal(torch.full((shape.n_m,), shape.height / 12**0.5, dtype=torch.float64))
    if "per_mass_apart" in on_table.table.windows:
        blocks["other_support"] = Block.normal(torch.tensor(1.0, dtype=torch.float64))
    if open_loads := on_table.open_loads:
        blocks["indeterminate_load"] = Block.normal(torch.ones(open_loads, dtype=torch.float64))
    if shape.chain is not None:
        blocks["hinge_friction"] = Block.normal(
            torch.full((len(shape.chain.hinges),), HINGE_PRIOR, dtype=torch.float64)
        )
        blocks["links_carried"] = Block.normal(torch.tensor(1.0, dtype=torch.float64))
    return Unknowns({name: block for name, block in blocks.items() if bool((block.std > 0).any())})
