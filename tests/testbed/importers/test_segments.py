"""Segments of long logs, and episodes of arrays."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from estimators.hidden_states.estimator import HiddenStates
from estimators.testing.recorded import load_block
from testbed import Accelerate, HeftError, InvalidValueError, Phase, Rotate, Slide, Trajectory, steady_windows
from testbed.importers.logs import LogError
from testbed.importers.mapping import LogMap, PhaseWindow
from testbed.importers.phases import linear_stretches, phases_from_motion, phases_from_windows
from testbed.importers.segments import Segment, find_segments
from tests.fakes.lab_bench import columns, entry_of, import_csv, imported, mapping_of, strung, write_csv, write_toml
from tests.helpers.records import series_of

BLOCK = load_block("L2-own_weight")
SHAPE = BLOCK.model.shape
NOISE = 1e-5
"""Standard deviation of the logged position [m]."""


@pytest.fixture(scope="module")
def trials() -> list[Trajectory]:
    return BLOCK.trials("ft300s")


def slid(turn: Trajectory) -> Trajectory:
    """A turn's record with a straight motion in its place, from its first steady sample to its last, at 20 mm/s."""
    index, (first, last) = np.arange(len(turn.time_s)), np.flatnonzero(turn.segment >= 0)[[0, -1]]
    way = np.cumsum(0.02 * np.interp(index, [first - 40, first, last, last + 40], [0, 1, 1, 0])) / 100
    still = np.argmax(turn.phase >= Phase.GRASP)
    along = np.column_stack([way - way[still], 0 * way, 0 * way])
    level = turn.tcp_position[still] * [1, 1, 0] + turn.tcp_position * [0, 0, 1]
    pose = turn.object_pose[still] + along
    return replace(
        turn,
        action=Slide(turn.action.grasp or 0, 0.0, 0.02),
        tcp_position=level + along,
        sensor_orientation=np.repeat(turn.sensor_orientation[still : still + 1], len(way), axis=0),
        object_pose=pose,
    )


def written(folder: Path, recording: Trajectory) -> tuple[Path, Path]:
    """A recording and its mapping, without an action."""
    log = write_csv(folder / "log.csv", recording)
    return log, write_toml(folder / "map.toml", mapping_of(recording, action=None, joints=None))


@pytest.fixture(scope="module")
def found(trials: list[Trajectory], tmp_path_factory: pytest.TempPathFactory) -> list[Segment]:
    """Segments of a recording of a turn with an empty hand, and of four actions."""
    empty = replace(trials[4], sensor_wrench=np.repeat(trials[4].sensor_wrench[:1], len(trials[4].time_s), axis=0))
    recording = strung([trials[0], empty, trials[3], slid(trials[5]), trials[6]], NOISE)
    return find_segments(*written(tmp_path_factory.mktemp("long"), recording))


def test_actions_come_back(found: list[Segment], trials: list[Trajectory]):
    actions = [segment for segment in found if segment.action]
    assert [segment.kind for segment in actions] == ["accelerated turn", "turn", "slide", "turn"]
    names = [grasp.name for grasp in SHAPE.grasps]
    assert [segment.grasps for segment in actions] == [(names[i],) for i in (1, 4, 1, 0)]
    accelerated, turn, slide, last = (segment.action for segment in actions)
    assert isinstance(accelerated, Accelerate)
    assert_allclose(accelerated.accelerations, trials[0].action.to_dict()["accelerations"], atol=0.1)
    assert accelerated.hold == 0.6
    for action, trial in ((turn, trials[3]), (last, trials[6])):
        asked = trial.action
        assert isinstance(action, Rotate) and isinstance(asked, Rotate) and action.back
        assert_allclose([action.speed, action.duration], [asked.speed, asked.duration], rtol=0.05)
        assert action.pivot is not None and asked.pivot is not None
        assert_allclose(action.pivot, asked.pivot, atol=1e-3)
    assert isinstance(slide, Slide)
    yaw = float(trials[5].object_pose[np.argmax(trials[5].phase >= Phase.GRASP), 2])
    assert_allclose([slide.speed, slide.grasp, slide.direction], [0.02, 1, -yaw], rtol=0.05)


def test_stretches_come_back(found: list[Segment], trials: list[Trajectory]):
    begins = np.cumsum([0, *(len(t.time_s) + 350 for t in (trials[0], trials[4], trials[3], trials[5]))]) / 100
    actions = [segment for segment in found if segment.action]
    for segment, begin, i in zip(actions, begins[[0, 2, 3, 4]], (0, 3, 5, 6), strict=True):
        trial = trials[i]
        steady = np.flatnonzero(trial.segment >= 0)[[0, -1]] / 100 + begin
        assert_allclose([segment.steady[0][0], segment.steady[-1][1]], steady, atol=0.2)
        assert segment.tare is not None
        assert_allclose(segment.tare, np.array([0.0, 0.45]) + begin, atol=0.1)
    (empty,) = [segment for segment in found if segment.kind == "empty hand" and segment.to_s - segment.from_s > 3][:1]
    assert begins[1] < empty.from_s < empty.to_s < begins[2]
    assert sum(segment.kind == "tare" for segment in found) == 5


def test_a_stated_delay_of_the_wrench_is_taken_off(trials: list[Trajectory], tmp_path: Path):
    recording = strung([trials[3], trials[6]], NOISE)
    before = np.maximum(np.arange(len(recording.time_s)) - 800, 0)
    log, mapping = written(tmp_path, replace(recording, sensor_wrench=recording.sensor_wrench[before]))
    assert not any(segment.kind == "turn" and segment.to_s < 14 for segment in find_segments(log, mapping))
    mapping.write_text(mapping.read_text("utf-8").replace("[sensor]", "[sensor]\ndelay_s = 8.0"), encoding="utf-8")
    assert any(segment.kind == "turn" and segment.to_s < 14 for segment in find_segments(log, mapping))


def test_one_grasp_may_hold_for_two_actions(trials: list[Trajectory], tmp_path: Path):
    """The second has the tare of the first, and its own phases."""
    turn = trials[3]
    both = series_of(turn, np.append(np.arange(len(turn.time_s)), np.flatnonzero(turn.phase > Phase.GRASP)))
    both["time_s"] = np.arange(len(both["time_s"])) / 100
    log, mapping = written(tmp_path, replace(turn, **both))
    first, second = [segment for segment in find_segments(log, mapping, ["A4"]) if segment.action]
    assert (first.alone, second.alone) == (True, False)
    assert first.tare == second.tare
    assert first.trial[1] < second.steady[0][0]
    assert first.grasps == second.grasps == ("A4",)


@pytest.mark.slow
def test_a_hand_turned_round_is_noticed(trials: list[Trajectory], tmp_path: Path):
    """Its pads are the same, its axes the other way: the log's own closing direction puts the object where it was."""
    turn = trials[3]
    sensor = Rotation.from_quat(turn.sensor_orientation, scalar_first=True)
    other = Rotation.from_euler("z", np.pi) * sensor
    parts = [
        (other.inv() * sensor).apply(np.array(turn.sensor_wrench[:, columns])) for columns in (slice(3), slice(3, 6))
    ]
    around = replace(turn, sensor_orientation=other.as_quat(scalar_first=True), sensor_wrench=np.hstack(parts))
    log, mapping = written(tmp_path, strung([trials[0], around]))
    _, segment = [segment for segment in find_segments(log, mapping, ["C1"]) if segment.action]
    assert segment.flipped and segment.grasps == ("A4",)
    assert isinstance(segment.action, Rotate) and isinstance(turn.action, Rotate)
    assert_allclose(segment.action.center(SHAPE), turn.action.center(SHAPE), atol=1e-3)
    table = mapping_of(strung([trials[0]]), action=segment.action.to_dict(), joints=None)
    begin, end = segment.trial
    closing = table["hand"]["closing_deg"] + 180
    entry = LogMap(file="log.csv", from_s=begin, to_s=end, closing_deg=closing)
    again, alone = imported(log, table, entry=entry), imported(write_csv(tmp_path / "one.csv", turn), table)
    for one, two in zip(steady_windows(again), steady_windows(alone), strict=True):
        assert_allclose(one.wrench[[0, 1, 5]], two.wrench[[0, 1, 5]], atol=0.02 * float(np.linalg.norm(two.wrench[:2])))


def test_a_grasp_that_cannot_be_told_is_left_open(trials: list[Trajectory], tmp_path: Path):
    log, mapping = written(tmp_path, trials[3])
    (turn,) = [segment for segment in find_segments(log, mapping) if segment.action]
    assert turn.grasps == ("B1", "C1", "A2", "A3", "A4")
    with pytest.raises(InvalidValueError, match=r"--grasps: got 'A5'; allowed: some of B1, .*nearest: A"):
        find_segments(log, mapping, ["A5"])
    read = np.full_like(trials[3].sensor_wrench, 0.1)
    with pytest.raises(HeftError, match=r"log\.csv: sensor: fx is -0\.1 in all samples"):
        find_segments(*written(tmp_path, replace(trials[3], sensor_wrench=read)))
    none = replace(trials[3], sensor_wrench=read + np.random.default_rng(0).normal(0.0, 0.01, read.shape))
    with pytest.raises(HeftError, match=r"log\.csv: no motion of the object was found"):
        find_segments(*written(tmp_path, none))


def test_knots_of_a_speed_are_found():
    slopes, holds = np.array([0.4, 0.0, 1.0, -1.0, 0.5, -0.3, -1.1]), np.array([0.4, 0.3, 0.6, 0.6, 0.8, 0.4, 0.4])
    time = np.arange(round(holds.sum() * 100)) / 100
    knots = np.concatenate([[0.0], np.cumsum(holds)])
    rate = np.interp(time, knots, np.concatenate([[0.0], np.cumsum(slopes * holds)]))
    found = linear_stretches(rate + 0.005 * np.random.default_rng(0).standard_normal(len(time)))
    assert_allclose([slope for slope, _ in found], slopes[2:-1], atol=0.06)
    assert_allclose([place[0] / 100 for _, place in found], knots[2:-2], atol=0.04)


@pytest.mark.slow
def test_a_recording_estimates_as_its_logs_alone(trials: list[Trajectory], tmp_path: Path):
    chosen = [t for t in trials if not t.action.accelerated]
    log, mapping = written(tmp_path, strung(chosen, NOISE))
    named = [s for s in find_segments(log, mapping) if s.action]
    entries = [LogMap(file="log.csv", from_s=s.trial[0], to_s=s.trial[1]) for s in named]
    together, apart = [], []
    for segment, entry, trial in zip(named, entries, chosen, strict=True):
        assert segment.action is not None
        asked = mapping_of(trial, action=segment.action.to_dict(), joints=None)
        together.append(imported(log, asked, entry=entry))
        apart.append(imported(write_csv(tmp_path / "one.csv", trial), mapping_of(trial, joints=None)))
    answers = [HiddenStates().estimate(SHAPE, BLOCK.model.total_mass, t, seed=0) for t in (together, apart)]
    masses = [answer.distribution.mass for answer in answers if answer.distribution]
    assert answers[1].covariance is not None
    error = np.sqrt(np.diag(answers[1].covariance))
    assert (np.abs(masses[0] - masses[1]) < 0.5 * error).all()


@pytest.mark.slow
@pytest.mark.parametrize("name", ["L2", "T", "F1", "drawn_b", "drawn_c"])
def test_actions_of_known_blocks_come_back(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """From a pose with an error of 0.1 mm and 0.3 mrad; where several grasps fit, the right one is among them."""
    known = load_block(f"{name}-own_weight")
    trials = known.trials("ft300s", 1)
    recording = strung(trials, 1e-4)
    shake = Rotation.from_rotvec(3e-4 * np.random.default_rng(2).standard_normal((len(recording.time_s), 3)))
    sensor = shake * Rotation.from_quat(recording.sensor_orientation, scalar_first=True)
    log, mapping = written(tmp_path, replace(recording, sensor_orientation=sensor.as_quat(scalar_first=True)))
    monkeypatch.setattr("testbed.importers.segments.object_of", lambda *_: known.model)
    found = [segment for segment in find_segments(log, mapping) if segment.action]
    assert [segment.action.kind for segment in found if segment.action] == [trial.action.kind for trial in trials]
    for segment, trial in zip(found, trials, strict=True):
        assert known.model.shape.grasps[trial.action.grasp or 0].name in segment.grasps
        if isinstance(trial.action, Rotate) and isinstance(segment.action, Rotate):
            assert_allclose(segment.action.speed, trial.action.speed, rtol=0.03)
            assert segment.action.back
        if len(segment.grasps) == 1 and isinstance(segment.action, Rotate) and isinstance(trial.action, Rotate):
            assert_allclose(segment.action.center(known.model.shape), trial.action.center(known.model.shape), atol=2e-3)


def test_a_zeroed_sensor_is_not_zeroed_again_after_the_motion():
    """A rest above the table that follows the motion is a tare only where one precedes it."""
    height, speed = np.zeros(600), np.zeros((600, 6))
    speed[50:450, 0], height[500:] = 0.02, 0.05
    slide = Slide(0, 0.0, 0.02, 3.9)
    phase, segment = phases_from_motion(slide, height, speed, zeroed=True)
    assert (segment >= 0).any() and not (phase == Phase.TARE).any()
    begun = np.pad(height, (100, 0), constant_values=0.05)
    phase, _ = phases_from_motion(slide, begun, np.pad(speed, ((100, 0), (0, 0))), zeroed=True)
    assert (phase[:100] == Phase.TARE).any() and (phase[600:] == Phase.TARE).any()
    time = np.arange(600) / 100
    mapped = [PhaseWindow(phase="steady", from_s=0.5, to_s=4.5), PhaseWindow(phase="tare", from_s=5.0, to_s=5.9)]
    phase, _ = phases_from_windows(mapped, time, zeroed=True)
    assert not (phase == Phase.TARE).any()
    early = PhaseWindow(phase="tare", from_s=0.0, to_s=0.4)
    phase, _ = phases_from_windows([early, *mapped], time, zeroed=True)
    assert (phase == Phase.TARE).sum() == 40 + 90
    with pytest.raises(LogError, match=r"tare at 0 to 0\.05 s; allowed: 0\.3 s or more"):
        phases_from_windows([early.model_copy(update={"to_s": 0.05}), *mapped], time)


WRENCH, POSE = [f"{kind}{a}" for kind in "ft" for a in "xyz"], ["px", "py", "pz", "qx", "qy", "qz", "qw"]


@pytest.fixture(scope="module")
def turns() -> list[Trajectory]:
    """Two recorded turns."""
    return [t for t in load_block("L2-own_weight").trials("ft300s") if isinstance(t.action, Rotate)][:2]


def mapped(turn: Trajectory, wrench: str, pose: str, time: dict[str, Any]) -> dict[str, Any]:
    """Mapping of arrays: items of `wrench` and `pose`."""
    plain = mapping_of(turn, time=time, joints=None)
    plain["sensor"] |= {"force": [f"{wrench}.{i}" for i in range(3)], "torque": [f"{wrench}.{i}" for i in range(3, 6)]}
    plain["hand"]["position"] = [f"{pose}.{i}" for i in range(3)]
    plain["hand"]["orientation"] = [f"{pose}.{i}" for i in range(3, 7)]
    return plain


@pytest.fixture(scope="module")
def from_csv(turns: list[Trajectory], tmp_path_factory: pytest.TempPathFactory) -> list[Trajectory]:
    """The turns, written as CSV and imported."""
    return [import_csv(tmp_path_factory.mktemp("csv"), turn) for turn in turns]


@pytest.fixture
def episodes(turns: list[Trajectory], tmp_path: Path) -> Path:
    """Turns as episodes of a table, as LeRobot writes them: columns of lists, stamps from 0 in each."""
    parts = []
    for index, turn in enumerate(turns):
        cells = columns(turn)
        lists = {
            "observation.wrench": list(np.column_stack([cells[name] for name in WRENCH])),
            "observation.state": list(np.column_stack([cells[name] for name in POSE])),
        }
        parts.append(pd.DataFrame(lists | {"timestamp": turn.time_s, "episode_index": index, "task": "turn it"}))
    pd.concat(parts).to_parquet(tmp_path / "file-000.parquet")
    return tmp_path / "file-000.parquet"


def test_episodes_of_a_parquet_table_are_trials(turns: list[Trajectory], from_csv: list[Trajectory], episodes: Path):
    mapping = mapped(turns[0], "observation.wrench", "observation.state", {"column": "timestamp"})
    mapping["logs"] = [
        entry_of(episodes.name, turn) | {"where": {"episode_index": float(k)}} for k, turn in enumerate(turns)
    ]
    for index, expected in enumerate(from_csv):
        found = imported(episodes, mapping, entry=LogMap.model_validate(mapping["logs"][index]))
        assert found.provenance["stretch"] == f"episode_index {index}"
        for name in ("time_s", "sensor_wrench", "tcp_position", "sensor_orientation"):
            assert_allclose(getattr(found, name), getattr(expected, name), atol=1e-4, err_msg=name)


@pytest.mark.parametrize(
    ("where", "said"),
    [
        ({}, r"time goes back .*it has episodes: allowed: one episode, as where = \{ episode_index = 0 \}"),
        ({"episode_index": 7.0}, r"where.episode_index: got 7.0; allowed: one of 0, 1"),
        ({"episod": 1.0}, r"where: got 'episod'; .*nearest: episode_index"),
    ],
)
def test_an_episode_has_to_be_named(where: dict[str, float], said: str, turns: list[Trajectory], episodes: Path):
    mapping = mapped(turns[0], "observation.wrench", "observation.state", {"column": "timestamp"}) | {"where": where}
    with pytest.raises(HeftError, match=said):
        imported(episodes, mapping)


def test_hdf5_arrays_have_clocks_of_their_own(turns: list[Trajectory], from_csv: list[Trajectory], tmp_path: Path):
    h5py = pytest.importorskip("h5py", reason="needs the extra robot")
    turn, expected, path = turns[0], from_csv[0], tmp_path / "log.h5"
    cells, stamps = columns(turn), 17 * 10**17 + np.round(1e9 * turn.time_s).astype(np.int64)
    with h5py.File(path, "w") as file:
        file["arm/pose"] = np.column_stack([cells[name] for name in POSE])[::2]
        file["arm/stamp_ns"] = stamps[::2]
        file["ft/wrench"] = np.column_stack([cells[name] for name in WRENCH])
        file["ft/stamp_ns"] = stamps
        file["ft/images"] = np.zeros((2, 3, 4))
        outside = h5py.VirtualLayout(shape=(3,), dtype=float)
        outside[:] = h5py.VirtualSource(tmp_path / "other.h5", "x", shape=(3,))
        file.create_virtual_dataset("outside", outside)
    mapping = mapped(turn, "ft/wrench", "arm/pose", {"column": "arm/stamp_ns", "unit": "ns"})
    mapping["sensor"]["time"] = {"column": "ft/stamp_ns", "unit": "ns"}
    found = imported(path, mapping)
    assert found.provenance["recorded"].startswith("2023-11-14T22:13:20")
    count = min(len(found.time_s), len(expected.time_s))
    assert_allclose(found.sensor_wrench[:count], expected.sensor_wrench[:count], atol=1e-4)
    mapping["sensor"]["force"][0] = "outside"
    with pytest.raises(InvalidValueError, match="got 'outside'; allowed: one of"):
        imported(path, mapping)
    mapping["sensor"]["force"][0] = "arm/pose.0"
    with pytest.raises(LogError, match=r"columns of unequal length \(ft/stamp_ns \d+, arm/pose.0 \d+"):
        imported(path, mapping)


def test_a_number_in_place_of_a_column_is_a_constant(
    turns: list[Trajectory], from_csv: list[Trajectory], tmp_path: Path
):
    mapping, log, expected = mapping_of(turns[0]), write_csv(tmp_path / "log.csv", turns[0]), from_csv[0]
    mapping["sensor"]["force"][2] = -0.5
    found = imported(log, mapping)
    assert_allclose(found.sensor_wrench[:, 2], 0.5 * 9.80665, atol=1e-9)
    assert_allclose(found.sensor_wrench[:, [0, 1, 3, 4, 5]], expected.sensor_wrench[:, [0, 1, 3, 4, 5]], atol=1e-12)
    mapping["hand"] |= {"position": [0.0, 0.0, 0.0], "orientation": [0.0, 0.0, 0.0, 1.0]}
    with pytest.raises(InvalidValueError, match=r"one column or more beside constants"):
        imported(log, mapping)


@pytest.mark.parametrize("name", ["log.parquet", "log.h5"])
def test_a_file_of_another_kind_is_refused_in_a_line(name: str, turns: list[Trajectory], tmp_path: Path):
    pytest.importorskip("h5py", reason="needs the extra robot")
    (tmp_path / name).write_bytes(b"fx,fy,fz\n1,2,3\n" * 100)
    with pytest.raises(LogError) as refused:
        imported(tmp_path / name, mapping_of(turns[0]))
    assert name in str(refused.value) and "\n" not in str(refused.value)
