"""Every reason for which a whole record is no data, each found alone."""

from dataclasses import replace

import numpy as np
import pytest

from testbed.actions.rotate import Rotate
from testbed.robot.recorder import GripEvidence, Record, doubts
from testbed.trajectory import Phase
from tests.fakes.robot import small_object

PATH = Rotate(0, duration=2.0).tool_path(small_object().shape, np.zeros(3), 0.01)
GOOD = GripEvidence(lost_frames=0, held_width=(0.05, 0.0501), slip=(1e-4, 1e-3))


def record(**changes) -> Record:
    """A tare, a turn under 1 N, a tare, at 100 Hz, with a sensor's noise."""
    tare, turn = 100, len(PATH.segment)
    count = tare + turn + tare
    phase = np.full(count, Phase.TARE)
    phase[tare:-tare] = np.where(PATH.segment >= 0, Phase.STEADY, Phase.RAMP)
    segment = np.full(count, -1)
    segment[tare:-tare] = PATH.segment
    values = {
        "time_s": np.arange(count) / 100,
        "phase": phase,
        "segment": segment,
        "wrench": 0.07 * np.random.default_rng(0).standard_normal((count, 6)) + (phase != Phase.TARE)[:, None],
        "tcp_position": np.zeros((count, 3)),
        "tcp_orientation": np.tile([0.0, 1.0, 0.0, 0.0], (count, 1)),
        "tcp_velocity": np.zeros((count, 6)),
        "joint_position": np.zeros((count, 7)),
        "wrench_gap": 0.01,
        "feedback_gap": 0.01,
    }
    return Record(**{**values, **changes})


def wrench(at: slice, value: np.ndarray | float) -> np.ndarray:
    changed = record().wrench.copy()
    changed[at] = value
    return changed


def test_nothing_speaks_against_a_good_record():
    assert list(doubts(record(), GOOD, PATH)) == []
    assert list(doubts(record(), replace(GOOD, slip=None), None)) == []


@pytest.mark.parametrize(
    ("changes", "evidence", "status", "said"),
    [
        ({}, {"held_width": (0.05, 0.047)}, "slipped", "opening changed by 3.0 mm"),
        ({}, {"slip": (0.004, 0.0)}, "slipped", "moved 4.0 mm and 0.00 deg in the grip"),
        ({}, {"slip": (0.0, 0.03)}, "slipped", "1.72 deg"),
        ({}, {"slip": (np.nan, 0.0)}, "slipped", "nan"),
        ({}, {"lost_frames": 10}, "fault", "10 of "),
        ({"wrench_gap": 0.06}, {}, "fault", "sensor: silent for 60 ms"),
        ({"feedback_gap": 0.09}, {}, "fault", "arm: silent for 90 ms"),
        ({"wrench": wrench(slice(0, 50), 3 + np.arange(50)[:, None] * 1e-3)}, {}, "fault", "tare: the force scattered"),
        (
            {"wrench": wrench(slice(-40, -1), 3 + np.arange(39)[:, None] * 1e-3)},
            {},
            "fault",
            "tare: the force scattered",
        ),
        ({"segment": np.where(np.arange(480) % 9 == 0, -1, record().segment)}, {}, "fault", "of steady stretch 0"),
    ],
)
def test_each_reason_is_found_alone(changes, evidence, status, said):
    found = list(doubts(record(**changes), replace(GOOD, **evidence), PATH))
    assert [f[0] for f in found] == [status]
    assert said in found[0][1]


@pytest.mark.parametrize("scale", [0.0, 1e-3, 1.0], ids=["frozen", "quiet", "noise"])
def test_a_sensor_that_feels_nothing_of_the_motion_is_dead(scale):
    felt = scale * 0.07 * np.random.default_rng(0).standard_normal((480, 6)) + [3.3, -2.1, 9.2, 0.11, -0.21, 0.31]
    (found,) = doubts(record(wrench=felt), GOOD, PATH)
    assert found[0] == "fault" and "the sensor feels nothing" in found[1]


def test_a_zero_that_has_moved_between_the_tares_is_no_scatter_of_either():
    assert list(doubts(record(wrench=record().wrench + np.linspace(0, 5, 480)[:, None] ** 3 / 400), GOOD, PATH)) == []
