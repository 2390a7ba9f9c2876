"""Worlds in the simulation: each quantity alone does what it says, of the table, the grasp and the instruments."""

import math
from dataclasses import asdict, replace
from functools import cache, partial

import numpy as np
import pytest
from numpy.testing import assert_allclose

from estimators.testing.analytic_world import record as record_of
from estimators.testing.truth import truth_within_reach
from testbed import Action, Rotate, SimulationRunner, Slide, Weigh, WorldDraw, draw_sensing, load_object, preset
from testbed.errors import InvalidValueError
from testbed.frames import rotation_matrix
from testbed.objects.model import GRAVITY, ObjectModel
from testbed.sensing.compensation import compensate
from testbed.simulation.monitor import ContactRecord
from testbed.simulation.scene import build_scene
from testbed.simulation.settings import SimulationSettings
from testbed.trajectory import Phase, Trajectory, load_trajectory, save_trajectory
from testbed.trial import OWN_WEIGHT, RIGID, Trial
from testbed.worlds.feet import Feet
from testbed.worlds.instruments import REACH, mounting, response, true_sensing
from testbed.worlds.presets import QUANTITIES, SOURCES, UNSTATED, WORLDS, World, stated_setup, world
from testbed.worlds.surface import Surface

L2 = load_object("L2")
TURN = Rotate(1, duration=3.0)
RUNNER = SimulationRunner()
MIDDLE = 600
"""A sample in the steady part of all trials here."""


def alone(model: ObjectModel = L2, seed: int = 1, **quantity: float) -> WorldDraw:
    """Draw of a world in which only these quantities err."""
    return WorldDraw.of(World(name="alone", **quantity), model, seed)  # pyright: ignore[reportArgumentType]


@cache
def run(draw: WorldDraw | None, action: Action = TURN) -> tuple[Trajectory, ContactRecord]:
    return RUNNER.run_with_contacts(Trial(L2, action, world=draw))


def steady(record: Trajectory) -> np.ndarray:
    return record.segment >= 0


def friction_used(contacts: ContactRecord) -> np.ndarray:
    """Tangential over normal force of every foot in the middle of a trial."""
    force = contacts.force_on_object[MIDDLE]
    return np.linalg.norm(force[:, :2], axis=1) / force[:, 2]


@pytest.mark.slow
def test_the_ideal_world_is_the_simulation_as_it_was():
    plain, ideal = run(None)[0], run(alone())[0]
    for name in ("sensor_wrench", "object_pose", "tcp_velocity", "joint_position"):
        assert np.array_equal(getattr(plain, name), getattr(ideal, name)), name
    assert plain.setup == ideal.setup
    weighed = [RUNNER.run(Trial(L2, Weigh(), sensing="ft300s", world=draw)) for draw in (None, alone())]
    assert np.array_equal(weighed[0].wrench_on_object_world, weighed[1].wrench_on_object_world)


def test_a_record_of_one_sample_has_a_labs_errors():
    drawn = WorldDraw.of(world("lab"), L2, 0, "s")
    short = record_of(
        1, tare=1, status="fault", reason="it diverged", provenance={"runner": "simulation"} | drawn.provenance
    )
    found = draw_sensing(short, preset("ft300s"), 1)
    assert found.status == "fault" and np.isfinite(found.sensor_wrench).all()


def test_presets_are_ordered_and_state_what_a_lab_states():
    ideal, lab, rough = WORLDS.values()
    assert ideal.none and ideal.stated.none and not lab.none
    assert all(getattr(rough, name) >= getattr(lab, name) > getattr(ideal, name) for name in QUANTITIES)
    assert lab.stated.grasp_offset == lab.grasp_offset
    assert lab.stated.delay == lab.delay / math.sqrt(3)


@pytest.mark.parametrize(
    ("call", "field", "allowed"),
    [
        (partial(world, "labb"), "world", "one of ideal, lab, rough"),
        (partial(stated_setup, {"grasp_ofset": 0.001}), "setup", "grasp_offset"),
        (partial(stated_setup, {"preset": 1e-9}), "preset", "got 1e-09; allowed: one of ideal, lab"),
        (partial(WORLDS["lab"].only, "contact"), "world.only", "nearest: contacts"),
        (partial(World, gain=-0.1), "World.gain", "0 to 1"),
        (partial(World, zero_factor=0.5), "World.zero_factor", "1 to 100"),
        (partial(World, contact_points=3), "World.contact_points", "0, or an integer >= 4"),
        (partial(World, delay=math.nan), "World.delay", "0 to 1 s"),
        (partial(World, friction_law=0.1), "World.friction_law", "got 0.1; allowed: 0"),
    ],
)
def test_a_wrong_world_or_setup_is_refused(call, field: str, allowed: str):
    with pytest.raises(InvalidValueError) as refused:
        call()
    assert refused.value.field == field and allowed in str(refused.value)


def test_a_seed_gives_one_draw_and_quantities_do_not_disturb_each_other():
    lab, few = WorldDraw.of(world("lab"), L2, 3), alone(seed=3, gain=0.01)
    assert lab == WorldDraw.of(world("lab"), L2, 3)
    assert lab.seed == few.seed
    assert_allclose(lab.normal("gain", 6), few.normal("gain", 6))
    assert lab.seed != WorldDraw.of(world("lab"), L2, 4).seed
    assert lab.seed != WorldDraw.of(world("lab"), L2, 3, "another secret").seed
    assert WorldDraw.in_record(lab.provenance) == lab
    assert not np.array_equal(lab.start(TURN), lab.start(Rotate(2, duration=3.0)))


def test_trials_of_one_action_err_anew_in_the_same_setup():
    drawn = WorldDraw.of(world("lab"), L2, 3)
    first, second = (Trial(L2, TURN, world=drawn, seed=seed).world for seed in (0, 1))
    assert first == drawn and second is not None
    assert not np.array_equal(second.start(TURN), drawn.start(TURN))
    assert not np.array_equal(second.normal("encoder_noise", 6, TURN), drawn.normal("encoder_noise", 6, TURN))
    assert replace(Trial(L2, TURN, world=drawn, seed=1), seed=0).world == drawn
    assert second.grasp(L2.shape.grasps[0], TURN).angle != drawn.grasp(L2.shape.grasps[0], TURN).angle
    assert_allclose(second.normal("gain", 6), drawn.normal("gain", 6))
    assert WorldDraw.in_record(second.provenance) == second
    assert second.request(L2) == drawn.request(L2) | {"repeat": 1}


@pytest.mark.parametrize("points", [4, 6])
def test_a_group_stands_on_a_few_points_about_its_middle(points: int):
    shape, counts = L2.shape, set()
    for seed in range(40):
        feet = Feet.drawn(L2, points, np.random.default_rng(seed))
        group = shape.mass_group[feet.particle]
        for g in range(shape.n_m):
            mine = group == g
            counts.add(int(mine.sum()))
            share = feet.stiffness[mine] / (shape.mass_group == g).sum()
            assert share.min() > 0
            assert_allclose(share.sum(), 1.0)
            middle = shape.particles[shape.mass_group == g].mean(axis=0)
            assert_allclose(share @ feet.position[mine], middle, atol=1e-9)
        assert (np.abs(feet.position - shape.particles[feet.particle]).max(axis=1) <= shape.cell / 2 + 1e-12).all()
    assert counts == {points - 1, points, 8}


def test_the_wrench_is_coulombs_sum_at_the_contact_points():
    draw = alone(contact_points=4)
    record, contacts = run(draw)
    assert steady(record)[MIDDLE]
    feet = draw.feet(L2)
    assert np.array_equal(contacts.foot_forces(record.time_s).particle, feet.particle)
    group = L2.shape.mass_group[feet.particle]
    load = feet.stiffness / np.bincount(group, feet.stiffness)[group] * L2.group_mass[group] * GRAVITY
    assert_allclose(contacts.force_on_object[MIDDLE, :, 2], load, rtol=0.1)  # the push tilts the object a little
    lever = feet.position - L2.shape.grasps[1].position
    coulomb = feet.friction[:, 0] * contacts.force_on_object[MIDDLE, :, 2] @ np.linalg.norm(lever, axis=1)
    drag = contacts.wrench_at_tcp[steady(record)][:, 5].mean()
    assert_allclose(abs(drag), coulomb, rtol=2e-3)
    assert not np.allclose(feet.position, L2.shape.particles[feet.particle], atol=1e-3)


@pytest.mark.slow
def test_higher_points_carry_more():
    draw = alone(flatness=1e-4)
    higher = np.argsort(draw.feet(L2).height)
    plain, uneven = (run(of)[1].force_on_object[MIDDLE, :, 2] for of in (None, draw))
    more = (uneven - plain)[higher]
    assert more[-8:].min() > 0 > more[:8].max()


@pytest.mark.slow
def test_friction_of_groups_scales_drag():
    draw = alone(group_friction=0.08)
    factor = 1 + draw.normal("group_friction", L2.shape.n_m)
    ratio = friction_used(run(draw)[1]) / friction_used(run(None)[1])
    assert_allclose(ratio, factor[L2.shape.mass_group[run(draw)[1].particle]], rtol=1e-3)


@pytest.mark.slow
def test_friction_differs_between_the_tables_axes():
    draw = alone(anisotropy=0.1)
    along_x = draw.normal("anisotropy", 1)[0]
    assert abs(along_x) > 0.01
    ways = set()
    for angle in (0.0, math.pi / 2):
        action = Slide(1, direction=angle, speed=0.03, duration=2.0)
        plain, turned = run(None, action), run(draw, action)
        way = np.abs(plain[0].tcp_position[-1, :2] - plain[0].tcp_position[0, :2])
        ways.add(axis := int(way.argmax()))
        factor = (1 + along_x, 1 - along_x)[axis]
        assert_allclose(friction_used(turned[1]) / friction_used(plain[1]), factor, rtol=2e-3)
    assert ways == {0, 1}


@pytest.mark.slow
def test_friction_follows_place_and_speed():
    draw = alone(place_friction=0.1, speed_friction=0.05)
    surface = draw.surface
    assert surface is not None
    record, contacts = run(draw)
    rate = abs(record.tcp_velocity[MIDDLE, 5])
    speed = rate * np.linalg.norm(contacts.position[MIDDLE, :, :2] - record.tcp_position[MIDDLE, :2], axis=1)
    factor = surface.factor(contacts.position[MIDDLE, :, :2], speed)
    assert factor.std() > 0.02
    moving = speed > 0.005
    assert_allclose((friction_used(contacts) / friction_used(run(None)[1]))[moving], factor[moving], rtol=3e-3)


def test_the_field_has_its_standard_deviation_and_is_smooth():
    place = np.random.default_rng(0).uniform(-0.5, 0.5, (4000, 2))
    spread = []
    for seed in range(30):
        surface = Surface.drawn(0.05, 0.0, np.random.default_rng(seed))
        factor = surface.factor(place, np.full(len(place), 0.02))
        spread.append(factor.std())
        near = surface.factor(place + np.array([0.002, 0.0]), np.full(len(place), 0.02))
        assert np.abs(near - factor).max() < 0.2 * 0.05 * 2
    assert_allclose(np.mean(spread), 0.05, rtol=0.1)
    decades = Surface.drawn(0.0, 0.03, np.random.default_rng(0)).factor(place[:2], np.array([0.02, 0.2]))
    assert_allclose(decades, [1.0, 1.03])


@pytest.mark.slow
def test_a_tilted_table_adds_its_part_of_gravity():
    draw = alone(table_tilt=math.radians(1))
    assert_allclose(np.linalg.norm(draw.gravity), GRAVITY)
    scene = build_scene(L2, OWN_WEIGHT, None, SimulationSettings(), draw=draw)
    assert_allclose(scene.model.opt.gravity, draw.gravity)
    (plain, level), (record, sloping) = run(None), run(draw)
    more = (sloping.wrench_at_tcp - level.wrench_at_tcp)[:, :2]
    # the hand holds against the slope: what the feet rub does not change, but for the load that the slope moves
    wrench = (record.sensor_wrench - plain.sensor_wrench)[:, :3]
    world_axes = np.einsum("nij,nj->ni", rotation_matrix(plain.sensor_orientation), wrench)[steady(plain)]
    assert plain.tool is not None
    held = -(L2.total_mass + plain.tool.mass) * draw.gravity[:2]
    assert_allclose(world_axes.mean(axis=0)[:2], held - more[steady(plain)].mean(axis=0), atol=0.02)


@pytest.mark.slow
def test_a_groups_particles_move_with_its_feet_and_the_nominal_object_does_not():
    draw = alone(particle_offset=0.001)
    body = draw.true_object(L2)
    moved = body.shape.particles - L2.shape.particles
    assert len(np.unique(moved.round(9), axis=0)) == L2.shape.n_m
    assert_allclose(draw.feet(body).position, body.shape.particles)
    hammer = load_object("hammer")
    true = WorldDraw.of(World(particle_offset=0.001), hammer, 0).true_object(hammer)
    shift = [a.center_of_mass - b.center_of_mass for a, b in zip(true.solids, hammer.solids, strict=True)]
    assert_allclose(np.array(shift)[hammer.shape.mass_group][:, :2], true.shape.particles - hammer.shape.particles)
    assert abs(run(draw)[1].wrench_at_tcp[MIDDLE, 5] / run(None)[1].wrench_at_tcp[MIDDLE, 5] - 1) > 1e-3


def test_a_record_has_the_nominal_grasp_while_the_object_lies_otherwise():
    draw = alone(grasp_offset=0.002, grasp_angle=math.radians(1))
    record, contacts = run(draw)
    held = draw.grasp(L2.shape.grasps[1], TURN)
    recorded, nominal = record.object_pose, run(None)[0].object_pose
    assert_allclose(recorded[steady(record)], nominal[steady(record)], atol=2e-4)  # the arm goes its planned way
    lever = contacts.position[MIDDLE, :, :2] - contacts.tcp_position[MIDDLE, :2]
    assert_allclose(
        np.linalg.norm(lever, axis=1), np.linalg.norm(L2.shape.particles - held.position, axis=1), atol=1e-4
    )
    assert held.angle != L2.shape.grasps[1].angle


@pytest.mark.slow
def test_a_trial_begins_elsewhere_and_nearer_where_it_could_not():
    draw = alone(start_offset=0.02, start_angle=math.radians(10))
    record, plain = run(draw)[0], run(None)[0]
    shift = draw.start(TURN)
    assert_allclose((record.tcp_position - plain.tcp_position)[MIDDLE, :2], shift[:2], atol=1e-3)
    assert_allclose((record.object_pose - plain.object_pose)[steady(record)][:, 2], shift[2], atol=1e-3)
    far = alone(start_offset=5.0)
    assert_allclose(run(far)[0].object_pose, plain.object_pose)


@pytest.mark.slow
def test_a_rigid_object_stands_on_the_points_too():
    draw = WorldDraw.of(world("lab"), L2, 0)
    record = RUNNER.run(Trial(L2, TURN, RIGID, "ft300s", world=draw))
    assert record.ok
    assert record.setup == world("lab").stated
    assert record.mask(Phase.STEADY).any()


def test_a_setup_is_stated_by_the_name_of_a_world_and_by_its_own_errors():
    assert stated_setup({"preset": "lab", "gain": 0.03}) == replace(world("lab").stated, gain=0.03)
    assert stated_setup({"preset": "ideal"}).none
    assert stated_setup({"gain": 0.03}) == replace(UNSTATED, gain=0.03)  # errors that are not stated are not zero
    for name, size in asdict(UNSTATED).items():
        assert size > 0
        assert size < getattr(world("lab").stated, name) or name in ("contact_points", "friction_law")


def test_no_world_draws_departures_from_coulombs_law():
    assert "friction_law" not in QUANTITIES
    assert "friction_law" not in alone().request(L2)["world"]  # trials of earlier versions keep their names


def test_every_quantity_is_of_one_source_that_may_err_alone():
    assert sorted(name for names in SOURCES.values() for name in names) == sorted(QUANTITIES)
    lab, ideal = WORLDS["lab"], WORLDS["ideal"]
    for source, names in SOURCES.items():
        alone = lab.only(source)
        assert all(getattr(alone, name) == getattr(lab if name in names else ideal, name) for name in QUANTITIES)
    assert lab.only("gain") == replace(World(gain=lab.gain), name="lab: gain")


def clean() -> Trajectory:
    return run(None)[0]


def sensed(record: Trajectory | None = None, **quantity: float) -> tuple[Trajectory, WorldDraw]:
    """Record by a perfect sensor in a world in which only these quantities err, and the draw."""
    draw = alone(L2, 1, **quantity)
    record = clean() if record is None else record
    marked = replace(record, provenance=record.provenance | draw.provenance)
    return draw_sensing(marked, preset("ideal"), 0), draw


@cache
def plain() -> Trajectory:
    return draw_sensing(clean(), preset("ideal"), 0)


def steady_part() -> np.ndarray:
    return steady(clean())


def test_gain_and_crosstalk_mix_the_axes_of_the_sensor():
    for quantity in ("gain", "crosstalk"):
        record, draw = sensed(None, **{quantity: 0.02})
        assert_allclose(record.sensor_wrench, clean().sensor_wrench @ response(draw).T, atol=1e-12)
        assert (response(draw)[0, 0] == 1) == (quantity == "crosstalk")
    more = compensate(replace(clean(), sensor_wrench=1.02 * clean().sensor_wrench))
    ratio = (more.wrench_on_object_world / plain().wrench_on_object_world)[steady_part()][:, 5]
    assert_allclose(ratio, 1.02, rtol=2e-3)  # the tool's own part stays small beside the tared wrench


def test_a_turned_sensor_reads_in_its_own_axes():
    record, draw = sensed(mounting_angle=math.radians(1))
    assert_allclose(record.sensor_wrench[:, :3], clean().sensor_wrench[:, :3] @ mounting(draw).T, atol=1e-12)
    assert_allclose(record.sensor_orientation, clean().sensor_orientation)
    length, before = (np.linalg.norm(t.sensor_wrench[:, 3:], axis=1) for t in (record, clean()))
    assert_allclose(length, before)


def test_poses_come_late():
    record, draw = sensed(delay=0.02)
    late = 0.02 * draw.rng("delay").uniform()
    assert 0 < late < 0.02
    rate = clean().object_velocity[steady_part()][:, 2]
    behind = (plain().object_pose - record.object_pose)[steady_part()][:, 2]
    assert_allclose(behind, rate * late, rtol=0.02)
    assert np.array_equal(record.sensor_wrench, clean().sensor_wrench)
    assert_allclose(np.linalg.norm(record.sensor_orientation, axis=1), 1.0)


def test_a_filter_keeps_what_is_steady_and_delays_what_changes():
    ramp = np.outer(clean().time_s, np.ones(6))
    record, _ = sensed(replace(clean(), sensor_wrench=ramp), low_pass=0.05)
    assert_allclose((ramp - record.sensor_wrench)[-1], 0.05, rtol=0.12)
    level = replace(clean(), sensor_wrench=np.ones((len(ramp), 6)))
    assert_allclose(sensed(level, low_pass=0.05)[0].sensor_wrench, 1.0)


def test_a_sensor_reads_in_whole_steps():
    record, _ = sensed(force_resolution=0.01, torque_resolution=0.001)
    assert_allclose(record.sensor_wrench[:, :3], np.round(record.sensor_wrench[:, :3], 2), atol=1e-12)
    off = np.abs(record.sensor_wrench - clean().sensor_wrench)
    assert 0.004 < off[:, :3].max() < 0.00501
    assert 0.0004 < off[:, 3:].max() < 0.000501


def test_a_tcp_beside_its_place_moves_poses_and_keeps_the_wrench_at_the_sensor():
    record, draw = sensed(tcp_offset=0.001)
    offset = draw.normal("tcp_offset", 3)
    shift = rotation_matrix(clean().sensor_orientation) @ offset
    assert_allclose(record.tcp_position - clean().tcp_position, shift, atol=1e-12)
    assert_allclose(record.object_pose[:, :2] - clean().object_pose[:, :2], shift[:, :2], atol=1e-12)
    force = record.wrench_on_object_world[:, :3]
    moved = plain().wrench_on_object_world[:, 3:] - np.cross(shift, force)
    assert_allclose(record.wrench_on_object_world[steady_part()][:, 3:], moved[steady_part()], atol=2e-4)


def test_a_turned_tcp_turns_the_object_about_it():
    record, draw = sensed(tcp_angle=math.radians(1))
    turn = draw.normal("tcp_angle", 1)[0]
    assert_allclose(record.object_pose[:, 2] - clean().object_pose[:, 2], turn)
    arm, before = (t.object_pose[:, :2] - t.tcp_position[:, :2] for t in (record, clean()))
    assert_allclose(np.linalg.norm(arm, axis=1), np.linalg.norm(before, axis=1))
    rate = np.gradient(record.object_pose[:, 0], record.time_s)[steady_part()][5:-5]
    assert_allclose(record.object_velocity[steady_part()][5:-5, 0], rate, atol=5e-5)


def test_encoders_are_noisy():
    record, _ = sensed(encoder_noise=1e-3)
    off = record.joint_position - clean().joint_position
    assert_allclose(off.std(axis=0), 1e-3, rtol=0.15)
    assert_allclose((record.tcp_position - clean().tcp_position)[:, :2].std(), REACH * 1e-3, rtol=0.15)
    assert not (record.tcp_position - clean().tcp_position)[:, 2].any()


def test_the_stated_tool_differs_from_the_true_one():
    record, draw = sensed(tool_mass=0.01, tool_com=0.002)
    stated, true = record.tool, clean().tool
    assert stated is not None and true is not None
    assert_allclose(stated.mass - true.mass, draw.normal("tool_mass", 1)[0])
    assert_allclose(stated.com - true.com, draw.normal("tool_com", 3))
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
    weighed = RUNNER.run_clean(Trial(L2, Weigh()))
    record, draw = sensed(weighed, scale=0.005)
    off = (record.wrench_on_object_world - weighed.wrench_on_object_world)[:, 2] / GRAVITY
    assert_allclose(off, draw.normal("scale", 1)[0])
    assert off[0] != 0


@pytest.mark.parametrize("action", [Rotate(1, duration=1.0), Weigh()])
def test_nothing_of_a_draw_is_in_what_a_method_is_given(action, tmp_path):
    draw = WorldDraw.of(world("lab"), L2, 0)
    made = RUNNER.run_clean(Trial(L2, action, world=draw))
    save_trajectory(made, tmp_path / "trial.parquet")
    kept = load_trajectory(tmp_path / "trial.parquet")
    assert WorldDraw.in_record(kept.provenance) == draw
    for record in (draw_sensing(kept, preset("ft300s"), 7).blinded(), kept.blinded()):
        assert WorldDraw.in_record(record.provenance) is None
        assert record.setup == world("lab").stated
    given = {"shape": L2.shape, "trajectories": [draw_sensing(kept, preset("ft300s"), 7).blinded()], "seed": 0}
    assert truth_within_reach(given, L2, [kept]) == []
    leaked = {**given, "trajectories": [kept]}
    found = truth_within_reach(leaked, L2, [kept])
    assert any(f"the seed {draw.seed} of the world is given" in line for line in found)
    assert any("['world'] is given" in line for line in found)
    assert any("of WorldDraw" in line for line in truth_within_reach({**given, "extra": draw}, L2, [kept]))
