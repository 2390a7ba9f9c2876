"""An estimator of your own in one fit of force and torque, on a recorded block without a simulator.

A sketch: it has no errors, and answers trials that say nothing. That of `docs/write_an_estimator.md` passes the kit.
"""

from dataclasses import dataclass

import numpy as np
from scipy.optimize import nnls

import heft
from estimators.testing.recorded import load_block
from estimators.wrench.model import ParticleModel


@dataclass(frozen=True)
class DragFit:
    """M shared out by the drag of the turns; `arm` [m] weighs torques against forces."""

    arm: float = 0.05

    def estimate(self, shape, weight, trajectories, seed):
        windows = heft.observe(shape, trajectories)
        if windows is None:
            return heft.Estimate(None, "no_data", "no usable trial")
        turns = windows.where(~windows.accelerated)
        of_particles = turns.drag_rows(ParticleModel.of(shape), 2e-4)
        scale = np.array([1, 1, 1 / self.arm])[:, None]
        rows = scale * of_particles.numpy() @ np.eye(shape.n_m)[shape.mass_group]
        drag, _ = nnls(rows.reshape(-1, shape.n_m), (scale[:, 0] * turns.wrench.numpy()).ravel())
        total = drag @ shape.particles_per_group
        return heft.Estimate(
            heft.MassDistribution(weight * drag / total, np.array([total / (weight * heft.GRAVITY)])), "ok"
        )


if __name__ == "__main__":
    block = load_block("L2-own_weight")
    answer = DragFit().estimate(block.model.shape, block.model.total_mass, block.trials("ft300s"), seed=0)
    nad = heft.normalized_absolute_difference(block.model.shape, answer.distribution, block.model.truth)
    print("masses, kg:", answer.group_mass(block.model.shape).round(3))
    print("in truth:  ", block.model.group_mass.round(3))
    print(f"NAD {100 * nad:.1f} %")
