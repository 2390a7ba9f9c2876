"""Arm and sensor of a world: each error alone acts on a clean record as it says, and leaves the rest."""

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from numpy.testing import assert_allclose

from estimators.testing.truth import truth_within_reach
from testbed.actions.rotate import Rotate
from testbed.actions.weigh import Weigh
from testbed.frames import rotation_matrix
from testbed.objects.files import load_object
from testbed.objects.model import GRAVITY
from testbed.sensing.compensation import compensate
from testbed.sensing.noise import draw_sensing
from testbed.sensing.presets import preset
from testbed.simulation.runner import SimulationRunner
from testbed.trajectory import Trajectory, load_trajectory, save_trajectory
from testbed.trial import Trial
from testbed.worlds import World, WorldDraw, world
from testbed.worlds.instruments import REACH, mounting, response, true_sensing

L2 = load_object("L2")
TURN = Rotate(1, duration=3.0)
IDEAL = preset("ideal")


@cache
def clean() -> Trajectory:
    return SimulationRunner().run_clean(Trial(L2, TURN))


def seen(record: Trajectory | None = None, seed: int = 1, **quantity: float) -> tuple[Trajectory, WorldDraw]:
    """The record of a perfect sensor in a world in which only these quantities err, and the draw."""
    draw = WorldDraw.of(World(name="alone", **quantity), L2, seed)  # pyright: ignore[reportArgumentType]
    record = clean() if record is None else record
    marked = replace(record, provenance=record.provenance | draw.provenance)
    return draw_sensing(marked, IDEAL, 0), draw


def plain() -> Trajectory:
    return draw_sensing(clean(), IDEAL, 0)


def steady() -> np.ndarray:
    return clean().segment >= 0


def test_gain_and_crosstalk_mix_the_axes_of_the_sensor():
    for quantity in ("gain", "crosstalk"):
        record, draw = seen(None, 1, **{quantity: 0.02})
        assert_allclose(record.sensor_wrench, clean().sensor_wrench @ response(draw).T, atol=1e-12)
        assert (response(draw)[0, 0] == 1) == (quantity == "crosstalk")
    more = compensate(replace(clean(), sensor_wrench=1.02 * clean().sensor_wrench))
    ratio = (more.wrench_on_object_world / plain().wrench_on_object_world)[steady()][:, 5]
    assert_allclose(ratio, 1.02, rtol=2e-3)  # the tool's own part stays small beside the tared wrench


def test_a_turned_sensor_reads_in_its_own_axes():
    record, draw = seen(mounting_angle=math.radians(1))
    assert_allclose(record.sensor_wrench[:, :3], clean().sensor_wrench[:, :3] @ mounting(draw).T, atol=1e-12)
    assert_allclose(record.sensor_orientation, clean().sensor_orientation)
    length, before = (np.linalg.norm(t.sensor_wrench[:, 3:], axis=1) for t in (record, clean()))
    assert_allclose(length, before)


def test_poses_come_late():
    record, draw = seen(delay=0.02)
    late = 0.02 * draw.rng("delay").uniform()
    assert 0 < late < 0.02
    rate = clean().object_velocity[steady()][:, 2]
    behind = (plain().object_pose - record.object_pose)[steady()][:, 2]
    assert_allclose(behind, rate * late, rtol=0.02)
    assert np.array_equal(record.sensor_wrench, clean().sensor_wrench)
    assert_allclose(np.linalg.norm(record.sensor_orientation, axis=1), 1.0)


def test_a_filter_keeps_what_is_steady_and_delays_what_changes():
    ramp = np.outer(clean().time_s, np.ones(6))
    record, _ = seen(replace(clean(), sensor_wrench=ramp), low_pass=0.05)
    assert_allclose((ramp - record.sensor_wrench)[-1], 0.05, rtol=0.12)
    level = replace(clean(), sensor_wrench=np.ones((len(ramp), 6)))
    assert_allclose(seen(level, low_pass=0.05)[0].sensor_wrench, 1.0)


def test_a_sensor_reads_in_whole_steps():
    record, _ = seen(force_resolution=0.01, torque_resolution=0.001)
    assert_allclose(record.sensor_wrench[:, :3], np.round(record.sensor_wrench[:, :3], 2), atol=1e-12)
    off = np.abs(record.sensor_wrench - clean().sensor_wrench)
    assert 0.004 < off[:, :3].max() < 0.00501
    assert 0.0004 < off[:, 3:].max() < 0.000501


def test_a_tcp_beside_its_place_moves_poses_and_keeps_the_wrench_at_the_sensor():
    record, draw = seen(tcp_offset=0.001)
    offset = draw.normal("tcp_offset", 3)
    shift = rotation_matrix(clean().sensor_orientation) @ offset
    assert_allclose(record.tcp_position - clean().tcp_position, shift, atol=1e-12)
    assert_allclose(record.object_pose[:, :2] - clean().object_pose[:, :2], shift[:, :2], atol=1e-12)
    force = record.wrench_on_object_world[:, :3]
    moved = plain().wrench_on_object_world[:, 3:] - np.cross(shift, force)
    assert_allclose(record.wrench_on_object_world[steady()][:, 3:], moved[steady()], atol=2e-4)


def test_a_turned_tcp_turns_the_object_about_it():
    record, draw = seen(tcp_angle=math.radians(1))
    turn = draw.normal("tcp_angle", 1)[0]
    assert_allclose(record.object_pose[:, 2] - clean().object_pose[:, 2], turn)
    arm, before = (t.object_pose[:, :2] - t.tcp_position[:, :2] for t in (record, clean()))
    assert_allclose(np.linalg.norm(arm, axis=1), np.linalg.norm(before, axis=1))
    rate = np.gradient(record.object_pose[:, 0], record.time_s)[steady()][5:-5]
    assert_allclose(record.object_velocity[steady()][5:-5, 0], rate, atol=5e-5)


def test_encoders_are_noisy():
    record, _ = seen(encoder_noise=1e-3)
    off = record.joint_position - clean().joint_position
    assert_allclose(off.std(axis=0), 1e-3, rtol=0.15)
    assert_allclose((record.tcp_position - clean().tcp_position)[:, :2].std(), REACH * 1e-3, rtol=0.15)
    assert not (record.tcp_position - clean().tcp_position)[:, 2].any()


def test_a_tool_is_not_what_it_is_told_to_be():
    record, draw = seen(tool_mass=0.01, tool_com=0.002)
    told, true = record.tool, clean().tool
    assert told is not None and true is not None
    assert_allclose(told.mass - true.mass, draw.normal("tool_mass", 1)[0])
    assert_allclose(told.com - true.com, draw.normal("tool_com", 3))
    assert np.array_equal(record.sensor_wrench, clean().sensor_wrench)


def test_bias_and_drift_are_not_the_stated_ones():
    stated, factors = preset("ft300s"), []
    for seed in range(100):
        true = true_sensing(stated, WorldDraw.of(World(zero_factor=2.0), L2, seed))
        assert true.stated == stated
        factors += [true.true_bias, true.true_drift]
    assert 0.5 <= min(factors) < 0.6 and 1.8 < max(factors) <= 2.0
    assert abs(np.log(factors).mean()) < 0.1


def test_a_scale_errs():
    weighed = SimulationRunner().run_clean(Trial(L2, Weigh()))
    record, draw = seen(weighed, scale=0.005)
    off = (record.wrench_on_object_world - weighed.wrench_on_object_world)[:, 2] / GRAVITY
    assert_allclose(off, draw.normal("scale", 1)[0])
    assert off[0] != 0


@pytest.mark.parametrize("action", [TURN, Weigh()])
def test_nothing_of_a_draw_is_in_what_a_method_is_given(action, tmp_path):
    draw = WorldDraw.of(world("lab"), L2, 0)
    made = SimulationRunner().run_clean(Trial(L2, action, world=draw))
    save_trajectory(made, tmp_path / "trial.parquet")
    kept = load_trajectory(tmp_path / "trial.parquet")
    assert WorldDraw.in_record(kept.provenance) == draw
    for record in (draw_sensing(kept, preset("ft300s"), 7).blinded(), kept.blinded()):
        assert WorldDraw.in_record(record.provenance) is None
        assert record.setup == world("lab").stated
    given = {"shape": L2.shape, "trajectories": [draw_sensing(kept, preset("ft300s"), 7).blinded()], "seed": 0}
    assert truth_within_reach(given, L2, [kept]) == []
    told = {**given, "trajectories": [kept]}
    found = truth_within_reach(told, L2, [kept])
    assert any(f"the seed {draw.seed} of the world is given" in line for line in found)
    assert any("['world'] is given" in line for line in found)
    assert any("of WorldDraw" in line for line in truth_within_reach({**given, "extra": draw}, L2, [kept]))
