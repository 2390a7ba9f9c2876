"""Settings of the baselines in one place: the paper's where it gives them, ours where it is silent.

All search the masses and frictions that minimise Eq. problem on the same trials as Algorithm 1, with the same budget.
"""

from __future__ import annotations

ITERATIONS = 500
"""Gradient steps, or samples tried. Paper: 500 for every method."""
OPTIMIZERS = ("adam", "rmsprop", "plain")
"""Descents that are run; the lowest loss is reported. Paper: Adam, RMSProp and others, the best is picked."""
USE_WEIGHT = False
"""Whether M as weighed is given to a baseline. Paper: only its own method has it."""
LEARNING_RATE = 0.05
"""First step of Adam and RMSProp in log mass and log friction; it falls to zero as (1 - i / iterations)^2. Ours."""
FRICTION_RANGE = (0.05, 1.0)
"""Frictions that searches draw from, and descents start from: metal and wood on a table lie inside. Ours."""
LARGEST_SHARE = 2.0
"""Largest mass drawn, over the mean mass that explains the largest drag felt at the friction drawn. Ours."""
DENSEST = 7850.0
"""Without M none is drawn denser than steel, kg/m^3: Eq. problem divides by mass, and heavy guesses look good. Ours."""
GRID_PART = 0.25
"""Part of the samples of Weighted Sampling Search that go to its first grid. Ours."""
GENERATION = 15
"""Samples around the best one before the deviation falls. Ours."""
FIRST_DEVIATION = 0.5
"""First deviation of Weighted Sampling Search, as a part of the mean mass and of the friction. Ours."""
DEVIATION_DECAY = 0.85
"""Factor on the deviation after each generation. Ours; the paper finds the method sensitive to it."""
LCP_DIRECTIONS = 8
"""Corners of the friction polygon. Ours."""
LCP_SUBSTEPS = 2
"""Steps of the LCP engine in one of the record's. Paper: smaller than the record's, wrench interpolated linearly."""
LCP_SAMPLES = 1
"""States along a steady turn that Diff-LCP predicts from; a polygon feels each turned state differently. Ours."""
