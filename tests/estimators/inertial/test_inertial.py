"""Bodies in the air: equations of lifts, inertial parameters, and the payload of an arm."""

import json
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from estimators.inertial import (
    Ellipsoid,
    HeldMotion,
    column_parts,
    consistent_inertia,
    ellipsoid_of,
    homogeneous_parts,
    inertial_equations,
    joined,
    least_squares_inertia,
    lift_equations,
    part_ranges,
    places_of,
    pseudo_inertia,
    solid_parts,
    true_body,
)
from estimators.inertial.body import InertialParameters, shift_map
from estimators.inertial.equations import compressed_rows
from estimators.inertial.estimate import InertialEstimate
from estimators.inertial.payload import Payload, as_franka, as_json, as_kortex, as_ur
from scenarios.cli.main import main
from testbed import RIGID, InvalidValueError, Lift, Phase, SimulationRunner, Trajectory, Trial, load_object, preset
from testbed.frames import rotation_matrix, rotation_z
from testbed.objects.model import GRAVITY, Solid
from testbed.robot.calibration.file import save_calibration
from testbed.robot.calibration.static_poses import Calibration
from testbed.simulation.settings import GripSettings, SimulationSettings
from tests.fakes.lifted_world import lifted
from tests.helpers.blocks import blocks
from tests.helpers.commands import refusal
from tests.helpers.simulated import put_trial

FT300S, IDEAL = preset("ft300s"), preset("ideal")
DT = 0.01


def body(seed: int = 0, count: int = 3) -> tuple[list[InertialParameters], np.ndarray, InertialParameters]:
    """Parts of a few point masses each, the mass of every part, and the whole."""
    rng = np.random.default_rng(seed)
    parts = []
    for k in range(count):
        places = 0.02 * rng.standard_normal((20, 3)) + np.array([0.05 * k, 0.01 * k**2, 0.1])
        parts.append(InertialParameters.of_points(places, np.full(20, 1 / 20)))
    masses = rng.uniform(0.1, 0.5, count)
    return parts, masses, InertialParameters.of_vector(np.column_stack([p.vector for p in parts]) @ masses)


def motion(whole: InertialParameters, *, still: bool = False, seconds: float = 12.0) -> HeldMotion:
    """Stop and go: tilts about several axes, each held still for a while; differentiated without error."""
    time = np.arange(0.0, seconds, DT)
    go = np.sin(np.pi * np.clip(time % 3.0, 0.0, 1.5) / 1.5) ** 2 * (not still)
    held = np.floor(time / 3.0)
    axes = np.random.default_rng(1).standard_normal((int(held.max()) + 1, 3))
    tilt = Rotation.from_rotvec(0.5 * axes[held.astype(int)])
    rate = 2.0 * go[:, None] * axes[held.astype(int)]
    alpha = np.gradient(rate, DT, axis=0)
    linear = 1.5 * go[:, None] * np.roll(axes[held.astype(int)], 1, axis=1)
    pull = linear + tilt.inv().apply([0.0, 0.0, GRAVITY])
    exact = HeldMotion(time, pull, rate, alpha, np.zeros((len(time), 6)))
    return replace(exact, wrench=exact.regressor @ whole.vector)


def noisy(exact: HeldMotion, seed: int) -> HeldMotion:
    """What an FT-300S measures of a motion."""
    rng, count = np.random.default_rng(seed), len(exact.time_s)
    white = rng.standard_normal((count, 6)) * [*FT300S.force_noise, *FT300S.torque_noise]
    for t in range(1, count):
        white[t] = FT300S.lag1 * white[t - 1] + np.sqrt(1 - FT300S.lag1**2) * white[t]
    walk = np.cumsum(np.sqrt(DT) * rng.standard_normal((count, 6)), axis=0) * FT300S.drift_std
    return replace(exact, wrench=exact.wrench + white + walk + FT300S.bias_std * rng.standard_normal(6))


def test_the_wrench_is_that_of_point_masses():
    rng = np.random.default_rng(3)
    places, masses = rng.standard_normal((7, 3)), rng.uniform(0.1, 1, 7)
    pull, rate, alpha = rng.standard_normal((3, 2, 3))
    held = HeldMotion(np.arange(2.0), pull, rate, alpha, np.zeros((2, 6)))
    for t in range(2):
        forces = masses[:, None] * (pull[t] + np.cross(alpha[t], places) + np.cross(rate[t], np.cross(rate[t], places)))
        wrench = np.concatenate([forces.sum(axis=0), np.cross(places, forces).sum(axis=0)])
        whole = InertialParameters.of_points(places, masses)
        assert_allclose(held.regressor[t] @ whole.vector, wrench, atol=1e-12)


def test_parameters_go_to_other_axes_as_their_points_do():
    rng = np.random.default_rng(4)
    places, masses = rng.standard_normal((7, 3)), rng.uniform(0.1, 1, 7)
    rotation, origin = Rotation.from_rotvec([0.3, -1.0, 0.5]).as_matrix(), np.array([0.2, 0.1, -0.4])
    whole = InertialParameters.of_points(places, masses)
    moved = InertialParameters.of_points((places - origin) @ rotation, masses)
    assert_allclose(whole.moved(rotation, origin).vector, moved.vector, atol=1e-12)
    assert_allclose(shift_map(origin) @ whole.vector, whole.moved(np.eye(3), origin).vector, atol=1e-12)
    squares = np.einsum("p,pi,pj->ij", masses, np.c_[places, np.ones(7)], np.c_[places, np.ones(7)])
    assert_allclose(pseudo_inertia(whole.vector), squares, atol=1e-12)


def test_without_noise_every_method_finds_the_truth():
    parts, masses, whole = body()
    equations = inertial_equations(motion(whole), IDEAL)
    assert equations.rank == 10 and equations.misfit < 1e-6
    found = least_squares_inertia(equations)
    assert_allclose(found.parameters.vector, whole.vector, atol=1e-9)
    assert found.parameters.consistent and not found.message
    assert_allclose(consistent_inertia(equations).parameters.vector, whole.vector, atol=1e-8)
    still = inertial_equations(motion(whole, still=True), IDEAL, still_only=True)
    by_parts = homogeneous_parts(still, parts)
    assert by_parts.part_mass is not None
    assert_allclose(by_parts.part_mass, masses, atol=1e-9)
    assert_allclose(by_parts.parameters.vector, whole.vector, atol=1e-9)


def test_still_poses_show_mass_and_center_alone_and_the_message_says_so():
    _, _, whole = body()
    found = least_squares_inertia(inertial_equations(motion(whole, still=True), FT300S))
    assert_allclose(found.parameters.mass, whole.mass, atol=0.02)
    assert_allclose(found.parameters.center_of_mass, whole.center_of_mass, atol=0.005)
    assert np.isnan(found.parameters.inertia).any() and "accelerate" in found.message


def test_bounds_alone_limit_what_still_poses_do_not_show():
    _, _, whole = body()
    equations = inertial_equations(noisy(motion(whole, still=True), 0), FT300S)
    within = Ellipsoid.around(np.array([-0.06, -0.06, 0.04]), np.array([0.17, 0.1, 0.16]))
    (low, high), plain = consistent_inertia(equations, within).interval(numbers), least_squares_inertia(equations)
    assert_allclose([low[:4], high[:4]], plain.interval(numbers)[:, :4], rtol=1e-3)
    inertia = np.diag(whole.inertia)
    assert (low[4:] < inertia).all() and (high[4:] > 3 * inertia).all()
    unbounded = consistent_inertia(equations)
    assert np.isnan(unbounded.interval(numbers)[:, 4:]).all() and np.isfinite(unbounded.interval(numbers)[:, 0]).all()
    assert np.isnan(unbounded.parameters.inertia).any() and "accelerate" in unbounded.message


def test_a_payload_of_lifts_without_swings_has_no_inertia():
    lifts = [lifted(OBJECT, Lift(0, hold=1.4, swings=swings)) for swings in (0, 2)]
    still, swung = (Payload.of_lifts(OBJECT.shape, [each]) for each in lifts)
    assert still.undetermined == ["Ixx", "Iyy", "Izz"] and not swung.undetermined
    assert np.isnan(still.parameters.inertia).all() and as_ur(still).count("[") == 1
    low, high = np.diagonal(still.interval("inertia"), axis1=1, axis2=2)
    true = np.diag(swung.parameters.inertia)
    assert (low < true).all() and (true < high).all()


def test_motions_of_one_body_add_up():
    _, _, whole = body()
    one, other = motion(whole), motion(whole, still=True)
    both = joined([inertial_equations(each, FT300S) for each in (one, other)])
    alone = [e.rows.T @ e.rows for e in (inertial_equations(one, FT300S), inertial_equations(other, FT300S))]
    assert_allclose(both.rows.T @ both.rows, sum(alone), rtol=1e-8, atol=1e-6)
    assert_allclose(least_squares_inertia(both).parameters.vector, whole.vector, atol=1e-8)


@pytest.mark.parametrize("rows", [6, 10, 25])
def test_equations_joined_are_those_of_all_rows_at_once(rows):
    rng = np.random.default_rng(rows)
    whole, true = rng.standard_normal((3, rows, 10)), rng.standard_normal(10)
    values = whole @ true + rng.standard_normal((3, rows))
    both = joined([compressed_rows(*each, np.eye(rows)) for each in zip(whole, values, strict=True)])
    once = compressed_rows(whole.reshape(-1, 10), values.ravel(), np.eye(3 * rows))
    assert both.freedom == once.freedom == 3 * rows - 10
    assert both.misfit == pytest.approx(once.misfit)


def test_directions_that_no_motion_shows_say_nothing_of_the_parts():
    parts, _, whole = body()
    still = inertial_equations(noisy(motion(whole, still=True), 0), FT300S, still_only=True)
    unseen = np.linalg.svd(still.rows)[0][:, still.rank :]
    assert unseen.shape[1] == 6
    found = homogeneous_parts(still, parts)
    other = homogeneous_parts(replace(still, values=still.values + 9 * unseen.sum(axis=1)), parts)
    assert other.misfit == pytest.approx(found.misfit) == pytest.approx(1.0, abs=0.7)
    assert found.part_draws is not None and other.part_draws is not None
    assert_allclose(other.part_draws.std(axis=0), found.part_draws.std(axis=0), rtol=1e-6)


def numbers(of: InertialParameters) -> np.ndarray:
    """Mass, center and moments of inertia."""
    return np.concatenate([[of.mass], of.center_of_mass, np.diag(of.inertia)])


def holds(found: InertialEstimate, truth: InertialParameters) -> np.ndarray:
    """True for each number that lies within its interval."""
    low, high = found.interval(numbers)
    return (low <= numbers(truth)) & (numbers(truth) <= high)


@pytest.mark.slow
@pytest.mark.parametrize("method", ["ordinary", "semidefinite", "parts"])
def test_nine_in_ten_intervals_hold(method):
    parts, _, whole = body()
    solve = {"ordinary": least_squares_inertia, "semidefinite": consistent_inertia}.get(
        method, partial(homogeneous_parts, parts=parts)
    )
    exact, hold = motion(whole), []
    for seed in range(12 if method == "semidefinite" else 40):
        found = solve(inertial_equations(noisy(exact, seed), FT300S, still_only=method == "parts"))
        hold.append(holds(found, whole))
        assert found.misfit < (12 if method == "parts" else 1.5)  # that of the parts has one degree of freedom
    assert 0.82 < np.mean(hold) < 0.98


@pytest.mark.slow
def test_intervals_hold_through_the_random_walk_of_a_minute():
    _, _, whole = body()
    exact = motion(whole, seconds=60.0)
    solved = (least_squares_inertia(inertial_equations(noisy(exact, seed), FT300S)) for seed in range(40))
    assert 0.82 < np.mean([holds(found, whole) for found in solved]) < 0.98


@pytest.mark.slow
def test_a_thin_body_in_noise_stays_physical():
    places = np.column_stack([np.linspace(0.0, 0.3, 30), np.zeros(30), np.zeros(30)])
    rod = InertialParameters.of_points(places, np.full(30, 0.01))
    within = Ellipsoid.around(np.array([0.0, -0.005, -0.005]), np.array([0.3, 0.005, 0.005]))
    off = []
    for seed in range(3):
        equations = inertial_equations(noisy(motion(rod), seed), FT300S)
        plain, physical = least_squares_inertia(equations), consistent_inertia(equations, within)
        assert np.linalg.eigvalsh(pseudo_inertia(physical.parameters.vector))[0] > -1e-9
        off.append([np.abs(found.parameters.vector - rod.vector)[4:].max() for found in (physical, plain)])
        assert plain.parameters.consistent or "positive density" in plain.message
    consistent, least_squares = np.mean(off, axis=0)
    assert consistent < least_squares


OBJECT = blocks(["10", "11"], [0.5, 0.1, 0.3])
SHORT = Lift(0, hold=1.4)


def test_without_noise_every_method_finds_the_truth_from_a_lift():
    shape, truth = OBJECT.shape, true_body(OBJECT)
    lifts = [lifted(OBJECT, SHORT), lifted(OBJECT, Lift(1, hold=1.4))]
    for trials in (lifts[:1], lifts):
        equations = lift_equations(shape, trials)
        assert equations.rank == 10 and equations.misfit < 1e-9
        by_parts = homogeneous_parts(equations, column_parts(shape))
        bounded = consistent_inertia(equations, ellipsoid_of(shape))
        for found in (least_squares_inertia(equations), bounded, by_parts):
            assert_allclose(found.parameters.vector, truth.vector, atol=1e-8)
        assert by_parts.part_mass is not None
        assert_allclose(by_parts.part_mass, OBJECT.group_mass, atol=1e-8)
        least, most = part_ranges(equations, *places_of(shape)).T
        assert (least < OBJECT.group_mass).all() and (most > OBJECT.group_mass).all()


def test_columns_weigh_and_turn_as_the_object_does():
    truth = true_body(OBJECT)
    assert truth.mass == pytest.approx(OBJECT.total_mass)
    assert_allclose(truth.center_of_mass[:2], OBJECT.center_of_mass, atol=1e-12)
    assert truth.inertia[2, 2] == pytest.approx(OBJECT.inertia_cm)


def test_a_solid_turns_as_its_box():
    corners = np.array([[x, y, z] for x in (0.1, 0.3) for y in (0.0, 0.05) for z in (0.0, 0.02)])
    squares = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces = [face for a, b, c, d in squares for face in ((a, b, c), (a, c, d))]
    (found,) = solid_parts([Solid(corners, np.array(faces), 0.7)])
    sides = np.array([0.2, 0.05, 0.02]) ** 2
    assert_allclose(found.center_of_mass, [0.2, 0.025, 0.01], atol=1e-12)
    assert_allclose(found.inertia, 0.7 / 12 * np.diag(sides.sum() - sides), atol=1e-12)


@pytest.mark.slow
def test_nine_in_ten_intervals_hold_from_lifts():
    """Bias, noise and an offset in the grip, drawn by their stated standard deviations."""
    rng, truth, hold, inside = np.random.default_rng(0), true_body(OBJECT), [], []
    for seed in range(20):
        offset = rng.standard_normal(3) * [5e-4, 5e-4, 1e-3]
        trial = lifted(OBJECT, SHORT, offset=(offset[0], offset[1], offset[2]), errors=1.0, seed=seed)
        equations = lift_equations(OBJECT.shape, [trial])
        hold.append(holds(least_squares_inertia(equations), truth))
        least, most = part_ranges(equations, *places_of(OBJECT.shape)).T
        inside.append((least <= OBJECT.group_mass) & (OBJECT.group_mass <= most))
    assert 0.82 < np.mean(hold) < 0.98
    assert np.mean(inside) > 0.9


L2 = load_object("L2")
CALIBRATION = Calibration(
    sign=1,
    sensor_in_hand=np.array([1.0, 0.0, 0.0, 0.0]),
    sensor_in_hand_std=np.full(3, 1e-3),
    bias=np.zeros(6),
    bias_std=np.full(6, 0.1),
    mass=1.2,
    mass_std=0.01,
    com=np.array([0.0, 0.01, 0.06]),
    com_std=np.array([0.001, 0.001, 0.002]),
    misfit=1.0,
    poses=12,
)


@pytest.fixture(scope="module")
def lift() -> Trajectory:
    """A lift of L2 as one rigid body, with a perfect sensor."""
    with SimulationRunner(secret="payload") as simulation:
        return simulation.run(Trial(L2, Lift(2), support=RIGID, sensing="ideal"))


def in_sensor(trajectory: Trajectory) -> InertialParameters:
    """True body in the sensor's frame, from the poses as the object lies flat in the hand."""
    flat = np.flatnonzero(trajectory.mask(Phase.SETTLE))[-1]
    axes = rotation_matrix(trajectory.sensor_orientation)[flat].T @ rotation_z(float(trajectory.object_pose[flat, 2]))
    assert trajectory.tool is not None
    place = np.append(trajectory.object_pose[flat, :2], 0.0)
    lever = rotation_matrix(trajectory.sensor_orientation)[flat].T @ (place - trajectory.tcp_position[flat])
    corner = lever + trajectory.tool.tcp
    return true_body(L2).moved(axes.T, -axes.T @ corner)


@pytest.mark.slow
def test_a_lift_gives_the_object_in_the_sensors_frame(lift):
    found, true = Payload.of_lifts(L2.shape, [lift]), in_sensor(lift)
    assert found.parameters.mass == pytest.approx(true.mass, rel=2e-3)
    off = found.parameters.center_of_mass - true.center_of_mass
    assert np.allclose(off[:2], 0, atol=3e-4)
    assert 0 < off[2] < lift.figures["slip_m"] + 3e-4, "the object creeps down between the pads"
    assert np.allclose(found.parameters.inertia, true.inertia, atol=0.1 * true.inertia.max())
    low, high = found.interval("mass")
    assert low <= true.mass <= high and high - low < 0.05 * true.mass
    assert found.parameters.consistent and found.undetermined == []


def test_a_lift_without_a_tare_is_left_out(lift):
    no_tare = replace(lift, phase=np.where(lift.mask(Phase.TARE), Phase.APPROACH, lift.phase))
    found, usual = (Payload.of_lifts(L2.shape, lifts) for lifts in ([no_tare, lift], [lift]))
    assert np.array_equal(found.parameters.vector, usual.parameters.vector)
    assert usual.on_flange(np.eye(3), np.zeros(3)).grasp == "A2"


def by_c1(lift: Trajectory) -> Trajectory:
    """The lift by another grasp."""
    return replace(lift, action=replace(lift.action, grasp=1))


STILL = inertial_equations(motion(body()[2], still=True), IDEAL)
AT_REST = np.zeros((5, 3))
BRIEF = HeldMotion(np.arange(5.0), AT_REST, AT_REST, AT_REST, np.zeros((5, 6)))
ONE_LIFT = "one or more lifts that ended well"


@pytest.mark.parametrize(
    ("call", "field", "said"),
    [
        (lambda _: homogeneous_parts(STILL, [*body()[0], *body(seed=5)[0]]), "parts", "at most 4"),
        (lambda _: inertial_equations(BRIEF, IDEAL), "motion", "5 samples'; allowed: 10 or more in a row$"),
        (lambda _: inertial_equations(BRIEF, IDEAL, still_only=True), "motion", "10 or more in a row, at rest$"),
        (lambda _: homogeneous_parts(STILL, []), "parts", "got 0; allowed: one or more"),
        (lambda _: lift_equations(OBJECT.shape, []), "trajectories", f"no lift.*{ONE_LIFT}"),
        (lambda _: Payload.of_lifts(L2.shape, []), "trajectories", ONE_LIFT),
        (
            lambda lift: Payload.of_lifts(L2.shape, [by_c1(lift), lift]),
            "grasp",
            "None; allowed: C1, A2: a grasp of the",
        ),
        (
            lambda lift: Payload.of_lifts(L2.shape, [lift], grasp="B9"),
            "grasp",
            "'B9'; allowed: A2: a grasp of the lifts",
        ),
    ],
)
def test_wrong_arguments_and_lifts_are_refused(lift, call: Callable[[Trajectory], object], field: str, said: str):
    with pytest.raises(InvalidValueError, match=f"^{field}: .*{said}"):
        call(lift)


@pytest.mark.slow
def test_a_payload_is_of_the_grasp_named(tmp_path, capsys):
    (tmp_path / "trials").mkdir()
    assert "a folder with lifts" in refusal(capsys, "payload", str(tmp_path))
    for grasp in (1, 2):
        put_trial(tmp_path, "L2", Lift(grasp), RIGID, SimulationSettings(grip=GripSettings(mode="weld")))
    assert "--grasp: got None; allowed: " in refusal(capsys, "payload", str(tmp_path))
    for name in ("C1", "A2"):
        main(["payload", str(tmp_path), "--grasp", name])
        assert f"held by grasp {name}" in capsys.readouterr().out


def test_the_tool_is_added(lift):
    alone, both = (Payload.of_lifts(L2.shape, [lift], with_tool=added).parameters for added in (False, True))
    assert lift.tool is not None
    assert both.mass == pytest.approx(alone.mass + lift.tool.mass)
    moment = alone.mass * alone.center_of_mass + lift.tool.mass * lift.tool.com
    assert np.allclose(both.center_of_mass, moment / both.mass)
    assert both.consistent


def test_a_flange_beside_the_sensor():
    body = InertialParameters(2.0, np.array([0.1, 0.0, 0.05]), np.diag([1e-3, 2e-3, 2.5e-3]))
    turned = Payload(body, (body,)).on_flange(rotation_z(np.pi / 2), np.array([0.0, 0.0, 0.02]))
    assert np.allclose(turned.parameters.center_of_mass, [0.0, 0.1, 0.07])
    assert np.allclose(turned.parameters.inertia, np.diag([2e-3, 1e-3, 2.5e-3]))
    assert np.allclose(turned.interval("center_of_mass"), turned.parameters.center_of_mass)


def test_forms_of_controllers():
    inertia = np.array([[4.0, 0.1, 0.2], [0.1, 5.0, 0.3], [0.2, 0.3, 6.0]]) * 1e-3
    body = InertialParameters(1.5, np.array([0.01, 0.02, 0.03]), inertia)
    payload = Payload(body, (body,))
    matrix, center = "[0.004, 0.005, 0.006, 0.0001, 0.0002, 0.0003]", "[0.01, 0.02, 0.03]"
    assert as_ur(payload) == f"set_target_payload(1.5, {center}, {matrix})\n"
    columns = pytest.approx(inertia.flatten(order="F"))
    franka = {"mass": 1.5, "center_of_mass": json.loads(center), "load_inertia": columns}
    assert json.loads(as_franka(payload)) == franka
    assert json.loads(as_kortex(payload)) == {"tool_mass": 1.5, "tool_mass_center": {"x": 0.01, "y": 0.02, "z": 0.03}}
    assert json.loads(as_json(payload))["inertia_90_kg_m2"] == [inertia.tolist()] * 2


def test_a_calibration_shows_no_inertia(tmp_path: Path, capsys):
    save_calibration(tmp_path / "c.toml", CALIBRATION, "7", "today")
    main(["payload", str(tmp_path / "c.toml"), "--format", "json", "--out", str(tmp_path / "p.json")])
    said = capsys.readouterr().out
    assert said.startswith("mass 1.2000 kg [1.18") and "not determined: Ixx, Iyy, Izz" in said
    written = json.loads((tmp_path / "p.json").read_text(encoding="utf-8"))
    assert written["inertia_kg_m2"] == [[None] * 3] * 3
    assert written["center_of_mass_m"] == [0.0, 0.01, 0.06]
    main(["payload", str(tmp_path / "c.toml"), "--format", "ur", "--flange", "0", "0", "0.0127", "0"])
    assert "set_target_payload(1.2, [0, 0.01, 0.0727])\n" in capsys.readouterr().out
