"""A rigid body on points of contact: its loads, what friction then shows, and what four points leave open."""

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
import trimesh
from numpy.testing import assert_allclose

from estimators.posterior.estimator import posterior_of
from estimators.support_models.estimator import SupportAware
from estimators.wrench.model import EXACT, ParticleModel, inertia_of
from estimators.wrench.support import GripperLoad, contact_spread, rigid_loads
from testbed.actions.accelerate import Accelerate
from testbed.actions.rotate import Rotate
from testbed.objects.conversion.convert import convert_mesh
from testbed.objects.files import load_object
from testbed.objects.grasps import GraspPlace
from testbed.objects.meshes import Part, mesh_object
from testbed.objects.model import GRAVITY, ObjectModel
from testbed.simulation.runner import SimulationRunner
from testbed.simulation.scene import build_scene
from testbed.simulation.settings import SimulationSettings
from testbed.trajectory import Trajectory
from testbed.trial import OWN_WEIGHT, Trial, support_of
from testbed.trial import RIGID as RIGID_SUPPORT
from testbed.worlds.setup_errors import SetupErrors
from tests.helpers.answers import ask, found, holds, trials_of

TOOLS = Path(os.environ.get("HEFT_TOOLS", Path(__file__).parents[4] / "shared" / "tools"))
THREE = ((0.01, 0.005), (0.02, 0.055), (0.19, 0.03))
FOUR = ((0.01, 0.005), (0.02, 0.055), (0.19, 0.02), (0.19, 0.04))
MASSES = (0.7, 0.05, 0.3, 0.1, 0.2)


def tool(contacts: tuple[tuple[float, float], ...], masses: tuple[float, ...] = MASSES) -> ObjectModel:
    """A head on the table and a handle in the air, in five parts; it is its cells, as the estimators have it."""
    lengths, parts, x = (0.06, 0.02, 0.04, 0.04, 0.04), [], 0.0
    for index, (length, mass) in enumerate(zip(lengths, masses, strict=True)):
        width, low, high = (0.06, 0.0, 0.03) if index == 0 else (0.03, 0.005, 0.025)
        mesh = trimesh.creation.box((length, width, high - low))
        mesh.apply_translation((x + length / 2, 0.032 if index == 3 else 0.03, (low + high) / 2))
        parts.append(Part(f"p{index}", mesh, mass, 0))
        x += length
    places = [GraspPlace(f"g{x}", (x, 0.03), np.pi / 2) for x in (0.1, 0.14, 0.18)]
    made = mesh_object("tool", parts, places, friction=[0.4], cell=0.01, grid=3, contacts=contacts)
    return replace(made, solids=())


def felt(obj: ObjectModel) -> list[Trajectory]:
    return trials_of(obj, rigid=True)


def test_three_points_show_all_that_can_be_known():
    obj = tool(THREE)
    near = posterior_of(obj.shape, obj.total_mass, felt(obj), "rigid")
    known = posterior_of(obj.shape, obj.total_mass, felt(obj), "rigid", errors=EXACT, near=near)
    assert known is not None
    rows, values = known.mass_equations()
    assert len(rows) == 4 < obj.shape.n_m  # M, c and I_cm
    model, some = ParticleModel.of(obj.shape), np.linalg.lstsq(rows, values)[0]
    shown = inertia_of(model, model.particle_mass(torch.tensor(some)))
    assert_allclose(known.of("friction")[0], 0.4, rtol=1e-6)
    assert_allclose(shown.mass, obj.total_mass, rtol=1e-6)
    assert_allclose(shown.com, obj.center_of_mass, atol=1e-6)
    assert_allclose(shown.about_com, obj.inertia_cm, rtol=1e-6)
    answer = ask(obj, felt(obj), SupportAware())
    assert answer.status == "underdetermined" and answer.distribution is not None
    assert answer.message.startswith("M, c and I_cm hold the masses to")
    assert holds(answer, MASSES)


@pytest.mark.slow
def test_a_center_of_mass_that_no_parts_can_have_is_told():
    """Parts a third as long about the head have no masses with the center of mass that is felt."""
    obj = tool(THREE)
    shape = obj.shape
    left = shape.particles[:, 0].min()
    shrunk = shape.particles.copy()
    shrunk[~shape.is_contact, 0] = left + (shrunk[~shape.is_contact, 0] - left) / 3
    answer = SupportAware().estimate(replace(shape, particles=shrunk), obj.total_mass, felt(obj), 0)
    assert answer.status == "unexplained" and answer.message.startswith("no masses of the parts have the M, c and I_cm")
    assert answer.diagnostics["polytope_miss"] > 3


@pytest.mark.slow
def test_parts_in_the_air_have_no_pattern_of_contact():
    obj = tool(())
    stated = [replace(trial, setup=SetupErrors(contact_points=4)) for trial in felt(obj)]
    assert np.isfinite(found(ask(obj, stated, SupportAware())).mass).all()


def test_algorithm_1_stands_back_from_one_body():
    obj = tool(THREE)
    assert not ParticleModel.of(obj.shape).stands_in_groups and not obj.shape.stands_in_groups
    assert support_of(obj.shape) == RIGID_SUPPORT and support_of(obj.shape, "own_weight") == OWN_WEIGHT
    assert support_of(load_object("L2").shape) == OWN_WEIGHT
    answer = ask(obj, felt(obj))
    assert answer.status == "assumption_violated" and "support_aware" in answer.message
    assert ask(obj, [], SupportAware()).status == "no_data"


def test_loads_of_three_points_are_in_balance_and_those_of_four_lie_about_the_even_ones():
    for contacts, free in ((THREE, 0), (FOUR, 1)):
        obj = tool(contacts)
        model, mass = ParticleModel.of(obj.shape), torch.tensor(obj.particle_mass)
        loads = rigid_loads(model, mass, GripperLoad.none(model))[0]
        assert set(torch.nonzero(loads).flatten().tolist()) <= set(np.flatnonzero(obj.shape.is_contact))
        assert_allclose(loads.sum(), obj.total_mass * GRAVITY)
        assert_allclose(loads @ model.particles / loads.sum(), obj.center_of_mass, atol=1e-12)
        spread = contact_spread(model, mass)
        assert np.linalg.matrix_rank(spread.numpy()) == free if free else spread.shape[1] == 0
        assert_allclose(spread.sum(0), 0, atol=1e-12)
        assert_allclose(model.particles.T @ spread, 0, atol=1e-12)


@pytest.mark.slow
def test_a_body_said_to_rest_on_four_points_may_rest_on_three_of_them():
    rests, said = tool(FOUR[:3]), tool(FOUR)
    trials = felt(rests)
    answer = ask(said, trials, SupportAware())
    assert answer.status == "underdetermined" and holds(answer, MASSES)
    known = posterior_of(said.shape, said.total_mass, trials, "rigid")
    assert known is not None and known.explained.explains


def test_in_simulation_it_stands_on_these_points():
    obj = tool(THREE)
    scene = build_scene(obj, RIGID_SUPPORT, None, SimulationSettings())
    assert_allclose(scene.feet.position, obj.shape.particles[obj.shape.is_contact])
    with pytest.raises(ValueError, match="rigid, since p1"):
        build_scene(obj, OWN_WEIGHT, None, SimulationSettings())


@pytest.mark.slow
@pytest.mark.skipif(not TOOLS.is_dir(), reason="no folder of real tools: HEFT_TOOLS names one")
@pytest.mark.parametrize("name", ["Clamp", "Hammer", "Screwdriver"])
def test_real_tools_show_their_center_of_mass(name: str):
    made = convert_mesh(TOOLS / name / "mesh.ply", most_grasps=2)
    obj = made.model((0.3,))
    with SimulationRunner() as simulation:
        trials = [
            simulation.run(Trial(obj, action, RIGID_SUPPORT))
            for grasp in range(len(obj.shape.grasps))
            for action in (Rotate(grasp, duration=4.0, back=True), Accelerate(grasp))
        ]
    assert all(trial.ok for trial in trials)
    answer = ask(obj, trials, SupportAware())
    assert answer.hidden is not None
    assert_allclose(answer.hidden.center_of_mass, obj.center_of_mass, atol=5e-4)
    assert_allclose(found(answer).friction, 0.5, rtol=0.01)
