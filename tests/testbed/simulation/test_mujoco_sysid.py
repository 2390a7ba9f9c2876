"""MuJoCo's system identification: wrench of its scene, recovery, and the error without its dependencies."""

import re

import mujoco
import numpy as np
import pytest
from mujoco import sysid
from numpy.testing import assert_allclose

from estimators import normalized_absolute_difference, observe
from estimators.baselines.mujoco_sysid import MujocoSysid, motion_of
from estimators.testing.analytic_world import accelerated, drawn_object, turns
from estimators.testing.conformance import CONFORMANCE, WITHOUT_DRAWS, small_object
from estimators.testing.recorded import load_block
from testbed import OWN_WEIGHT, RIGID, InvalidValueError
from testbed.simulation.planar_sysid import compile_scene, planar_scene, sink_depths
from tests.helpers.blocks import blocks

BRIEF = MujocoSysid(iterations=6)
"""Method that ends early: no rule asks for the accuracy of an answer, and rules that only read it share one."""
PAIR = blocks(["11"], [0.4, 0.1], grid=2)
with_toolbox = pytest.mark.skipif(
    not hasattr(sysid, "SystemTrajectory"), reason="MuJoCo's toolbox lacks its needs: pip install 'heft-testbed[sysid]'"
)


@pytest.mark.parametrize("rigid", [False, True])
def test_the_scene_measures_coulombs_wrench(rigid):
    obj, world = drawn_object(2), {"rigid": rigid, "lift": 0.1, "moment": (0.01, -0.015)}
    windows = observe(obj.shape, turns(obj, [0], **world) + accelerated(obj, [0], **world))
    assert windows is not None
    support = RIGID if rigid else OWN_WEIGHT
    motion, sunk = motion_of(windows), sink_depths(obj, support)
    model = compile_scene(planar_scene(obj, support, motion.grasp[0]), obj)
    for k, controls in enumerate(motion.controls(len(sunk))):
        data, readings = mujoco.MjData(model), []
        data.qpos[5:], data.qvel[:3] = -sunk, motion.velocity(0)[k]
        for command in controls:
            data.ctrl[:] = command
            mujoco.mj_step(model, data)
            readings.append(data.sensordata[[0, 1, 5]])
        mean = np.array(readings)[motion.counted].mean(axis=0)
        size = np.abs(windows.wrench.numpy()).max(axis=0)
        assert_allclose(mean, windows.wrench[k].numpy(), atol=0.01 * size.max(), err_msg=f"stretch {k}")


@pytest.mark.slow  # quick, but quick tests run without the extra
@with_toolbox
def test_known_masses_are_recovered_with_their_errors():
    answer = MujocoSysid().estimate(PAIR.shape, PAIR.total_mass, turns(PAIR) + accelerated(PAIR, [0]), 0)
    assert answer.status == "ok"
    assert answer.distribution is not None
    assert answer.covariance is not None
    assert normalized_absolute_difference(PAIR.shape, answer.distribution, PAIR.truth) < 0.01
    assert_allclose(answer.distribution.friction, PAIR.truth.friction, rtol=0.01)
    assert answer.diagnostics["misfit"] < 1
    assert answer.diagnostics["rollouts"] > len(answer.traces[0].loss)
    assert (np.linalg.eigvalsh(answer.covariance) > 0).all()


def test_a_toolbox_without_its_needs_says_which_command_installs_them(monkeypatch):
    monkeypatch.delattr(sysid, "SystemTrajectory", raising=False)
    with pytest.raises(InvalidValueError, match=re.escape("pip install 'heft-testbed[sysid]'")):
        MujocoSysid().estimate(PAIR.shape, PAIR.total_mass, turns(PAIR), 0)


@pytest.mark.slow
@with_toolbox
def test_it_reaches_the_minimum_where_the_valley_bends(capsys):
    known = load_block("F2-own_weight")  # its default optimizer ended at 16 %
    shape, trials = known.model.shape, known.trials("ft300s", 0)
    answer = MujocoSysid().estimate(shape, known.weighed("ft300s", 0), trials, 0)
    assert answer.distribution is not None
    assert normalized_absolute_difference(shape, answer.distribution, known.model.truth) < 0.03
    assert capsys.readouterr().out == ""


@pytest.mark.slow
@with_toolbox
@pytest.mark.parametrize("holds", (*CONFORMANCE, *WITHOUT_DRAWS), ids=lambda rule: rule.__name__)
def test_conformance(holds):
    holds(BRIEF, small_object)
