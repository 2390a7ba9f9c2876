"""Exported estimates: the same body everywhere, and in heft's own bench the wrench of the estimate."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import partial
from pathlib import Path
from xml.etree import ElementTree

import mujoco
import numpy as np
import pytest
import trimesh
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from estimators.particles.wrench import predicted_wrenches
from estimators.testing.analytic_world import drawn_object, turns
from scenarios.cli.main import main
from scenarios.results.trials import keys_of, kind_of_trial, read_trial
from testbed.actions.rotate import Rotate
from testbed.errors import InvalidValueError
from testbed.objects.export import (
    AIR,
    Exported,
    RigidBody,
    boxes_of,
    to_mjcf,
    to_object_file,
    to_sdf,
    to_sidecar,
    to_urdf,
)
from testbed.objects.files import load_object
from testbed.objects.meshes import Part, mesh_object
from testbed.objects.model import GRAVITY, MassDistribution, ObjectModel
from testbed.sensing.windows import steady_samples, wrench_in_object
from testbed.simulation.runner import SimulationRunner
from testbed.trial import Trial

FREE = '<link name="world"/><joint name="free" type="floating"><parent link="world"/><child link="{}"/></joint></robot>'
"""A URDF's root is part of MuJoCo's world unless it floats in it."""


def exported(model: ObjectModel) -> Exported:
    covariance = np.diag(np.arange(1.0, model.shape.n_m + 1) * 1e-6)
    return Exported(model.name, model.shape, model.truth, covariance, ("by hand -- for a test",))


def two_frictions(model: ObjectModel) -> ObjectModel:
    """L2 with another friction to the right, so that one block has both."""
    groups = np.where(model.shape.particles[:, 0] < 0.02, 0, 1)
    truth = replace(model.truth, friction=np.array([0.3, 0.6]))
    return replace(model, shape=replace(model.shape, friction_group=groups), truth=truth, solids=())


def on_points() -> ObjectModel:
    """A plate with a thick end, on three points of contact."""
    parts = [
        Part("end", trimesh.creation.box((0.05, 0.08, 0.03)).apply_translation((-0.06, 0, 0.015)), 0.4, 0),
        Part("plate", trimesh.creation.box((0.12, 0.03, 0.02)).apply_translation((0.025, 0, 0.015)), 0.1, 0),
    ]
    points = [(-0.07, -0.03), (-0.07, 0.03), (0.07, 0.0)]
    return mesh_object("plate", parts, [], friction=[0.4], cell=0.01, grid=3, contacts=points)


MODELS = {
    "drawn": drawn_object(0),
    "another": drawn_object(1, friction_groups=2),
    "hammer": load_object("hammer"),
    "cut": two_frictions(load_object("I2")),
    "on points": on_points(),
}


def body_of(text: str, name: str) -> RigidBody:
    """Model that MuJoCo makes of it."""
    model = mujoco.MjSpec.from_string(text.replace("</robot>", FREE.format(name))).compile()
    body = model.body(name)
    turn = Rotation.from_quat(body.iquat, scalar_first=True).as_matrix()
    return RigidBody(float(body.mass[0]), body.ipos, turn @ np.diag(body.inertia) @ turn.T)


def by_pinocchio(text: str, name: str) -> RigidBody:
    pinocchio = pytest.importorskip("pinocchio", reason="needs the extra simulators")
    found = pinocchio.buildModelFromXML(text, pinocchio.JointModelFreeFlyer()).inertias[1]
    return RigidBody(found.mass, found.lever, found.inertia)


def by_drake(text: str, name: str, ending: str) -> RigidBody:
    plants = pytest.importorskip("pydrake.multibody.plant", reason="needs the extra simulators")
    parsing = pytest.importorskip("pydrake.multibody.parsing")
    plant = plants.MultibodyPlant(0.0)
    (model,) = parsing.Parser(plant).AddModelsFromString(text, ending)
    plant.Finalize()
    assert plant.num_positions() == 7  # one body, free
    whole = plant.CalcSpatialInertia(plant.CreateDefaultContext(), plant.world_frame(), plant.GetBodyIndices(model))
    centre = whole.get_com()
    return RigidBody(whole.get_mass(), centre, whole.Shift(centre).CalcRotationalInertia().CopyToFullMatrix3())


def by_hand(text: str, name: str) -> RigidBody:
    """Links of an SDF, which MuJoCo and Pinocchio do not read."""
    links = ElementTree.fromstring(text).findall("model/link")
    numbers = [
        {part.tag: [float(v) for v in str(part.text).split()] for part in link.iterfind("inertial//*")}
        for link in links
    ]
    bodies = []
    for said in numbers:
        six = [said[f"i{axes}"][0] for axes in ("xx", "yy", "zz", "xy", "xz", "yz")]
        inertia = np.array([[six[0], six[3], six[4]], [six[3], six[1], six[5]], [six[4], six[5], six[2]]])
        bodies.append(RigidBody(said["mass"][0], np.array(said["pose"][:3]), inertia))
    return joined(bodies)


def joined(bodies: list[RigidBody]) -> RigidBody:
    """One body of several, by their pseudo-inertias, which add up."""
    total = np.sum([body.pseudo_inertia for body in bodies], axis=0)
    centre, second = total[:3, 3] / total[3, 3], total[:3, :3]
    about_origin = np.trace(second) * np.eye(3) - second
    shift = total[3, 3] * (centre @ centre * np.eye(3) - np.outer(centre, centre))
    return RigidBody(total[3, 3], centre, about_origin - shift)


READERS = {
    "mjcf": (to_mjcf, body_of),
    "urdf": (to_urdf, body_of),
    "sdf": (to_sdf, by_hand),
    "urdf in Pinocchio": (to_urdf, by_pinocchio),
    "mjcf in Drake": (to_mjcf, partial(by_drake, ending="xml")),
    "urdf in Drake": (to_urdf, partial(by_drake, ending="urdf")),
    "sdf in Drake": (to_sdf, partial(by_drake, ending="sdf")),
}


@pytest.mark.parametrize("inertial", [False, True], ids=["blocks", "inertial"])
@pytest.mark.parametrize("read", READERS)
@pytest.mark.parametrize("model", MODELS.values(), ids=MODELS)
def test_mass_centre_and_inertia_come_back(model, read, inertial):
    given, (write, load) = exported(model), READERS[read]
    whole, back = RigidBody.of(given.boxes), load(write(given, inertial=inertial), model.name)
    assert_allclose(back.mass, whole.mass, rtol=1e-9)
    assert_allclose(back.center, whole.center, atol=1e-9)
    assert_allclose(back.inertia, whole.inertia, atol=1e-9 * np.trace(whole.inertia))
    assert (np.linalg.eigvalsh(back.pseudo_inertia) > 0).all()


def test_sdf_has_the_friction_of_every_box_on_the_table():
    given = exported(MODELS["hammer"])
    root = ElementTree.fromstring(to_sdf(given))
    said = {str(part.get("name")): part.findtext(".//ode/mu") for part in root.iter("collision")}
    assert said == {f"{b.name}_collision": None if b.friction is None else repr(b.friction) for b in given.boxes}
    assert None in said.values()
    assert len(set(said.values())) == 1 + given.shape.n_mu


@pytest.mark.parametrize("model", MODELS.values(), ids=MODELS)
def test_boxes_are_the_particles(model):
    bare = replace(model, solids=())  # an estimate is of particles
    whole = RigidBody.of(boxes_of(model.shape, model.truth))
    assert_allclose(whole.mass, bare.total_mass)
    assert_allclose(whole.center[:2], bare.center_of_mass, atol=1e-12)
    assert_allclose(whole.center[2], bare.shape.height / 2, atol=AIR / 2)  # what does not touch ends above the table
    assert_allclose(whole.inertia[2, 2], bare.inertia_cm)


@pytest.mark.parametrize("write", [to_mjcf, to_urdf])
@pytest.mark.parametrize("model", [MODELS["hammer"], MODELS["on points"]], ids=["hammer", "on points"])
def test_what_is_dropped_comes_to_rest_on_what_touches(model, write):
    spec = mujoco.MjSpec.from_string(write(exported(model)).replace("</robot>", FREE.format(model.name)))
    spec.worldbody.add_geom(name="table", type=mujoco.mjtGeom.mjGEOM_PLANE, size=(1, 1, 0.1))
    for geom in spec.body(model.name).geoms:
        geom.contype = 2  # boxes that abut are one body: they do not meet
    compiled = spec.compile()
    data = mujoco.MjData(compiled)
    data.qpos[2] = 0.004
    mujoco.mj_step(compiled, data, 1500)
    assert np.abs(data.qvel).max() < 1e-3
    assert abs(data.qpos[2]) < 5e-4 and 2 * np.linalg.norm(data.qpos[4:6]) < 0.01
    touching = {compiled.geom(pair).name.removesuffix("_collision") for c in data.contact for pair in c.geom} - {
        "table"
    }
    boxes = {box.name: box.friction is not None for box in boxes_of(model.shape, model.truth)}
    assert touching and all(boxes[name] for name in touching)
    weight = sum(_upward(compiled, data, index) for index in range(data.ncon))
    assert_allclose(weight, model.total_mass * GRAVITY, rtol=0.01)


def _upward(model: mujoco.MjModel, data: mujoco.MjData, index: int) -> float:
    """Force of the table in a contact, N."""
    force = np.zeros(6)
    mujoco.mj_contactForce(model, data, index, force)
    return float(force[0])


def test_an_object_file_is_the_object():
    for name in ("drawn", "another"):
        model = MODELS[name]
        wrenches = []
        for obj in (model, load(to_object_file(exported(model)))):
            wrenches.append([t.wrench_on_object_world for t in turns(obj)])
        for mine, theirs in zip(*wrenches, strict=True):
            assert_allclose(theirs, mine, atol=1e-9)
    for name in ("hammer", "cut"):
        with pytest.raises(InvalidValueError, match="square blocks"):
            to_object_file(exported(MODELS[name]))


def load(text: str) -> ObjectModel:
    path = Path("exported.toml")
    path.write_text(text, encoding="utf-8")
    return load_object(path)


@pytest.fixture(autouse=True)
def _in_a_folder_of_its_own(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


def test_what_is_not_observed_is_null_in_the_sidecar_and_said_in_comments():
    model = MODELS["drawn"]
    covariance = np.diag(np.full(model.shape.n_m, 1e-6))
    covariance[0, 0] = np.inf
    given = replace(exported(model), covariance=covariance)
    said = json.loads(to_sidecar(given))
    assert said["mass_std_kg"][0] is None
    assert said["mass_std_kg"][1:] == pytest.approx([9e-3] * (model.shape.n_m - 1))
    assert said["mass_covariance_kg2"][0][0] is None
    assert_allclose(said["inertia_about_center_kg_m2"], RigidBody.of(given.boxes).inertia)
    assert "A3: " in to_mjcf(given) or "+- inf" in to_mjcf(given)
    assert "by hand - - for a test" in to_urdf(given)


@pytest.mark.slow
def test_an_exported_estimate_dragged_in_heft_gives_the_wrench_of_the_estimate(tmp_path):
    (tmp_path / "s.toml").write_text(
        'objects = ["bar.toml"]\n[policy]\npivots = 3\nduration = 3.0\naccelerated = 2\nheld_out = 0\n',
        encoding="utf-8",
    )
    (tmp_path / "bar.toml").write_text(
        'name = "bar"\n[blocks]\nlayout = ["10", "11"]\nmass_kg = [0.3, 0.1, 0.2]\nfriction = 0.4\n', encoding="utf-8"
    )
    main(["run", "s.toml", "--out", "out", "--workers", "0"])
    (key,) = [path.name for path in (tmp_path / "out/estimates").iterdir()]
    for kind in ("mjcf", "urdf", "sdf", "toml"):
        main(["export", "out", key[:6], "--format", kind, "--out", f"answer.{kind}"])
    answer = load_object("answer.toml")
    body = body_of(Path("answer.mjcf").read_text(encoding="utf-8"), "bar")
    assert_allclose([body.mass, *body.center[:2]], [answer.total_mass, *answer.center_of_mass], atol=1e-9)
    even = MassDistribution(np.full(3, answer.total_mass / len(answer.shape.particles)), answer.truth.friction)
    drag = answer.truth.friction[0] * answer.total_mass * GRAVITY
    with SimulationRunner() as bench:
        for grasp in range(2):
            turn = bench.run(Trial(answer, Rotate(grasp, duration=3.0, back=True)))
            felt = wrench_in_object(turn)[:, [0, 1, 5]]
            off = []
            for masses in (answer.truth, even):
                (predicted,) = predicted_wrenches(answer.shape, masses, [turn])
                missed = [(predicted - felt)[kept].mean(axis=0) for kept in steady_samples(turn)]
                off.append(np.abs(missed / (drag * np.array([1, 1, 0.05]))).max())
            assert off[0] < 0.02
            assert off[1] > 5 * off[0]
    main(["export", "out", key[:6], "--draws", "40", "--models", "--out", "drawn.xml"])
    draws = np.loadtxt("drawn.draws.csv", delimiter=",", skiprows=1)
    assert draws.shape == (40, 4)
    assert_allclose(draws.mean(axis=0), [*answer.group_mass, *answer.truth.friction], atol=2 * draws.std(axis=0).max())
    models = [body_of(path.read_text(encoding="utf-8"), "bar") for path in sorted(Path("drawn.draws").iterdir())]
    assert_allclose([body.mass for body in models], draws[:, :3].sum(axis=1), atol=1e-6)
    main(["export", "out", key[:6], "--draws", "3", "--models", "--format", "sdf", "--out", "drawn.sdf"])
    drawn = [by_hand(path.read_text(encoding="utf-8"), "bar") for path in sorted(Path("drawn.draws").glob("*.sdf"))]
    assert len(drawn) == 3
    assert all(np.linalg.eigvalsh(body.pseudo_inertia).min() > 0 for body in drawn)
    pytest.importorskip("rosbags", reason="needs the extra robot")
    moved = [t for t in keys_of(Path("out")) if kind_of_trial(Path("out"), t) in ("rotate", "accelerate")]
    for trial in moved:
        main(["export", "out", trial, "--format", "mcap"])
    assert load_object(Path("out/exports/bar.toml")).group_mass == pytest.approx([0.3, 0.1, 0.2])
    mapping = f"out/exports/bar_{moved[0][:8]}.toml"
    main(["import", mapping, "--weight", "0.6", "--out", "lab"])
    kept, back = (read_trial(Path(d), t).trajectory for d, t in (("out", moved[0]), ("lab", turn_of("lab"))))
    assert np.array_equal(back.sensor_wrench, kept.sensor_wrench)
    with pytest.raises(SystemExit, match="2"):
        main(["export", "out", moved[0], "--format", "mcap", "--draws", "3"])
    with pytest.raises(SystemExit, match="2"):
        main(["export", "out", key[:6], "--models", "--out", "drawn.xml"])
    with pytest.raises(SystemExit, match="2"):
        main(["export", "out", key[:6], "--draws", "0", "--out", "drawn.xml"])


def turn_of(folder: str) -> str:
    (key,) = [key for key in keys_of(Path(folder)) if kind_of_trial(Path(folder), key) != "weigh"]
    return key
