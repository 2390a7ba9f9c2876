"""Running tasks: in this process, on worker processes, or on a Ray cluster. A task that fails comes back as a value."""

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
"""Errors of a full, read-only or broken disk: no fault of the task's, and the next task would meet them too."""


@dataclass(frozen=True)
class Limits:
    """Limits of a task."""

    timeout_s: float = 600.0
    """A task that takes longer has hung. Not held by `inline`."""
    tries: int = 3
    """Number of times that a task is begun whose worker dies or is too slow."""
    memory_gib: float = 4.0
    """Data of one worker, GiB: over three times the 1.2 that `heft run blocks` took at most; imports alone take 0.43.
    Not held by `inline`."""


@dataclass(frozen=True)
class Failure:
    """Reason why a task has no value."""

    reason: str
    """One line."""
    detail: str
    """Traceback, or all that is known."""


class Executor(Protocol):
    """Starts tasks and gives them back as they end, in any order."""

    @property
    def capacity(self) -> int:
        """Tasks in flight that keep every worker busy; more would only take memory."""
        ...

    @property
    def running(self) -> int:
        """Tasks started and not yet given back."""
        ...

    def start(self, label: Any, function: Callable[..., Any], *arguments: Any) -> None:
        """Start a task: a module-level function and its arguments; its value should be small."""
        ...

    def wait(self) -> tuple[Any, Any]:
        """The label and the value, or `Failure`, of a task that has ended.

        Raises:
            OSError: a task could not write: disk full, read-only, broken.
        """
        ...


def work_off(executor: Executor, *sources: Callable[[], bool]) -> None:
    """Keep an executor busy until no source has work left.

    Args:
        executor: to run tasks on; each is started under a function of its value, which is called when it has ended.
        sources: each starts its next task, or does what needs none; False where it has nothing to start. An earlier
            source goes first.
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
    """Every task in this process, when it is started; a task that hangs or crashes takes the run with it."""

    capacity = 1

    def __init__(self) -> None:
        torch.set_num_threads(1)
        self._done: deque[tuple[Any, Any]] = deque()

    @property
    def running(self) -> int:
        """Tasks started and not yet given back."""
        return len(self._done)

    def start(self, label: Any, function: Callable[..., Any], *arguments: Any) -> None:
        """Run a task."""
        self._done.append((label, call(function, *arguments)))

    def wait(self) -> tuple[Any, Any]:
        """Label and value of the oldest task."""
        return given_back(*self._done.popleft())


def call(function: Callable[..., Any], *arguments: Any) -> Any:
    """Run a task where it is: its value, a `Failure` where it raises, or an OSError where the disk is at fault."""
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
    """The pair; what ends the whole run is raised."""
    if isinstance(value, OSError):
        raise value
    return label, value


def set_up_worker(limits: Limits) -> None:
    """One thread a worker, as two workers on two cores must not fight; bounded memory; first to go if that runs out."""
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
    """One worker a core that this process may use."""
    return len(os.sched_getaffinity(0))
