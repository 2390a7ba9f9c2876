"""Exported estimates: the same body everywhere, and in heft's own bench the wrench of the estimate."""

import json
from collections.abc import Sequence
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

import scenarios
from estimators.inertial.body import InertialParameters
from estimators.particles.wrench import predicted_wrenches
from estimators.testing.analytic_world import drawn_object, turns
from scenarios.cli.main import main
from scenarios.results.estimates import load_estimate, load_rows
from scenarios.results.trials import keys_of, kind_of_trial, read_trial
from testbed import InvalidValueError, Rotate, SimulationRunner, Trial, load_object
from testbed.objects.blocks import parse_layout
from testbed.objects.bodies import AIR, RigidBody, boxes_of
from testbed.objects.chain import Chain
from testbed.objects.export import Exported, to_mjcf, to_object_file, to_sdf, to_sidecar, to_urdf
from testbed.objects.export import written as export_text
from testbed.objects.meshes import Part, mesh_object
from testbed.objects.model import GRAVITY, MassDistribution, ObjectModel
from testbed.sensing.windows import steady_samples, wrench_in_object
from tests.fakes.analytic_links import drawn_chain
from tests.helpers.blocks import blocks
from tests.helpers.commands import ended

FREE = '<link name="world"/><joint name="free" type="floating"><parent link="world"/><child link="{}"/></joint></robot>'
"""A URDF's root is part of MuJoCo's world unless it floats in it."""


def exported(model: ObjectModel) -> Exported:
    covariance = np.diag(np.arange(1.0, model.shape.n_m + 1) * 1e-6)
    notes, torques = ("by hand -- for a test",), model.hinge_friction
    return Exported(model.name, model.shape, model.truth, covariance, notes, torques)


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


@pytest.mark.parametrize("name", ["L2", "hammer", "on_points"])
def test_in_a_scene_it_rests_on_the_floor(name):
    obj = on_points() if name == "on_points" else load_object(name)
    model = mujoco.MjModel.from_xml_string(to_mjcf(exported(obj), scene=True))
    data = mujoco.MjData(model)
    assert model.nlight == 1
    while data.time < 1.0:
        mujoco.mj_step(model, data)
    assert np.abs(data.qpos - [0, 0, 0, 1, 0, 0, 0]).max() < 2e-3 and np.abs(data.qvel).max() < 1e-2
    assert_allclose(data.qfrc_constraint[2], obj.total_mass * GRAVITY, rtol=0.01)
    assert {float(contact.friction[0]) for contact in data.contact} == set(obj.truth.friction.tolist())
    touching = {model.geom(geom).name for contact in data.contact for geom in contact.geom} - {"floor"}
    assert touching <= {box.name for box in boxes_of(obj.shape, obj.truth) if box.friction is not None}


@pytest.mark.parametrize("layout", [["010", "011"], ["110", "011", "000"]])
def test_blocks_keep_their_names_beside_empty_columns_and_rows(layout):
    cells = parse_layout(layout)
    given = blocks(layout, [0.1 * (k + 1) for k in range(len(cells))])
    back = load(to_object_file(exported(given)))
    assert dict(zip(back.shape.group_names, back.group_mass, strict=True)) == pytest.approx(
        dict(zip(given.shape.group_names, given.group_mass, strict=True))
    )


def folding() -> ObjectModel:
    """The plate with its thick end on a hinge."""
    rigid = on_points()
    chain = Chain(np.array([0, 1]), np.array([[-0.035, 0.01]]))
    shape = replace(rigid.shape, chain=chain)
    return replace(rigid, name="folding", shape=shape, hinge_friction=(0.02,))


MODELS = {
    "drawn": drawn_object(0),
    "another": drawn_object(1, friction_groups=2),
    "hammer": load_object("hammer"),
    "cut": two_frictions(load_object("I2")),
    "on points": on_points(),
}
LIBRARY = Path(scenarios.__file__).parent / "library" / "objects"
LINKS = {name: load_object(LIBRARY / f"{name}.toml") for name in ("fold_2", "elbow", "fold_3")} | {"folding": folding()}
BLOCKS = [model for model in LINKS.values() if not model.solids]
CASES = {name: (model, 0.0) for name, model in (MODELS | LINKS).items()}
CASES |= {f"{name}, turned": (model, 0.5) for name, model in LINKS.items()}


def bodies_of(text: str, names: list[str], angles: Sequence[float]) -> list[RigidBody]:
    """Bodies that MuJoCo makes of the links, object frame, with the hinges turned [rad]."""
    model = mujoco.MjSpec.from_string(text.replace("</robot>", FREE.format(names[0]))).compile()
    data = mujoco.MjData(model)
    assert model.nq == 7 + len(angles)
    data.qpos[7:] = angles
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    bodies = []
    for name in names:
        turn = data.body(name).ximat.reshape(3, 3)
        inertia = turn @ np.diag(model.body(name).inertia) @ turn.T
        bodies.append(RigidBody(float(model.body(name).mass[0]), data.body(name).xipos.copy(), inertia))
    return bodies


def body_of(text: str, name: str) -> RigidBody:
    """Body that MuJoCo makes of a rigid object."""
    return bodies_of(text, [name], [])[0]


def by_pinocchio(text: str, names: list[str], angles: Sequence[float]) -> list[RigidBody]:
    pinocchio = pytest.importorskip("pinocchio", reason="needs the extra simulators")
    model = pinocchio.buildModelFromXML(text, pinocchio.JointModelFreeFlyer())
    assert list(model.names)[2:] == [f"hinge_{index}" for index in range(len(angles))]
    turns = [part for angle in angles for part in (np.cos(angle), np.sin(angle))]  # a continuous joint's coordinates
    data = model.createData()
    pinocchio.forwardKinematics(model, data, np.array([0, 0, 0, 0, 0, 0, 1, *turns], dtype=float))
    found = [data.oMi[joint].act(model.inertias[joint]) for joint in range(1, 1 + len(names))]
    return [RigidBody(body.mass, body.lever, body.inertia) for body in found]


def by_drake(text: str, names: list[str], angles: Sequence[float], ending: str) -> list[RigidBody]:
    plants = pytest.importorskip("pydrake.multibody.plant", reason="needs the extra simulators")
    parsing = pytest.importorskip("pydrake.multibody.parsing")
    plant = plants.MultibodyPlant(0.0)
    (model,) = parsing.Parser(plant).AddModelsFromString(text, ending)
    plant.Finalize()
    assert plant.num_positions() == 7 + len(angles)  # one body, free, and the hinges
    context, every = plant.CreateDefaultContext(), plant.GetBodyIndices(model)
    for index, angle in enumerate(angles):
        plant.GetJointByName(f"hinge_{index}").set_angle(context, angle)
    links = [[plant.GetBodyByName(name).index()] for name in names] if angles else [every]
    bodies = []
    for link in links:
        whole = plant.CalcSpatialInertia(context, plant.world_frame(), link)
        center = whole.get_com()
        inertia = whole.Shift(center).CalcRotationalInertia().CopyToFullMatrix3()
        bodies.append(RigidBody(whole.get_mass(), center, inertia))
    return bodies


def by_hand(text: str, names: list[str], angles: Sequence[float]) -> list[RigidBody]:
    """Links of an SDF, which MuJoCo and Pinocchio do not read."""
    if any(angles):
        pytest.skip("a reader of files, not a simulator")
    bodies = {}
    for link in ElementTree.fromstring(text).findall("model/link"):
        said = {part.tag: [float(v) for v in str(part.text).split()] for part in link.iterfind("inertial//*")}
        origin = np.array([float(v) for v in link.findtext("pose", "0 0 0").split()[:3]])
        six = [said[f"i{axes}"][0] for axes in ("xx", "yy", "zz", "xy", "xz", "yz")]
        inertia = np.array([[six[0], six[3], six[4]], [six[3], six[1], six[5]], [six[4], six[5], six[2]]])
        bodies[link.get("name")] = RigidBody(said["mass"][0], origin + said["pose"][:3], inertia)
    return [bodies[name] for name in names] if angles else [joined(list(bodies.values()))]


def parameters(body: RigidBody) -> InertialParameters:
    return InertialParameters(body.mass, body.center, body.inertia)


def joined(bodies: list[RigidBody]) -> RigidBody:
    """One body of several, by their inertial parameters, which add up."""
    whole = InertialParameters.of_vector(np.sum([parameters(body).vector for body in bodies], axis=0))
    return RigidBody(whole.mass, whole.center_of_mass, whole.inertia)


READERS = {
    "mjcf": (to_mjcf, bodies_of),
    "urdf": (to_urdf, bodies_of),
    "sdf": (to_sdf, by_hand),
    "urdf in Pinocchio": (to_urdf, by_pinocchio),
    "mjcf in Drake": (to_mjcf, partial(by_drake, ending="xml")),
    "urdf in Drake": (to_urdf, partial(by_drake, ending="urdf")),
    "sdf in Drake": (to_sdf, partial(by_drake, ending="sdf")),
}


def turned_links(given: Exported, angles: Sequence[float]) -> list[RigidBody]:
    """Bodies of the links, object frame, with each hinge turned against the link before [rad]."""
    bodies: list[RigidBody] = []
    turn, place, origin = np.eye(3), np.zeros(3), np.zeros(3)
    for link, angle in zip(given.links, [0.0, *angles], strict=True):
        place = place + turn @ (link.origin - origin)
        turn, origin = turn @ Rotation.from_euler("z", angle).as_matrix(), link.origin
        body = link.body
        bodies.append(RigidBody(body.mass, place + turn @ body.center, turn @ body.inertia @ turn.T))
    return bodies


@pytest.mark.parametrize("inertial", [False, True], ids=["blocks", "inertial"])
@pytest.mark.parametrize("read", READERS)
@pytest.mark.parametrize(("model", "angle"), CASES.values(), ids=CASES)
def test_mass_center_and_inertia_come_back(model, angle, read, inertial):
    given, (write, load) = exported(model), READERS[read]
    angles = [angle, -0.3 * angle][: len(model.hinge_friction)]
    read_back = load(write(given, inertial=inertial), [link.name for link in given.links], angles)
    whole = RigidBody.of(given.boxes)
    assert_allclose(sum(body.mass for body in read_back), whole.mass, rtol=1e-9)
    for back, link in zip(read_back, turned_links(given, angles), strict=True):
        assert_allclose(back.mass, link.mass, rtol=1e-9)
        assert_allclose(back.center, link.center, atol=1e-9)
        assert_allclose(back.inertia, link.inertia, atol=1e-9 * np.trace(whole.inertia))
        assert parameters(back).consistent


def test_sdf_has_the_friction_of_every_box_on_the_table():
    given = exported(MODELS["hammer"])
    root = ElementTree.fromstring(to_sdf(given))
    said = {str(part.get("name")): part.findtext(".//ode/mu") for part in root.iter("collision")}
    assert said == {f"{b.name}_collision": None if b.friction is None else repr(b.friction) for b in given.boxes}
    assert None in said.values()
    assert len(set(said.values())) == 1 + given.shape.n_mu


@pytest.mark.parametrize("model", (MODELS | LINKS).values(), ids=MODELS | LINKS)
def test_boxes_are_the_particles(model):
    shape = model.shape
    bodies = turned_links(exported(model), [0.0] * len(model.hinge_friction))
    link = np.zeros(shape.n_m, dtype=int) if shape.chain is None else shape.chain.link
    for index, body in enumerate(bodies):  # an estimate is of particles, not of solids
        inside = link[shape.mass_group] == index
        mass, at = model.particle_mass[inside], shape.particles[inside]
        center = mass @ at / mass.sum()
        assert_allclose(body.mass, mass.sum())
        assert_allclose(body.center[:2], center, atol=1e-12)
        assert_allclose(body.center[2], shape.height / 2, atol=AIR / 2)  # what does not touch ends above the table
        assert_allclose(body.inertia[2, 2], mass @ (((at - center) ** 2).sum(axis=1) + shape.cell**2 / 6))
    whole = joined(bodies)
    assert_allclose(whole.mass, replace(model, solids=()).total_mass)
    assert_allclose(whole.inertia[2, 2], replace(model, solids=()).inertia_cm)


@pytest.mark.parametrize("model", LINKS.values(), ids=LINKS)
@pytest.mark.parametrize("write", [to_mjcf, to_urdf, to_sdf])
def test_a_hinge_has_its_place_and_its_friction(model, write):
    given, places = exported(model), model.shape.chain.hinges
    if write is to_sdf:
        joints = ElementTree.fromstring(write(given)).findall("model/joint")
        found = [[each.findtext(at, "") for at in ("parent", "child", "axis/dynamics/friction")] for each in joints]
        names = [link.name for link in given.links]
        assert found == [list(joint) for joint in zip(names, names[1:], map(repr, model.hinge_friction), strict=False)]
        return
    compiled = mujoco.MjSpec.from_string(write(given).replace("</robot>", FREE.format(model.name))).compile()
    data = mujoco.MjData(compiled)
    mujoco.mj_kinematics(compiled, data)
    for index, (place, torque) in enumerate(zip(places, model.hinge_friction, strict=True)):
        joint = compiled.joint(f"hinge_{index}")
        assert_allclose(data.joint(f"hinge_{index}").xanchor[:2], place, atol=1e-12)
        assert_allclose(data.joint(f"hinge_{index}").xaxis, [0, 0, 1])
        assert_allclose(compiled.dof_frictionloss[joint.dofadr], torque)
        assert not compiled.jnt_limited[joint.id]


@pytest.mark.parametrize("step", [0.0005, 0.002, 0.01])
@pytest.mark.parametrize("model", [LINKS["fold_2"], LINKS["elbow"]], ids=["fold_2", "elbow"])
def test_a_hinge_moves_above_its_friction_alone(model, step):
    spec = mujoco.MjSpec.from_string(to_mjcf(exported(model)))
    spec.option.gravity, spec.option.timestep = (0, 0, 0), step
    compiled = spec.compile()
    (friction,), seconds = model.hinge_friction, 0.02
    for part in (0.95, -0.95, 1.1, -2.0):
        data = mujoco.MjData(compiled)
        data.qfrc_applied[6] = part * friction
        mujoco.mj_forward(compiled, data)
        slope = np.linalg.inv(mass_matrix(compiled, data))[6, 6] * friction
        if abs(part) < 1:
            mujoco.mj_step(compiled, data, round(1 / step))
            assert abs(data.qpos[7]) < 3e-3
        else:
            mujoco.mj_step(compiled, data, round(seconds / step))
            assert_allclose(data.qvel[6], np.sign(part) * (abs(part) - 1) * slope * seconds, rtol=0.02)


def mass_matrix(model: mujoco.MjModel, data: mujoco.MjData) -> np.ndarray:
    """Inertia of the degrees of freedom, (nv, nv)."""
    full = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, full)
    return full


FOLD = LINKS["fold_2"]
HALF = replace(FOLD.truth, mass=FOLD.truth.mass * [1, 1, 0, 0])


@pytest.mark.parametrize(
    ("write", "message"),
    [
        (lambda: export_text(exported(load_object("L2")), "urdf", scene=True), "--scene"),
        (lambda: to_urdf(replace(exported(load_object("L2")), name="A1")), "A1"),
        (lambda: to_mjcf(replace(exported(FOLD), distribution=HALF)), "link_1 of 0 kg"),
        (lambda: replace(exported(FOLD), hinge_friction=(0.1, 0.2)), "hinge_friction"),
        (lambda: replace(exported(FOLD), hinge_deviation=(0.1, 0.2)), "hinge_deviation"),
        (lambda: to_object_file(exported(MODELS["hammer"])), "square blocks"),
        (lambda: to_object_file(exported(MODELS["cut"])), "square blocks"),
    ],
)
def test_what_cannot_be_exported_is_refused(write, message: str):
    with pytest.raises(InvalidValueError, match=message):
        write()


@pytest.mark.parametrize("write", [to_mjcf, to_urdf])
@pytest.mark.parametrize("model", [MODELS["hammer"], MODELS["on points"]], ids=["hammer", "on points"])
def test_a_dropped_object_comes_to_rest_on_the_boxes_that_touch(model, write):
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
    names = {compiled.geom(geom).name.removesuffix("_collision") for c in data.contact for geom in c.geom}
    touching = names - {"table"}
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
        for mine, theirs in zip(turns(model), turns(load(to_object_file(exported(model)))), strict=True):
            assert_allclose(theirs.wrench_on_object_world, mine.wrench_on_object_world, atol=1e-9)


@pytest.mark.parametrize("model", [*BLOCKS, drawn_chain(0), drawn_chain(1)], ids=lambda model: model.name)
def test_an_object_file_has_the_hinges(model):
    back = load(to_object_file(exported(model)))
    chain, ours = back.shape.chain, model.shape.chain
    assert chain is not None and ours is not None
    assert back.hinge_friction == model.hinge_friction
    assert_allclose(chain.hinges, ours.hinges, atol=1e-12)
    assert_allclose(back.shape.particles, model.shape.particles, atol=1e-12)
    assert np.array_equal(chain.link[back.shape.mass_group], ours.link[model.shape.mass_group])
    assert_allclose(back.particle_mass, model.particle_mass, rtol=1e-12)
    assert_allclose(back.truth.friction, model.truth.friction)
    assert [g.name for g in back.shape.grasps] == [g.name for g in model.shape.grasps]


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
    ElementTree.fromstring(to_urdf(replace(given, notes=("a part called a---b",))))


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
    drawn = [
        by_hand(path.read_text(encoding="utf-8"), ["bar"], [])[0] for path in sorted(Path("drawn.draws").glob("*.sdf"))
    ]
    assert len(drawn) == 3
    assert all(parameters(body).consistent for body in drawn)
    pytest.importorskip("rosbags", reason="needs the extra robot")
    moved = [t for t in keys_of(Path("out")) if kind_of_trial(Path("out"), t) in ("rotate", "accelerate")]
    for trial in moved[:2]:
        main(["export", "out", trial, "--format", "mcap"])
    assert load_object(Path("out/exports/bar.toml")).group_mass == pytest.approx([0.3, 0.1, 0.2])
    mapping = f"out/exports/bar_{moved[0][:8]}.toml"
    main(["import", mapping, "--weight", "0.6", "--out", "lab"])
    kept, back = (read_trial(Path(d), t).trajectory for d, t in (("out", moved[0]), ("lab", turn_of("lab"))))
    assert np.array_equal(back.sensor_wrench, kept.sensor_wrench)
    assert ended("export", "out", moved[0], "--format", "mcap", "--draws", "3") == 2
    assert ended("export", "out", key[:6], "--models", "--out", "drawn.xml") == 2
    assert ended("export", "out", key[:6], "--draws", "0", "--out", "drawn.xml") == 2


def turn_of(folder: str) -> str:
    (key,) = [key for key in keys_of(Path(folder)) if kind_of_trial(Path(folder), key) != "weigh"]
    return key


@pytest.mark.slow
def test_an_estimate_of_links_is_exported_with_its_hinges(tmp_path):
    (tmp_path / "fold_2.toml").write_text((LIBRARY / "fold_2.toml").read_text(encoding="utf-8"), encoding="utf-8")
    (tmp_path / "s.toml").write_text(
        'objects = ["fold_2.toml"]\nsensing = ["ideal"]\nsupport = ["own_weight"]\n'
        '[policy]\nkind = "drag"\ntouches = 4\nheld_out = 0\n[methods.hidden_states]\n[methods.least_squares]\n',
        encoding="utf-8",
    )
    main(["run", "s.toml", "--out", "out", "--workers", "0"])
    rows = {row["method"]: row for row in load_rows(Path("out"))}
    found = load_estimate("out", rows["hidden_states"]["key"]).diagnostics
    assert found["hinge_0_Nm"] == pytest.approx(LINKS["fold_2"].hinge_friction[0], rel=0.05)
    expected = {"hidden_states": found["hinge_0_Nm"], "least_squares": LINKS["fold_2"].hinge_friction[0]}
    for method, torque in expected.items():
        key = rows[method]["key"]
        main(["export", "out", key[:8], "--format", "toml", "--out", "answer.toml"])
        assert load_object("answer.toml").hinge_friction == (torque,)
        said = json.loads(Path("answer.json").read_text(encoding="utf-8"))
        given = rows[method]["hinge_error_Nm"]
        assert said["hinge_friction_std_Nm"] == (None if given is None else list(given))
        assert (given is None) == ("not estimated" in Path("answer.toml").read_text(encoding="utf-8"))
    main(["export", "out", rows["hidden_states"]["key"][:8], "--draws", "5", "--models", "--out", "drawn.xml"])
    draws = np.loadtxt("drawn.draws.csv", delimiter=",", skiprows=1)
    models = [mujoco.MjModel.from_xml_path(str(path)) for path in sorted(Path("drawn.draws").iterdir())]
    assert_allclose([model.dof_frictionloss[6] for model in models], found["hinge_0_Nm"])
    masses = [[model.body(name).mass[0] for name in ("fold_2", "link_1")] for model in models]
    assert_allclose(masses, np.column_stack([draws[:, :2].sum(axis=1), draws[:, 2:4].sum(axis=1)]))
