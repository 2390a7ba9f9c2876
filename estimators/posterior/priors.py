"""Priors of all unknowns of an object in a setup."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch
from jaxtyping import Bool
from torch import Tensor

from estimators.particles.links import HINGE_PRIOR
from estimators.posterior.on_table import ContactPatterns
from estimators.posterior.unknowns import Block, Unknowns
from estimators.wrench.model import MODEL_PARAMETERS, ModelErrors, ParticleModel
from estimators.wrench.setup import stated_sizes
from estimators.wrench.support import contact_spread
from testbed.objects.model import ObjectShape
from testbed.worlds.setup_errors import PARAMETERS, SetupErrors

MASS_STD, FRICTION_STD = 1.2, 1.0
"""Standard deviations of the logarithms of a group's mass and of a friction. Ours."""
FRICTION = 0.4
"""Median friction. Ours."""
SHARES = 2.0
"""Sum of squared shares of the load of n points, times n: 1 for equal shares. Ours, for three to eight points."""
LEAN = 0.25
"""Size of the affine patterns of unknown points, which move a group off their middle, over that of the other patterns.
Ours."""
UNLEVEL = 0.6
"""`LEAN` of groups that the trials show off their middles. Ours, calibrated on objects of seed 4242 of the honesty
bench."""
RADIUS = 1.5
"""Standard deviation of the amplitude of `ContactPatterns.radial`, which all groups share: blocks of one make touch the
table alike, in the middle (-1.6) or at the corners (2.3). Ours, calibrated on objects of seed 4242 of the honesty
bench."""


def priors(
    shape: ObjectShape,
    setup: SetupErrors,
    errors: ModelErrors,
    weight: float,
    trials: int,
    *,
    joined: bool = False,
    lifted: bool = True,
) -> Unknowns:
    """Unknowns of an object: masses, frictions, and every error of the setup and of the model that is not 0.

    Args:
        shape: geometry and groups.
        setup: errors of the setup, standard deviations.
        errors: errors of the model.
        weight: M, kg.
        trials: number of trials on the table.
        joined: True if springs of unknown stiffness join the groups.
        lifted: False without lifts, which leaves out the errors that nothing else shows.
    """
    typical, model = weight / float(shape.particles_per_group.sum()), ParticleModel.of(shape)
    blocks = {
        "mass": Block.log_normal(typical * np.exp(-0.5), MASS_STD, shape.n_m),
        # masses that change with the inverse of several frictions keep the friction loads that trials show
        "friction": Block.log_normal(FRICTION, FRICTION_STD, shape.n_mu, inverse=shape.n_mu > 1),
    }
    pattern, uneven = unevenness(setup, model)
    if uneven:
        # the variance of a pattern over n points, spread over the points of the model
        patterns = ContactPatterns.of(model, model.points(spread=True))
        count = patterns.count.clamp(min=1)
        points = count if model.stands_on_feet else setup.contact_points
        size = (uneven / points / count).sqrt()[:, None].repeat(1, patterns.radial.shape[-1])
        size[:, :2] *= 0.0 if model.stands_on_feet else LEAN
        blocks[pattern] = Block.normal(size)
        if not model.stands_on_feet:
            blocks["contact_radius"] = Block.normal(RADIUS)
    shown = ("table", "reading") + ("air",) * lifted
    for name, size in stated_sizes(setup, shown, shape.n_m, len(shape.feet)).items():
        blocks[name] = Block.normal(size, trials if PARAMETERS[name].scope == "trial" else None)
    for name in MODEL_PARAMETERS:
        if size := getattr(errors, f"{name}_error"):
            blocks[name] = Block.normal(size)
    if shape.is_uneven:  # matter that fills its cells in part may lie at any height in them
        blocks["com_height"] = Block.normal(torch.full((shape.n_m,), shape.height / 12**0.5, dtype=torch.float64))
    if joined:
        blocks["rigid_share"] = Block(torch.tensor(0.5, dtype=torch.float64), torch.tensor(1.0, dtype=torch.float64))
    if open_loads := contact_spread(model, model.parts.sum(0)).shape[1]:
        blocks["indeterminate_load"] = Block.normal(torch.ones(open_loads, dtype=torch.float64))
    if shape.chain is not None:
        hinges = torch.full((len(shape.chain.hinges),), HINGE_PRIOR, dtype=torch.float64)
        blocks["hinge_friction"], blocks["links_carried"] = Block.normal(hinges), Block.normal(1.0)
    return Unknowns({name: block for name, block in blocks.items() if bool((block.std > 0).any())})


def unlevel(unknowns: Unknowns) -> tuple[Bool[Tensor, "n"], Unknowns]:
    """Mask of the affine patterns of unknown points in z, and unknowns in which they have the size `UNLEVEL`."""
    leans = torch.zeros(len(unknowns), dtype=torch.bool)
    if "contact_points" not in unknowns.blocks:
        return leans, unknowns
    block, where = unknowns.blocks["contact_points"], unknowns.at["contact_points"]
    affine = torch.zeros_like(block.std, dtype=torch.bool)
    affine[:, :2] = block.std[:, :2] > 0
    leans[where] = affine.flatten()
    widened = replace(block, std=torch.where(affine, block.std * UNLEVEL / LEAN, block.std))
    return leans, Unknowns(unknowns.blocks | {"contact_points": widened})


def unevenness(setup: SetupErrors, model: ParticleModel) -> tuple[str, float]:
    """Error of the setup that makes the loads of a group's points of contact uneven, and its size.

    Either unequal loads on known feet, or few points anywhere under a group. Balance determines the loads of a rigid
    body's points.

    Returns:
        Name of the error, and variance of a load relative to an even share, 0 if known.
    """
    if model.stands_on_feet:
        return "foot_load", setup.foot_load**2
    unknown = setup.contact_points and not bool(model.is_contact.any())
    return "contact_points", SHARES if unknown else 0.0
