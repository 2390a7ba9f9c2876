"""Tasks on worker processes: spawned, one torch thread each, reusing imports and compiled scenes."""

from __future__ import annotations

import multiprocessing
import os
from collections.abc import Callable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, wait
from contextlib import contextmanager
from typing import Any, Protocol

import torch
from pebble import ProcessPool

TASK_TIMEOUT = 600.0
"""A task that takes longer has hung, s."""


class Submit(Protocol):
    """Starts a task: a module-level function and its arguments."""

    def __call__(self, function: Callable[..., Any], *arguments: Any) -> Future[Any]: ...


@contextmanager
def workers(count: int) -> Iterator[Submit]:
    """`count` worker processes, or none and everything in this process for 0.

    Leaving by an exception, Ctrl-C included, stops the workers; every file they write is whole or absent.
    """
    if count == 0:
        set_up_worker()
        yield _inline
        return
    pool = ProcessPool(max_workers=count, initializer=set_up_worker, context=multiprocessing.get_context("spawn"))
    try:
        yield lambda function, *arguments: pool.schedule(function, args=arguments, timeout=TASK_TIMEOUT)  # pyright: ignore[reportReturnType]
        pool.close()
    except BaseException:
        pool.stop()
        raise
    finally:
        pool.join()


def finished(running: set[Future[Any]]) -> set[Future[Any]]:
    """Wait for at least one task and take out those that are done."""
    done, _ = wait(running, return_when=FIRST_COMPLETED)
    running -= done
    return done


def default_workers() -> int:
    """One worker a core that this process may use."""
    return len(os.sched_getaffinity(0))


def set_up_worker() -> None:
    """One thread a worker: two workers on two cores must not fight."""
    torch.set_num_threads(1)


def _inline(function: Callable[..., Any], *arguments: Any) -> Future[Any]:
    future: Future[Any] = Future()
    try:
        future.set_result(function(*arguments))
    except Exception as error:
        future.set_exception(error)
    return future
