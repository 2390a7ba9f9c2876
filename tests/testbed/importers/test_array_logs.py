"""Logs in Parquet and HDF5 files, episodes of one table, and constants in place of columns."""

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose

from estimators.testing.recorded import load_block
from testbed.actions.rotate import Rotate
from testbed.errors import HeftError, InvalidValueError
from testbed.importers.importer import import_trajectory
from testbed.importers.logs import LogError
from testbed.importers.mapping import LogMap
from testbed.trajectory import Trajectory
from tests.fakes.lab_bench import columns, entry_of, mapping_of, write_csv, write_toml

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


def as_csv(folder: Path, turn: Trajectory) -> Trajectory:
    folder.mkdir()
    return import_trajectory(write_csv(folder / "log.csv", turn), write_toml(folder / "map.toml", mapping_of(turn)))


def same(found: Trajectory, expected: Trajectory, tolerance: float = 1e-12) -> None:
    for name in ("time_s", "sensor_wrench", "tcp_position", "sensor_orientation"):
        assert_allclose(getattr(found, name), getattr(expected, name), atol=tolerance, err_msg=name)


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


def test_episodes_of_a_parquet_table_are_trials(turns: list[Trajectory], episodes: Path, tmp_path: Path):
    mapping = mapped(turns[0], "observation.wrench", "observation.state", {"column": "timestamp"})
    mapping["logs"] = [
        entry_of(episodes.name, turn) | {"where": {"episode_index": float(k)}} for k, turn in enumerate(turns)
    ]
    path = write_toml(tmp_path / "map.toml", mapping)
    for index, turn in enumerate(turns):
        found = import_trajectory(episodes, path, entry=LogMap.model_validate(mapping["logs"][index]))
        assert found.provenance["stretch"] == f"episode_index {index}"
        same(found, as_csv(tmp_path / str(index), turn), 1e-4)


@pytest.mark.parametrize(
    ("where", "said"),
    [
        ({}, r"time goes back .*it has episodes: allowed: one episode, as where = \{ episode_index = 0 \}"),
        ({"episode_index": 7.0}, r"where.episode_index: got 7.0; allowed: one of 0, 1"),
        ({"episod": 1.0}, r"where: got 'episod'; .*nearest: episode_index"),
    ],
)
def test_an_episode_has_to_be_named(where: dict[str, float], said: str, turns, episodes: Path, tmp_path: Path):
    mapping = mapped(turns[0], "observation.wrench", "observation.state", {"column": "timestamp"}) | {"where": where}
    with pytest.raises(HeftError, match=said):
        import_trajectory(episodes, write_toml(tmp_path / "map.toml", mapping))


def test_hdf5_arrays_have_clocks_of_their_own(turns: list[Trajectory], tmp_path: Path):
    h5py = pytest.importorskip("h5py", reason="needs the extra robot")
    turn, path = turns[0], tmp_path / "log.h5"
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
    found = import_trajectory(path, write_toml(tmp_path / "map.toml", mapping))
    assert found.provenance["recorded"].startswith("2023-11-14T22:13:20")
    expected = as_csv(tmp_path / "csv", turn)
    count = min(len(found.time_s), len(expected.time_s))
    assert_allclose(found.sensor_wrench[:count], expected.sensor_wrench[:count], atol=1e-4)
    mapping["sensor"]["force"][0] = "outside"
    with pytest.raises(InvalidValueError, match="got 'outside'; allowed: one of"):
        import_trajectory(path, write_toml(tmp_path / "map.toml", mapping))
    mapping["sensor"]["force"][0] = "arm/pose.0"
    with pytest.raises(LogError, match=r"columns of unequal length \(ft/stamp_ns \d+, arm/pose.0 \d+"):
        import_trajectory(path, write_toml(tmp_path / "map.toml", mapping))


def test_a_number_in_place_of_a_column_is_a_constant(turns: list[Trajectory], tmp_path: Path):
    turn = turns[0]
    mapping = mapping_of(turn)
    mapping["sensor"]["force"][2] = -0.5
    log = write_csv(tmp_path / "log.csv", turn)
    found = import_trajectory(log, write_toml(tmp_path / "map.toml", mapping))
    expected = as_csv(tmp_path / "csv", turn)
    assert_allclose(found.sensor_wrench[:, 2], 0.5 * 9.80665, atol=1e-9)
    assert_allclose(found.sensor_wrench[:, [0, 1, 3, 4, 5]], expected.sensor_wrench[:, [0, 1, 3, 4, 5]], atol=1e-12)
    mapping["hand"] |= {"position": [0.0, 0.0, 0.0], "orientation": [0.0, 0.0, 0.0, 1.0]}
    with pytest.raises(InvalidValueError, match=r"one column or more beside constants"):
        import_trajectory(log, write_toml(tmp_path / "map.toml", mapping))


@pytest.mark.parametrize("name", ["log.parquet", "log.h5"])
def test_a_file_of_another_kind_is_refused_in_a_line(name: str, turns: list[Trajectory], tmp_path: Path):
    pytest.importorskip("h5py", reason="needs the extra robot")
    (tmp_path / name).write_bytes(b"fx,fy,fz\n1,2,3\n" * 100)
    with pytest.raises(LogError) as refused:
        import_trajectory(tmp_path / name, write_toml(tmp_path / "map.toml", mapping_of(turns[0])))
    assert name in str(refused.value) and "\n" not in str(refused.value)
