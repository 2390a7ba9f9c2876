"""Methods and tasks that do what they should not: for tests of the runs around them."""

import os
import signal
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from estimators.base import Estimate
from testbed import MassDistribution, ObjectShape, Trajectory


@dataclass(frozen=True)
class Misbehaving:
    """A method that raises, hangs, exits, crashes, answers NaN or eats memory."""

    way: str = "raise"

    def estimate(
        self, shape: ObjectShape, weight: float | None, trajectories: Sequence[Trajectory], seed: int
    ) -> Estimate:
        """Misbehave."""
        misbehave(self.way)
        mass = np.full(shape.n_m, np.nan)
        return Estimate(MassDistribution(mass, np.full(shape.n_mu, 0.5)), "ok")


def misbehave(way: str) -> str:
    """Task that fails in the named way; "nan" and "well" return."""
    match way:
        case "raise":
            raise RuntimeError("out of ideas")
        case "hang":
            time.sleep(3600)
        case "exit":
            sys.exit(3)
        case "leave":
            os._exit(0)
        case "crash":
            os.kill(os.getpid(), signal.SIGSEGV)
        case "eat":
            held = []
            while True:
                held.append(np.empty(2**24))
    return way


def crash_once(marker: str) -> str:
    """Task: crashes where the marker is not there yet."""
    if not Path(marker).exists():
        Path(marker).touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return "well"


def who() -> tuple[int, int]:
    """Task: the process it runs in, and torch's threads there."""
    import torch  # noqa: PLC0415

    return os.getpid(), torch.get_num_threads()


def write(path: str) -> None:
    """Task: writes to a disk that is full or read-only."""
    Path(path).write_text("x" * 2**22, encoding="utf-8")
