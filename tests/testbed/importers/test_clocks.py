"""Pose and wrench from separate streams: the delay between them is found from accelerated turns, and taken off."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from testbed.actions.accelerate import Accelerate
from testbed.errors import HeftError
from testbed.importers.clocks import LONGEST_DELAY, Delay, pooled_delay
from testbed.importers.importer import delay_of, import_trajectory
from testbed.objects.files import load_object
from testbed.sensing.compensation import compensate
from testbed.sensing.noise import draw_sensing
from testbed.sensing.presets import preset
from testbed.simulation.runner import SimulationRunner
from testbed.trajectory import Phase, Trajectory
from testbed.trial import Trial
from tests.fakes.lab_bench import at_other_rates, mapping_of, write_toml


@pytest.fixture(scope="module")
def turns() -> list[Trajectory]:
    runner = SimulationRunner()
    return [
        compensate(draw_sensing(runner.run_clean(Trial(load_object("L2"), Accelerate(grasp))), preset("ft300s"), grasp))
        for grasp in (1, 3)
    ]


def windows(turn: Trajectory) -> list[dict[str, Any]]:
    """The [[phases]] of a turn."""
    inside = [("tare", turn.phase == Phase.TARE), *(("steady", turn.segment == i) for i in range(8))]
    ends = [(name, np.flatnonzero(which)[[0, -1]] / 100) for name, which in inside]
    return [{"phase": n, "from_s": max(a - 0.005, 0.0), "to_s": b + 0.005} for n, (a, b) in ends]


def written(folder: Path, turns: list[Trajectory], late: float, **sensor: Any) -> Path:
    """Pose and wrench of every turn as two files, the wrench's stamps late and in us; and their mapping."""
    logs = []
    for i, turn in enumerate(turns):
        force, hand = at_other_rates(turn, 125.0, 100.0, seed=i)
        hand.to_csv(folder / f"pose_{i}.csv", index=False)
        force.assign(stamp=1e6 * (force["stamp"] + late)).rename(columns={"stamp": "us"}).to_csv(
            folder / f"ft_{i}.csv", index=False
        )
        logs.append({"file": f"pose_{i}.csv", "sensor_file": f"ft_{i}.csv", "action": turn.action.to_dict()})
        logs[-1]["phases"] = windows(turn)
    mapping = mapping_of(turns[0], action=None, time={"column": "stamp"}, logs=logs)
    mapping["sensor"] |= {"time": {"column": "us", "unit": "us"}} | sensor
    return write_toml(folder / "map.toml", mapping)


@pytest.mark.parametrize("late", [0.0, 0.05])
def test_a_delay_is_found_and_taken_off(turns: list[Trajectory], tmp_path: Path, late: float):
    mapping = written(tmp_path, turns, late)
    found = [delay_of(tmp_path / f"pose_{i}.csv", mapping) for i in range(2)]
    for delay in found:
        assert delay is not None
        assert abs(delay.seconds - late) < 3 * delay.std
        assert delay.std < 0.004
    mean = pooled_delay([delay for delay in found if delay])
    assert mean is not None
    assert abs(mean.seconds - late) < 0.002
    again = import_trajectory(tmp_path / "pose_0.csv", mapping, delay=mean)
    assert again.figures["wrench_delay_s"] == mean.seconds
    assert again.provenance["delay"].endswith("ms late, by accelerated turns; " + "not " * (late == 0) + "taken off")
    turned = again.phase == Phase.STEADY
    there = np.column_stack([np.interp(again.time_s, turns[0].time_s, c) for c in turns[0].sensor_wrench.T])
    off = np.sqrt(np.mean((again.sensor_wrench - there)[turned][:, 5] ** 2))
    assert off < 0.2 * np.std(there[turned][:, 5])


def test_a_delay_can_be_given(turns: list[Trajectory], tmp_path: Path):
    mapping = written(tmp_path, turns[:1], 0.03, delay_s=0.03)
    assert delay_of(tmp_path / "pose_0.csv", mapping) is None
    given = import_trajectory(tmp_path / "pose_0.csv", mapping)
    assert given.provenance["delay"] == "30.0 ms late, as given; taken off"
    none = import_trajectory(tmp_path / "pose_0.csv", written(tmp_path, turns[:1], 0.0, delay_s=0.0))
    assert_allclose(given.sensor_wrench, none.sensor_wrench, atol=1e-9)


def test_other_clocks_are_refused(turns: list[Trajectory], tmp_path: Path):
    far = written(tmp_path, turns[:1], 2 * LONGEST_DELAY)
    with pytest.raises(HeftError, match=r"delay: the wrench is late or early by more than 0.2 s"):
        import_trajectory(tmp_path / "pose_0.csv", far)
    with pytest.raises(HeftError, match=r"have 0.00 s in common"):
        import_trajectory(tmp_path / "pose_0.csv", written(tmp_path, turns[:1], 1e6))
    with pytest.raises(HeftError, match=r"40.0 ms in one turn and .* allowed: the same clocks"):
        pooled_delay([Delay(0.04, 0.002), Delay(0.0, 0.002), Delay(0.001, 0.002)])
    assert pooled_delay([]) is None
