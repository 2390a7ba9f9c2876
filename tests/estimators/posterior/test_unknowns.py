"""Tests of the unknowns: steps of the search in their own units."""

import math

import torch
from numpy.testing import assert_allclose

from estimators.posterior.unknowns import Block, Unknowns

STD = torch.tensor([0.8, 0.3, 0.0], dtype=torch.float64)
MASS = Block(torch.tensor([0.1, 0.02, 1.0], dtype=torch.float64).log(), STD, positive=True)
OFFSET = Block(torch.tensor([0.002], dtype=torch.float64), torch.tensor([0.001], dtype=torch.float64))
Z = torch.tensor([0.4, -1.2, 0.0, 0.7], dtype=torch.float64)


def test_steps_are_straight_in_the_parameters():
    unknowns = Unknowns({"mass": MASS, "offset": OFFSET})
    step = torch.tensor([-0.5, 1.5, 3.0, 2.0], dtype=torch.float64)
    scale = torch.cat([MASS.scale(Z[:3]), OFFSET.scale(Z[3:])])
    before, after = unknowns.values(Z), unknowns.values(unknowns.stepped(Z, step))
    assert_allclose(after["mass"] - before["mass"], (scale * step)[:3], rtol=1e-12)
    assert_allclose(after["offset"] - before["offset"], (scale * step)[3:], rtol=1e-12)


def test_positive_parameters_stay_positive_and_fall_as_their_logarithm_far_down():
    step = -torch.logspace(-2, 2.5, 400, dtype=torch.float64)
    long = Block(torch.zeros(400, dtype=torch.float64), torch.full((400,), 0.5, dtype=torch.float64), positive=True)
    moved = long.stepped(torch.zeros(400, dtype=torch.float64), step)
    assert (moved.diff() < 0).all() and torch.isfinite(moved).all()
    assert_allclose(0.5 * moved[-1], 0.5 * step[-1] - 0.5 - math.log(2), rtol=1e-12)
