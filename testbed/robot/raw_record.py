"""Raw record of a trial: a text file written during the trial, complete up to a failure."""

from __future__ import annotations

import os
import shutil
from collections.abc import Sequence
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from testbed.robot.camera.interface import SeenFrame
from testbed.robot.interfaces import ArmState, RobotError, WrenchSample

SPACE = 20_000_000
"""Least free space on the disk at the start of a trial [byte]: enough for ten minutes of recording."""
_HEAD = """\
frame,time_s,sequence,fx,fy,fz,tx,ty,tz
state,time_s,q1..q7,qd1..qd7,x,y,z,qw,qx,qy,qz,vx,vy,vz,wx,wy,wz
seen,time_s,x,y,yaw of each part
mark,time_s,phase
end,time_s,status,reason
"""


class RawRecord:
    """Text file with a line for every frame (NaN included), every feedback and the begin of every phase [s, N, N m,
    rad, m]. The first lines name the columns; the last line states status and reason."""

    def __init__(self, folder: Path):
        """Create a file named by the current time.

        Raises:
            RobotError: the folder cannot be written to, or the disk is nearly full.
        """
        self.path = folder / f"{datetime.now(UTC):%Y%m%dT%H%M%S.%f}.csv"
        try:
            folder.mkdir(parents=True, exist_ok=True)
            if (free := shutil.disk_usage(folder).free) < SPACE:
                raise RobotError(f"{folder}: {free / 1e6:.0f} MB free on its disk; allowed: at least {SPACE / 1e6:.0f}")
            self._file = self.path.open("x", encoding="utf-8")
            self._file.write(_HEAD)
            self._file.flush()
        except OSError as error:
            raise RobotError(f"{folder}: the record cannot be written: {error.strerror}") from None

    def frames(self, samples: list[WrenchSample]) -> None:
        """Write new frames.

        Raises:
            RobotError: the disk is full or gone.
        """
        self._write("".join(f"frame,{s.time_s:.6f},{s.sequence},{_numbers(s.wrench)}\n" for s in samples))

    def state(self, state: ArmState) -> None:
        """Write new feedback; raises as `frames`."""
        pose = state.tcp_pose
        parts = (state.joint_position, state.joint_velocity, pose.position, pose.orientation, state.tcp_twist)
        self._write(f"state,{state.time_s:.6f},{_numbers(np.concatenate(parts))}\n")

    def seen(self, frames: Sequence[SeenFrame]) -> None:
        """Write new frames of a camera; raises as `frames`."""
        self._write("".join(f"seen,{f.time_s:.6f},{_numbers(f.poses.ravel())}\n" for f in frames))

    def mark(self, time_s: float, phase: str) -> None:
        """Write the begin of a phase; a failure is raised at the next frame."""
        with suppress(RobotError):
            self._write(f"mark,{time_s:.6f},{phase}\n")

    def end(self, time_s: float, status: str, reason: str) -> None:
        """Write status and reason, and close; on a full disk the lines before them remain."""
        with suppress(RobotError, OSError):
            self._write(f"end,{time_s:.6f},{status},{' '.join(reason.split())}\n")
            os.fsync(self._file.fileno())
        with suppress(OSError):
            self._file.close()

    def _write(self, text: str) -> None:
        try:
            self._file.write(text)
            self._file.flush()
        except OSError as error:
            raise RobotError(f"record {self.path}: cannot be written any more: {error.strerror}") from None


def _numbers(values: np.ndarray) -> str:
    return ",".join(f"{v:.9g}" for v in values.tolist())
