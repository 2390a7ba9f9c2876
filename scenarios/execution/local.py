"""Worker processes on this machine: spawned, reusing what they have imported, replaced when they die or hang."""

from __future__ import annotations

import ctypes
import importlib
import multiprocessing
import os
import signal
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing import resource_tracker
from typing import Any, Self

from pebble import ProcessExpired, ProcessPool

from scenarios.execution.executor import Failure, Limits, call, given_back, set_up_worker
from testbed.errors import HeftError

_PR_SET_PDEATHSIG = 1
"""linux/prctl.h"""
_POLL_S = 1.0
"""Interval of the checks for workers that exited silently [s]."""


@dataclass(eq=False)
class _Task:
    label: Any
    function: Callable[..., Any]
    arguments: tuple[Any, ...]
    tries: int = 0


class LocalExecutor:
    """Tasks on worker processes. A task whose worker dies or is too slow is begun again on a new one."""

    def __init__(self, workers: int, limits: Limits, preload: Sequence[str] = ()):
        self._limits = limits
        self._workers = [_Worker(limits, preload) for _ in range(workers)]
        self._waiting: deque[_Task] = deque()
        self._done: deque[tuple[Any, Any]] = deque()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        for worker in self._workers:
            worker.stop()
        for worker in self._workers:
            worker.join()

    @property
    def capacity(self) -> int:
        """One task running and one waiting for each worker."""
        return 2 * len(self._workers)

    @property
    def running(self) -> int:
        """Number of tasks whose values have not returned."""
        return len(self._waiting) + len(self._done) + sum(worker.task is not None for worker in self._workers)

    def start(self, label: Any, function: Callable[..., Any], *arguments: Any) -> None:
        """Start a task on an idle worker, or queue it."""
        self._waiting.append(_Task(label, function, arguments))
        self._assign()

    def wait(self) -> tuple[Any, Any]:
        """Label and value, or `Failure`, of a task that has ended; its worker has its next task already."""
        while True:
            busy = {worker.future: worker for worker in self._workers if worker.future is not None}
            ended, _ = wait(busy, timeout=0.0 if self._done else _POLL_S, return_when=FIRST_COMPLETED)
            for future, worker in busy.items():
                if future in ended or worker.exited_silently():
                    self._take(worker)
            self._assign()
            if self._done:
                return given_back(*self._done.popleft())

    def _assign(self) -> None:
        for worker in self._workers:
            if self._waiting and worker.task is None:
                worker.give(self._waiting.popleft())

    def _take(self, worker: _Worker) -> None:
        task, ending = worker.take()
        if not isinstance(ending, _Lost):
            self._done.append((task.label, ending))
        elif task.tries < self._limits.tries:
            self._waiting.append(task)
        else:
            times = "once" if task.tries == 1 else f"{task.tries} times"
            reason = f"{ending.why} (tried {times})"
            self._done.append((task.label, Failure(reason, f"{task.function.__name__}: {reason}\n")))


@dataclass(frozen=True)
class _Lost:
    """Task whose worker ended before it did."""

    why: str


class _Worker:
    """Worker process in a pool of its own.

    A killed worker may leave a held lock or half a message, which are discarded with its pool.
    """

    def __init__(self, limits: Limits, preload: Sequence[str]):
        self._limits = limits
        self._preload = preload
        self._pool: ProcessPool | None = None
        self._starts: Any = None
        self.task: _Task | None = None
        self.future: Future[Any] | None = None

    def give(self, task: _Task) -> None:
        """Start a task, on a new process if the last one has died."""
        self.task = task
        task.tries += 1
        cause: Exception | None = None
        for _ in range(2):
            try:
                with _without_interrupts():
                    self.future = self._open().schedule(
                        call, args=(task.function, *task.arguments), timeout=self._limits.timeout_s
                    )
                return
            except RuntimeError as error:  # the pool found its process dead
                cause = error
                self._discard()
        raise HeftError(f"a worker process cannot be started: {cause}")

    def exited_silently(self) -> bool:
        """True if the process exited with code 0 during its task: the pool has started another one."""
        return self._starts is not None and self._starts.value > 1

    def take(self) -> tuple[_Task, Any]:
        """The task that has ended, and its value, a `Failure`, or why it is lost."""
        task, future = self.task, self.future
        assert task is not None and future is not None
        self.task = self.future = None
        if not future.done():
            ending: Any = _Lost("its worker process exited with code 0")
        else:
            error = future.exception()
            if error is None:
                ending = future.result()
            elif isinstance(error, TimeoutError):
                ending = _Lost(f"took longer than {self._limits.timeout_s:g} s")
            elif isinstance(error, ProcessExpired):
                ending = _Lost(f"its worker process {_exit_words(error.exitcode)}")
            elif isinstance(error, BrokenProcessPool):
                ending = _Lost("its worker process died before the task began")
            else:  # arguments or a value that cannot be sent
                ending = Failure(f"{type(error).__name__}: {error}", f"{task.function.__name__}: {error!r}\n")
        if isinstance(ending, _Lost):
            self._discard()
        return task, ending

    def stop(self) -> None:
        """Tell the process to stop; `join` waits for it."""
        if self._pool is not None:
            self._pool.stop()

    def join(self) -> None:
        """Wait until the process is gone."""
        if self._pool is not None:
            self._pool.join()

    def _open(self) -> ProcessPool:
        if self._pool is None:
            context = multiprocessing.get_context("spawn")
            self._starts = context.RawValue(ctypes.c_int, 0)
            self._pool = ProcessPool(
                max_workers=1,
                initializer=_set_up,
                initargs=(os.getpid(), self._limits, self._starts, self._preload),
                context=context,
            )
        return self._pool

    def _discard(self) -> None:
        self.stop()
        self.join()
        self._pool = self._starts = None


def _set_up(parent: int, limits: Limits, starts: Any, preload: Sequence[str]) -> None:
    """Initialize a worker process."""
    # SIGKILL at the end of the parent, for whatever reason: no worker may write into the next run
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
    if os.getppid() != parent:
        os._exit(1)
    starts.value += 1
    set_up_worker(limits)
    for module in preload:
        importlib.import_module(module)


def _exit_words(exitcode: int) -> str:
    if exitcode >= 0:
        return f"exited with code {exitcode}"
    name = signal.Signals(-exitcode).name if -exitcode in {*signal.Signals} else f"signal {-exitcode}"
    return f"was killed by {name}{' (out of memory?)' if -exitcode == signal.SIGKILL else ''}"


@contextmanager
def _without_interrupts() -> Iterator[None]:
    """Block SIGINT: a process started within inherits the mask, and its parent stops it."""
    resource_tracker.ensure_running()  # else its start would unblock SIGINT
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
