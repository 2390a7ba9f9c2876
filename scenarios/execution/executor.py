"""Interface of executors, and the one that runs tasks in this process. The value of a failed task is a `Failure`."""

from __future__ import annotations

import errno
import os
import resource
import traceback
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal, Protocol

import torch

from testbed.errors import HeftError, one_line
from testbed.files import print_damage_plainly

ExecutorName = Literal["inline", "local", "ray"]
_DISK = {errno.ENOSPC, errno.EDQUOT, errno.EROFS, errno.EACCES, errno.EPERM, errno.EIO}
"""Errors of a full, read-only or broken disk, which the next task would raise too."""


@dataclass(frozen=True)
class Limits:
    """Limits of a task."""

    timeout_s: float = 600.0
    """Time after which a task counts as hung [s]. Ignored by `inline`."""
    tries: int = 3
    """Largest number of attempts at a task whose worker dies or exceeds the time."""
    memory_gib: float = 4.0
    """Data of one worker [GiB]: over three times the 1.2 of `heft run blocks` at most; imports alone take 0.43.
    Ignored by `inline`."""


@dataclass(frozen=True)
class Failure:
    """Reason why a task has no value."""

    reason: str
    """One line."""
    detail: str
    """Traceback, or another description of the failure."""


class Executor(Protocol):
    """Runner of tasks, whose values return as they end, in any order."""

    @property
    def capacity(self) -> int:
        """Number of tasks in flight that keep every worker busy; more would only take memory."""
        ...

    @property
    def running(self) -> int:
        """Number of tasks whose values have not returned."""
        ...

    def start(self, label: Any, function: Callable[..., Any], *arguments: Any) -> None:
        """Start a task: a module-level function and its arguments; its value should be small."""
        ...

    def wait(self) -> tuple[Any, Any]:
        """Label and value, or `Failure`, of a task that has ended.

        Raises:
            OSError: a task could not write: disk full, read-only, broken.
        """
        ...


def work_off(executor: Executor, *sources: Callable[[], bool]) -> None:
    """Keep an executor busy until no source has work left.

    Args:
        executor: executor of the tasks; the label of each task is a function, called with its value at its end.
        sources: functions that start their next task, or do work without one, and return False if there is none. An
            earlier source goes first.
    """
    while True:
        capacity = executor.capacity
        while executor.running < capacity and any(start() for start in sources):
            pass
        if not executor.running:
            return
        take, value = executor.wait()
        take(value)


class InlineExecutor:
    """Tasks in this process, run by `start`; a task that hangs or crashes stops the run."""

    capacity = 1

    def __init__(self) -> None:
        torch.set_num_threads(1)
        self._done: deque[tuple[Any, Any]] = deque()

    @property
    def running(self) -> int:
        """Number of tasks whose values have not returned."""
        return len(self._done)

    def start(self, label: Any, function: Callable[..., Any], *arguments: Any) -> None:
        """Run a task."""
        self._done.append((label, call(function, *arguments)))

    def wait(self) -> tuple[Any, Any]:
        """Label and value of the oldest task."""
        return given_back(*self._done.popleft())


def call(function: Callable[..., Any], *arguments: Any) -> Any:
    """Run a task in this process; return its value, a `Failure` if it raises, or an OSError of the disk."""
    try:
        return function(*arguments)
    except (Exception, SystemExit) as error:
        if isinstance(error, OSError) and error.errno in _DISK:
            return OSError(error.errno, error.strerror, error.filename)
        words = str(error)
        if not isinstance(error, HeftError):
            words = f"{type(error).__name__}: {one_line(words)}".removesuffix(": ")
        return Failure(words, traceback.format_exc())


def given_back(label: Any, value: Any) -> tuple[Any, Any]:
    """Label and value of a task; an OSError ends the run, and is raised."""
    if isinstance(value, OSError):
        raise value
    return label, value


def set_up_worker(limits: Limits) -> None:
    """Limit this worker to one thread and bounded memory; the kernel kills it first if memory runs out."""
    torch.set_num_threads(1)
    print_damage_plainly()
    size = int(limits.memory_gib * 2**30)
    # RLIMIT_AS would count address space that libraries only reserve, and RLIMIT_DATA counts it where it is writable:
    # the allocator of Rerun, and of solvers that mink finds beside its own, reserves a gigabyte each
    os.environ.setdefault("MIMALLOC_ARENA_EAGER_COMMIT", "0")
    resource.setrlimit(resource.RLIMIT_DATA, (size, resource.getrlimit(resource.RLIMIT_DATA)[1]))
    with open("/proc/self/oom_score_adj", "w", encoding="ascii") as file:
        file.write("1000")


def default_workers() -> int:
    """Number of cores that this process may use."""
    return len(os.sched_getaffinity(0))
