"""Answers for people: sums, centers and intervals follow from the masses and their covariance."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from estimators.base import Estimate
from scenarios.views.answers import support_verdict
from testbed.objects.files import load_object
from testbed.objects.model import MassDistribution
from viz.report.answers import Answer, answer_fields, answer_rows, answer_table
from viz.report.mass_map import WIDEST, mass_map

WRENCH = load_object("wrench")
"""Its particles are filled unevenly."""
COUNT = WRENCH.shape.particles_per_group


def answer(covariance: np.ndarray | None, mass: np.ndarray = WRENCH.truth.mass) -> Answer:
    found = MassDistribution(mass, np.array([0.4]))
    return Answer("wrench", "own_weight", "m", "ok", "", WRENCH.shape, found, covariance, 1.2, "own weight", "")


def test_center_and_sum_have_the_errors_that_the_masses_give_them():
    rng = np.random.default_rng(0)
    root = 1e-3 * WRENCH.truth.mass * rng.standard_normal((len(COUNT), len(COUNT)))
    named = {q.name: q for q in answer(root @ root.T).quantities}
    particle_center = WRENCH.particle_mass @ WRENCH.shape.particles / WRENCH.particle_mass.sum()
    assert_allclose([named["center x"].value, named["center y"].value], particle_center, atol=1e-12)
    draws = WRENCH.truth.mass + rng.standard_normal((400, len(COUNT))) @ root.T
    each = [{q.name: q.value for q in answer(None, mass).quantities} for mass in draws]
    for name, quantity in named.items():
        assert_allclose(np.std([one[name] for one in each]), quantity.error, rtol=0.15, err_msg=name)


def test_what_is_not_known_is_said():
    none, open_ = answer(None), answer(np.diag([np.inf, *np.full(len(COUNT) - 1, 1e-9)]))
    cells = {labels[0]: [cell.text for cell in row] for labels, row in answer_table([none, open_]).rows}
    first, second = WRENCH.shape.group_names[:2]
    assert cells[first][1] == cells["total"][1] == cells["center x"][1] == "not observed"
    assert "[" not in cells[second][0]
    assert "[" in cells[second][1]
    fields = answer_fields(open_)["quantities"][first]
    assert (fields["low"], fields["high"]) == (None, None)
    rows = answer_rows([answer(np.eye(len(COUNT)))])
    assert min(row["low"] for row in rows if row["unit"] == "kg") == 0.0  # no mass is negative
    assert answer_rows([replace(none, distribution=None)]) == []


def test_the_map_shows_every_mass_in_its_place():
    block = load_object("L2")
    masses, count = block.truth.mass, block.shape.particles_per_group
    covariance = np.diag([np.inf, *np.full(len(count) - 1, 1e-9)])
    made = Answer("L2", "own_weight", "m", "ok", "", block.shape, block.truth, covariance, 1.0, "own weight", "")
    lines = mass_map(made).plain.splitlines()[1:]
    assert len(lines) == 12
    assert max(map(len, lines)) == 18
    for group in range(1, block.shape.n_m):
        assert sum(f"{masses[group] * count[group]:.3f}" in line for line in lines) >= 1
        assert sum(block.shape.group_names[group] in line for line in lines) == 1
    middle = lines[-2].split("0.100")  # A1, not observed, left of B1 and C1
    assert "?" in middle[0] and len(middle) == 3
    fine = replace(made, shape=load_object("L2", grid=30).shape, covariance=None)
    assert max(map(len, mass_map(fine).plain.splitlines())) <= WIDEST
    with pytest.raises(ValueError, match="without masses"):
        mass_map(replace(made, distribution=None))


@pytest.mark.parametrize(
    ("status", "bayes", "verdict", "evidence"),
    [
        ("ok", 5.0, "own weight", "every group rests on its own weight (Bayes factor 10^5.0"),
        ("underdetermined", 1.0, "undecided", "cannot be told apart"),
        ("assumption_violated", -9.0, "not own weight", "as under one rigid body"),
    ],
)
def test_the_support_is_named(status, bayes: float, verdict: str, evidence: str):
    numbers = {"rigid_share": 0.1, "rigid_share_error": 0.2}
    found = Estimate(None, status, "as under one rigid body", diagnostics=numbers | {"log10_bayes_factor": bayes})
    assert support_verdict(found)[0] == verdict
    assert evidence in support_verdict(found)[1]
    assert support_verdict(Estimate(None, "ok", assumes="own weight")) == ("assumed", "")
    assert support_verdict(Estimate(None, "ok")) == ("not tested", "")
