"""Recovery of a known block by an estimator, or its statement that it cannot."""

from __future__ import annotations

from collections.abc import Sequence

from estimators.action_selection.rank import predicted_rank
from estimators.base import Estimate, Estimator
from estimators.evaluation.metrics import normalized_absolute_difference
from estimators.testing.recorded import KnownBlock
from testbed.actions.rotate import Rotate
from testbed.trajectory import Trajectory

ALLOWED = {"ideal": 0.08, "low": 0.1, "moderate": 0.1, "ft300s": 0.1, "high": 0.2}
"""NAD that an answer of status ok may have under each preset, a part of 1."""


def recovers(
    estimator: Estimator,
    block: KnownBlock,
    sensing: str,
    trials: Sequence[Trajectory],
    slack: float = 1.0,
    claims: str = "own_weight",
) -> None:
    """Check that an answer of status ok is right, and that any other status has a message.

    A method that claims own weight alone must answer where a perfect sensor's trials show every mass. One that claims
    more is not given the support, and a block may not show it.

    Args:
        estimator: estimator under test.
        block: known block with its truth.
        sensing: preset of the trials.
        trials: trials for the estimator.
        slack: factor on `ALLOWED`.
        claims: supports that the estimator claims to know: own_weight, rigid or both.

    Raises:
        AssertionError: with a sentence on what was answered and what is allowed.
    """
    model, limit = block.model, slack * ALLOWED[sensing]
    answer = estimator.estimate(model.shape, block.weighed(sensing), list(trials), 0)
    assert isinstance(answer, Estimate), f"estimate() gave a {type(answer).__name__}, not an Estimate"
    where = f"{model.name}, {block.support}, sensing {sensing}"
    if answer.status != "ok":
        assert answer.message, f"{where}: status {answer.status} without a message"
        must = sensing == "ideal" and claims == block.support == "own_weight" and shows_every_mass(block)
        assert not must, f"{where}: status {answer.status} ({answer.message}), where these trials show every mass"
        return
    assert answer.distribution is not None, f"{where}: status ok without a mass distribution"
    nad = normalized_absolute_difference(model.shape, answer.distribution, model.truth)
    assert nad <= limit, _verdict(where, answer, block, nad, limit)


def shows_every_mass(block: KnownBlock) -> bool:
    """True if the turns have full rank and there is one friction, so that the masses follow from M."""
    # `planned_rank` takes the centers of turns at constant speed
    turns = [trial.action for trial in block.clean if isinstance(trial.action, Rotate)]
    return block.model.shape.n_mu == 1 and predicted_rank(block.model.shape, turns) == block.model.shape.n_m


def _verdict(where: str, answer: Estimate, block: KnownBlock, nad: float, limit: float) -> str:
    shape = block.model.shape
    assert answer.distribution is not None
    found = answer.distribution.mass * shape.particles_per_group
    masses = ", ".join(
        f"{name} {mine:.3f} ({true:.3f})"
        for name, mine, true in zip(shape.group_names, found, block.model.group_mass, strict=True)
    )
    frictions = ", ".join(f"{mine:.2f}" for mine in answer.distribution.friction)
    true_frictions = ", ".join(f"{mu:.2f}" for mu in block.model.truth.friction)
    hint = f"status ok claims no more than {100 * limit:.0f} %"
    if block.support == "rigid":
        hint += "; friction under one rigid body shows M and its centre alone: say so, or claim own_weight only"
    return (
        f"{where}: NAD {100 * nad:.1f} %; {hint}\n"
        f"  masses, kg (truth): {masses}\n  friction (truth): {frictions} ({true_frictions})"
    )
