"""Scene and planned motions: signs, parts and supports against closed formulas, and the tool where it should be."""

import math
from functools import cache

import mujoco
import numpy as np
import pytest
from numpy.testing import assert_allclose

from testbed import OWN_WEIGHT, RIGID, Accelerate, Phase, Rotate, SimulationSettings, Slide, Support, load_object
from testbed.errors import InfeasibleTrialError, InvalidValueError
from testbed.frames import transform_point
from testbed.objects.model import GRAVITY, MassDistribution, ObjectModel, ObjectShape
from testbed.simulation.contacts import resting_loads
from testbed.simulation.motion import Motion, arm_model, gripper_tool, joint_path, plan_motion
from testbed.simulation.scene import HOME, Scene, build_scene
from tests.helpers.blocks import blocks

SETTINGS = SimulationSettings()
HUNG_BOX = """
<mujoco><worldbody><body pos="0 0 1"><site name="s"/>
  <geom type="box" size=".02 .02 .02" pos=".1 0 0" mass="2"/></body></worldbody>
  <sensor><force site="s"/><torque site="s"/></sensor></mujoco>
"""
# Kinova's classical DH table, a = 0: alpha, d, theta offset; the first row is fixed
HALF = math.pi / 2
DH = [
    (math.pi, 0.0, 0.0),
    (HALF, -0.28481, 0.0),
    (HALF, -0.01175, math.pi),
    (HALF, -0.42076, math.pi),
    (HALF, -0.01275, math.pi),
    (HALF, -0.31436, math.pi),
    (HALF, -0.00035, math.pi),
    (math.pi, -0.167455, math.pi),
]


@cache
def at_rest(name: str, support: Support) -> tuple[Scene, np.ndarray]:
    """Normal load on every foot of an object that stands alone [N]."""
    scene = build_scene(load_object(name), support, None, SETTINGS)
    data = mujoco.MjData(scene.model)
    mujoco.mj_step(scene.model, data, 1500)
    loads = np.zeros(len(scene.foot_geoms))
    wrench = np.zeros(6)
    for i in range(data.ncon):
        mujoco.mj_contactForce(scene.model, data, i, wrench)
        foot = np.isin(scene.foot_geoms, [data.contact[i].geom1, data.contact[i].geom2])
        loads[foot] = wrench[0]
    return scene, loads


def test_a_sensor_reports_what_the_parent_does_to_the_child():
    model = mujoco.MjModel.from_xml_string(HUNG_BOX)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    assert_allclose(data.sensordata, [0, 0, 19.62, 0, -1.962, 0], atol=1e-9)


def test_the_arm_is_the_dh_table():
    model = arm_model()
    data = mujoco.MjData(model)
    rng = np.random.default_rng(0)
    for q in rng.uniform(-2, 2, (10, 7)):
        data.qpos[:7] = q
        mujoco.mj_kinematics(model, data)
        pose = np.eye(4)
        for (alpha, d, offset), angle in zip(DH, [0.0, *q], strict=True):
            ca, sa, ct, st = math.cos(alpha), math.sin(alpha), math.cos(angle + offset), math.sin(angle + offset)
            pose = pose @ [[ct, -st * ca, st * sa, 0], [st, ct * ca, -ct * sa, 0], [0, sa, ca, d], [0, 0, 0, 1]]
        assert_allclose(data.site("arm/flange").xpos, pose[:3, 3], atol=2e-7)  # the table is rounded to 0.1 um


def test_the_tool_points_down_where_inverse_kinematics_puts_it():
    wanted = np.array([[0.45, 0.1, 0.05, 0.7], [0.5, -0.1, 0.03, -2.0]])
    model = arm_model()
    data = mujoco.MjData(model)
    for pose, q in zip(wanted, joint_path(wanted, np.array(HOME)), strict=True):
        data.qpos[:7] = q
        mujoco.mj_kinematics(model, data)
        site = data.site("gripper/tcp")
        closing = site.xmat.reshape(3, 3)[:, 0]
        assert_allclose(site.xpos, pose[:3], atol=1e-6)
        assert_allclose(site.xmat.reshape(3, 3)[:, 2], [0, 0, -1], atol=1e-6)
        assert_allclose(closing, [math.cos(pose[3]), math.sin(pose[3]), 0], atol=1e-6)


def test_the_gripper_weighs_what_the_maker_says():
    tool = gripper_tool(0.05)
    assert_allclose(tool.mass, 0.925)
    assert_allclose(tool.com, [0, 0, 0.060], atol=1e-6)
    assert_allclose(tool.tcp, [0, 0, 0.174], atol=1e-9)
    assert gripper_tool(0.08).inertia[2, 2] > tool.inertia[2, 2]


def test_springs_lie_between_own_weight_and_rigid():
    loads = {s: at_rest("L2", Support(s))[1] for s in (0.0, 300.0, 1e5, math.inf)}
    distance = {s: np.abs(loads[s] - loads[0.0]).sum() for s in loads}
    assert 0 < distance[300.0] < distance[1e5] <= 1.05 * distance[math.inf]


@pytest.mark.parametrize("name", ["L2", "hammer", "wrench"])
@pytest.mark.parametrize("support", [OWN_WEIGHT, Support(300.0), RIGID], ids=lambda s: s.name)
def test_an_object_rests_as_on_an_even_foundation(name: str, support: Support):
    obj = load_object(name)
    scene, loads = at_rest(name, support)
    expected = resting_loads(obj, support, SETTINGS.contact)
    assert_allclose(expected.sum(), obj.total_mass * GRAVITY, rtol=1e-12)
    assert_allclose(expected @ obj.shape.particles / expected.sum(), obj.center_of_mass, atol=1e-12)
    assert_allclose(loads, expected[scene.feet.particle], atol=0.001 * expected.max())
    assert expected[scene.feet.particle].min() > 0
    if name == "L2" and support == OWN_WEIGHT:
        group = obj.shape.mass_group[scene.feet.particle]
        assert_allclose(np.bincount(group, loads), obj.group_mass * GRAVITY, rtol=1e-4)
    if name == "L2" and support.is_rigid:
        assert_allclose(loads.sum(), obj.total_mass * GRAVITY, rtol=1e-6)
        assert_allclose(loads @ obj.shape.particles[scene.feet.particle] / loads.sum(), obj.center_of_mass, atol=2e-4)


def test_stiff_springs_make_a_small_light_object_rest_as_one_rigid_body():
    obj = blocks(["11", "10"], [0.005, 0.003, 0.002], 0.3, size=0.01)
    rigid, stiff = (resting_loads(obj, support, SETTINGS.contact) for support in (RIGID, Support(5e7)))
    assert_allclose(stiff @ obj.shape.particles / stiff.sum(), obj.center_of_mass, atol=1e-9)
    assert_allclose(stiff, rigid, rtol=1e-5)


@pytest.mark.parametrize("name", ["hammer", "wrench"])
@pytest.mark.parametrize("support", [OWN_WEIGHT, RIGID], ids=lambda s: s.name)
def test_the_compiled_tool_has_its_solids_mass_and_moments(name: str, support: Support):
    obj = load_object(name)
    model = build_scene(obj, support, obj.shape.grasps[0], SETTINGS).model
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    parts = [b for b in range(model.nbody) if model.body(b).name.startswith("object")]
    assert len(parts) == (1 if support.is_rigid else obj.shape.n_m)
    mass = model.body_mass[parts]
    assert_allclose(mass.sum(), obj.total_mass, rtol=1e-9)
    com = mass @ data.xipos[parts] / mass.sum()
    origin = data.xpos[parts[0]]
    assert_allclose((com - origin)[:2], obj.center_of_mass, atol=1e-7)
    height = sum(s.mass * s.center_of_mass[2] for s in obj.solids) / obj.total_mass
    assert_allclose((com - origin)[2] + obj.shape.height / 2, height, atol=1e-7)
    turned = np.einsum("bij,bj,bij->bi", data.ximat[parts].reshape(-1, 3, 3), model.body_inertia[parts],
                       data.ximat[parts].reshape(-1, 3, 3))[:, 2]  # fmt: skip
    inertia = turned.sum() + mass @ np.sum((data.xipos[parts] - com)[:, :2] ** 2, axis=1)
    assert_allclose(inertia, obj.inertia_cm, rtol=1e-5)


def test_pads_meet_a_tool_over_its_grasps_own_faces():
    obj = load_object("hammer")
    grasp = obj.shape.grasps[2]
    assert grasp.top is not None
    scene = build_scene(obj, OWN_WEIGHT, grasp, SETTINGS)
    data = mujoco.MjData(scene.model)
    mujoco.mj_forward(scene.model, data)
    box = scene.model.geom("gripped_1")
    assert scene.model.body(int(box.bodyid[0])).name == "object/handle"
    assert_allclose(box.size, np.array([grasp.width, grasp.length, grasp.top - grasp.bottom]) / 2)
    assert_allclose(data.geom("gripped_1").xpos[2], (grasp.bottom + grasp.top) / 2, atol=1e-12)


def test_a_group_without_feet_cannot_rest_on_its_own_weight():
    shape = ObjectShape(np.array([[0.0, 0], [0.05, 0]]), np.arange(2), np.array([0, -1]), 0.05, 0.03)
    obj = ObjectModel("half", shape, MassDistribution(np.array([0.4, 0.4]), np.array([0.5])))
    with pytest.raises(InvalidValueError, match="m1 has no foot"):
        build_scene(obj, OWN_WEIGHT, None, SETTINGS)
    build_scene(obj, RIGID, None, SETTINGS)


OBJECT = load_object("L2")


def tool_poses(motion: Motion, keep: np.ndarray) -> np.ndarray:
    """x, y, z, yaw of the TCP at the kept ticks, (N, 4)."""
    model = arm_model()
    data = mujoco.MjData(model)
    poses = []
    for q in motion.q[keep]:
        data.qpos[:7] = q
        mujoco.mj_kinematics(model, data)
        closing = data.site("gripper/tcp").xmat.reshape(3, 3)[:, 0]
        poses.append([*data.site("gripper/tcp").xpos, math.atan2(closing[1], closing[0])])
    return np.array(poses)


@pytest.mark.parametrize(
    "action",
    [
        Rotate(2, duration=2.0, back=True),
        Rotate(2, duration=6.0, pivot=(0.01, -0.02), back=True),
        Slide(0, direction=0.5, duration=2.0),
        Accelerate(1),
    ],
    ids=str,
)
def test_the_arm_goes_the_path_of_the_action(action):
    """Places, and velocities by their differences, at the height of the grip; the joints' rates are their slopes."""
    motion = plan_motion(action, OBJECT.shape, SETTINGS)
    path = action.tool_path(OBJECT.shape, motion.object_pose, 0.01)
    moving = np.flatnonzero(np.isin(motion.phase, (Phase.RAMP, Phase.STEADY)))
    assert np.array_equal(motion.segment[moving], path.segment)
    asked = np.array([path.at(0.01 * tick)[0][:4] for tick in range(1, len(moving) + 1)])
    off = tool_poses(motion, moving) - asked - [0, 0, SETTINGS.grip.tcp_height, 0]
    off[:, 3] = np.angle(np.exp(1j * off[:, 3]))
    assert_allclose(off, 0, atol=2e-6)
    assert_allclose(np.diff(off, axis=0), 0, atol=1e-7)
    slopes, rates = np.diff(motion.q[moving], axis=0) / 0.01, motion.qd[moving]
    assert_allclose(slopes, (rates[1:] + rates[:-1]) / 2, atol=1e-3)


def test_the_object_lies_under_the_open_gripper_before_the_grasp():
    for action in (Rotate(0), Slide(3, direction=2.0)):
        grasp = OBJECT.shape.grasps[action.grasp]
        motion = plan_motion(action, OBJECT.shape, SETTINGS)
        pose = tool_poses(motion, np.array([0]))[0]
        assert_allclose(transform_point(motion.object_pose, grasp.position), pose[:2], atol=1e-6)
        assert math.cos(motion.object_pose[2] + grasp.angle - pose[3]) == pytest.approx(1.0)


def test_out_of_reach_is_refused_with_the_place():
    with pytest.raises(InfeasibleTrialError, match=r"reach: .*x=1\.200"):
        joint_path(np.array([[1.2, 0.0, 0.02, 0.0]]), np.array(HOME))
