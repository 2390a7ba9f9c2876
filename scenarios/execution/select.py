"""Executors by name."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import get_args

from scenarios.execution.executor import Executor, ExecutorName, InlineExecutor, Limits, default_workers
from scenarios.execution.local import LocalExecutor
from scenarios.execution.ray import RayExecutor
from testbed.errors import InvalidValueError


@contextmanager
def open_executor(
    name: str, workers: int | None, limits: Limits | None = None, preload: Sequence[str] = ()
) -> Iterator[Executor]:
    """An executor by name, `local` with 0 workers being `inline`. Leaving it stops its workers.

    Args:
        name: inline, local or ray.
        workers: number of workers; None is one a core.
        limits: limits of a task.
        preload: modules that a local worker imports before the clock of its first task runs.

    Raises:
        InvalidValueError: no such executor, or a number of workers below 0.
        HeftError: Ray is not installed.
    """
    if name not in get_args(ExecutorName):
        raise InvalidValueError("--executor", name, f"one of {', '.join(get_args(ExecutorName))}")
    workers = default_workers() if workers is None else workers
    if workers < 0:
        raise InvalidValueError("--workers", workers, "an integer >= 0")
    limits = limits or Limits()
    if name == "inline" or (name == "local" and workers == 0):
        yield InlineExecutor()
    elif name == "local":
        with LocalExecutor(workers, limits, preload) as executor:
            yield executor
    else:
        with RayExecutor(workers, limits) as executor:
            yield executor
