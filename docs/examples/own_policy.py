"""A policy of your own: each turn about the grasp farthest from all before."""

from dataclasses import dataclass

import numpy as np

import heft


@dataclass(frozen=True)
class FarthestFirst:
    """One accelerated turn, then turns there and back, each about the grasp farthest from all before."""

    turns: int = 3
    duration: float = 18.0
    """Duration of a turn each way [s]."""
    grasps: tuple[int, ...] | None = None
    """Usable grasps; heft fills this in."""

    def next(self, shape, trajectories):
        usable = range(len(shape.grasps)) if self.grasps is None else self.grasps
        if not trajectories:
            return heft.Accelerate(usable[0])
        done = [
            shape.grasps[trial.action.grasp].position for trial in trajectories if isinstance(trial.action, heft.Rotate)
        ]
        if len(done) == min(self.turns, len(usable)):
            return None
        places = [shape.grasps[grasp].position for grasp in usable]
        gaps = [min((np.hypot(*(place - other)) for other in done), default=np.hypot(*place)) for place in places]
        grasp = usable[int(np.argmax(gaps))]
        beside = tuple(shape.grasps[grasp].position + shape.cell / 2)  # the centre of a turn lies between particles
        return heft.Rotate(grasp, duration=self.duration, pivot=beside, back=True)
