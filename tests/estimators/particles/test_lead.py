"""Friction that leads the motion: MuJoCo's feet drag against v + a / b."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from estimators.particles.observe import observe
from estimators.particles.setup_effects import LinearRows
from estimators.particles.wrench import AffineLoads, WrenchModel
from estimators.wrench.model import ModelErrors, ParticleModel
from estimators.wrench.support import own_weight_loads
from testbed.actions.accelerate import Accelerate
from testbed.objects.files import load_object
from testbed.sensing.noise import draw_sensing
from testbed.sensing.presets import preset
from testbed.simulation.runner import SimulationRunner
from testbed.simulation.settings import ContactSettings
from testbed.trial import Trial
from testbed.worlds.setup_errors import EXACT_SETUP

I2 = load_object("I2")


@pytest.fixture(scope="module")
def windows():
    records = [SimulationRunner().run_clean(Trial(I2, Accelerate(grasp))) for grasp in (0, 1, 4)]
    found = observe(I2.shape, [draw_sensing(record, preset("ideal"), 0) for record in records])
    assert found is not None
    return found


def missing(windows):
    """Planar forces that the true masses and frictions leave, N."""
    model = ParticleModel.of(I2.shape)
    loads = AffineLoads.of(I2.shape, model, windows, own_weight_loads)
    wrenches = WrenchModel.of(model, windows, loads, ModelErrors.pivot_error)
    truth = torch.tensor(I2.truth.mass), torch.tensor(I2.truth.friction)
    return (windows.wrench - wrenches.wrench(*truth))[:, :2]


def test_feet_lead_by_the_time_of_their_damping(windows):
    leads = np.arange(0.0, 0.041, 0.005)
    left = [float(missing(replace(windows, twists=windows.twists + t * windows.twist_rates)).norm()) for t in leads]
    assert leads[np.argmin(left)] == pytest.approx(1 / ContactSettings().friction_damping)
    assert min(left) < 0.5 * left[0]


def test_the_column_of_the_lead_is_what_it_leaves(windows):
    model, errors = ParticleModel.of(I2.shape), ModelErrors()
    loads = AffineLoads.of(I2.shape, model, windows, own_weight_loads)
    drag = model.particle_friction(torch.tensor(I2.truth.friction)) * loads.at(torch.tensor(I2.truth.mass))
    mass = model.particle_mass(torch.tensor(I2.truth.mass))
    rows = LinearRows.of(windows, windows.table(model, errors.pivot_error), mass, drag, errors.lead_error, EXACT_SETUP)
    column = rows.slopes["lead"][:, :2].flatten()
    left = missing(windows).flatten()
    size = float(column @ left / (column @ column))
    assert 0.5 < size < 1.5 and float((left - size * column).norm()) < 0.7 * float(left.norm())


def test_what_does_not_accelerate_has_no_lead(windows):
    still = replace(windows, twists=windows.twists.mean(1, keepdim=True).expand_as(windows.twists))
    model = ParticleModel.of(I2.shape)
    ones = torch.ones(len(model.particles), dtype=torch.float64)
    assert not LinearRows.of(still, still.table(model), ones, ones, 0.02, EXACT_SETUP).slopes["lead"].any()
