"""Trials of an object in the analytic lab, and shapes with renumbered groups."""

from dataclasses import replace

import numpy as np

from estimators.learned.examples import RATES
from estimators.testing.analytic_lab import LAB, Draw, contacts, flawed_trial
from testbed import ObjectShape, Rotate

SEED = 7


def lab_trials(obj, count=4, seed=3, pattern="corners"):
    rng = np.random.default_rng(seed)
    feet, draw = contacts(obj, pattern, LAB, rng), Draw.of(LAB, rng)
    pivots = rng.uniform(-0.05, 0.05, (count, 2))
    actions = [Rotate(k % len(obj.shape.grasps), duration=4.0, pivot=tuple(p), back=True) for k, p in enumerate(pivots)]
    return [replace(flawed_trial(obj, a, feet, draw, rng, RATES[0]), setup=LAB) for a in actions]


def renamed(shape, order):
    """Shape with renumbered groups: the new group g is the old group order[g]."""
    place = np.argsort(order)
    values = {
        name: getattr(shape, name) for name in ("particles", "friction_group", "cell", "height", "grasps", "fill")
    }
    return ObjectShape(mass_group=place[shape.mass_group], **values)
