"""An executor that keeps the times of its tasks, for benches."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Task:
    """A task that has ended."""

    name: str
    """Name of its function."""
    wall: float
    """Wall time [s]."""
    cpu: float
    """Core-seconds [s]."""
    end: float
    """Time of `time.perf_counter` in the driver as it took the value [s]."""


class Metered:
    """Any executor, which adds its tasks to a list as they end."""

    def __init__(self, executor: Any):
        self._executor = executor
        self.tasks: list[Task] = []

    @property
    def capacity(self) -> int:
        """Same property of the executor."""
        return self._executor.capacity

    @property
    def running(self) -> int:
        """Same property of the executor."""
        return self._executor.running

    def start(self, label: Any, function: Callable[..., Any], *arguments: Any) -> None:
        """Same method of the executor."""
        self._executor.start((label, function.__name__), _timed, function, *arguments)

    def wait(self) -> tuple[Any, Any]:
        """Same method of the executor."""
        (label, name), (value, wall, cpu) = self._executor.wait()
        self.tasks.append(Task(name, wall, cpu, time.perf_counter()))
        return label, value


def _timed(function: Callable[..., Any], *arguments: Any) -> tuple[Any, float, float]:
    """Task: another task's value, wall time and core-seconds."""
    wall, cpu = time.perf_counter(), time.process_time()
    return function(*arguments), time.perf_counter() - wall, time.process_time() - cpu
