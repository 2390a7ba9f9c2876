"""Time as a port: the computer's own, or a simulated bench's that runs faster."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from typing import Protocol, runtime_checkable


@runtime_checkable
class Clock(Protocol):
    """What time it is, waiting, and being called while others wait."""

    def now(self) -> float:
        """s, since any moment; the clock of every `time_s` of the ports."""
        ...

    def sleep(self, seconds: float) -> None:
        """Wait; not at all where `seconds` <= 0."""
        ...

    def every(self, period: float, call: Callable[[], None]) -> AbstractContextManager[None]:
        """While entered, `call` is called every `period` s whatever the caller does, also where it hangs."""
        ...


class MonotonicClock:
    """`time.monotonic`, and a thread for what is called."""

    def now(self) -> float:
        """s."""
        return time.monotonic()

    def sleep(self, seconds: float) -> None:
        """Wait."""
        if seconds > 0:
            time.sleep(seconds)

    @contextmanager
    def every(self, period: float, call: Callable[[], None]) -> Iterator[None]:
        """Call from a daemon thread; a call that is late is made at once, and those that were missed are not."""
        done = threading.Event()

        def run() -> None:
            due = time.monotonic()
            while not done.wait(max(due - time.monotonic(), 0.0)):
                call()
                due = max(due + period, time.monotonic())

        thread = threading.Thread(target=run, name="every", daemon=True)
        thread.start()
        try:
            yield
        finally:
            done.set()
            thread.join(1.0)
