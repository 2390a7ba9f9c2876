"""The stand-by: a process with a connection of its own, which stops the arm if the Kortex process fails.

The Kortex process writes a beat into a pipe with each feedback. The stand-by takes over if that pipe closes without a
goodbye, or if beats are missing while the arm is engaged. Written for Python 3.8.
"""

from __future__ import annotations

import os
import select
import signal
import sys
import threading
import time
from contextlib import suppress
from typing import Any

from testbed.robot.kinova.connection import Configuration, Connection, said

_ENGAGED, _IDLE, _BYE = b"!", b".", b"q"
_STEP = 0.01
"""Time between reports of the stand-by [s]."""
_KEEP_ALIVE = 0.04
"""Time between calls over its connection [s]."""
_IDLE_TIME = 2.0
"""Silence of its connection that the arm tolerates [s]: a short pause of the stand-by must not stop the arm."""
_FAREWELL = 1.0
"""Longest time from the end of heft to the goodbye [s]."""
_RETRY_TIME = 600.0
"""Time over which attempts to stop the arm are repeated [s]."""
_AGAIN = 0.1
"""Time to the second stop [s], which ends a command that was in transit at the first."""


class Beats:
    """Writing end of the pipe. It never blocks: if the stand-by is frozen, beats that do not fit are dropped."""

    def __init__(self, pipe: int):
        os.set_blocking(pipe, False)
        self._pipe, self._lock = pipe, threading.Lock()
        self.engaged = False
        """True from the first motion until a stop, while beats are required."""

    def engage(self, engaged: bool) -> None:
        """Send a beat with a new state; called before the first command that moves the arm."""
        with self._lock:
            self.engaged = engaged
            self._write(_ENGAGED if engaged else _IDLE)

    def beat(self) -> None:
        """Send a beat; called at each feedback."""
        with self._lock:
            self._write(_ENGAGED if self.engaged else _IDLE)

    def bye(self) -> None:
        """Send the goodbye: the arm has been stopped, and no more commands will follow."""
        with self._lock:
            self._write(_BYE)

    def end(self) -> None:
        """Close the pipe; without a goodbye the stand-by takes over."""
        with self._lock:
            if self._pipe >= 0:
                os.close(self._pipe)
            self._pipe = -1

    def _write(self, beat: bytes) -> None:
        with suppress(OSError):  # full, or the stand-by has ended, which heft detects
            if self._pipe >= 0:
                os.write(self._pipe, beat)


class StandBy:
    """Stand-by with an open connection, whose state it reports every 10 ms."""

    def __init__(self, configuration: Configuration, line: Any, beats: int, mover: int):
        """Connect.

        Args:
            configuration: address of the arm, and time limits.
            line: output to heft.
            beats: reading end of the pipe of beats.
            mover: id of the Kortex process, which moves the arm.

        Raises:
            ImportError: no `kortex_api`.
            Exception: any error of the API.
        """
        self._configuration, self._line, self._beats, self._mover = configuration, line, beats, mover
        self._parent = os.getppid()
        self._trouble = ""
        self._over = threading.Event()
        self._connection = self._connected()
        threading.Thread(target=self._keep, name="keep", daemon=True).start()

    def run(self) -> None:
        """Watch until the goodbye, or stop the arm."""
        why = self._watched()
        self._over.set()
        if why:
            self._take_over(why)
        self._connection.close()

    def _watched(self) -> str:
        """Reason to stop the arm; empty after a goodbye."""
        quiet = farewell = 0.0
        engaged = alone = False
        heft, before = sys.stdin.fileno(), time.monotonic()
        while True:
            ready = select.select([self._beats] if alone else [self._beats, heft], [], [], _STEP)[0]
            now = time.monotonic()
            step, before = min(now - before, 2 * _STEP), now  # a pause of this process is not counted
            alone = alone or heft in ready or os.getppid() != self._parent
            quiet, farewell = quiet + step, farewell + step * alone
            if self._beats in ready:
                got = os.read(self._beats, 4096)
                if _BYE in got:
                    return ""
                if not got:
                    return "the process that speaks to it has ended"
                quiet, engaged = 0.0, got.endswith(_ENGAGED)
            if (engaged and quiet > self._configuration.quiet) or farewell > _FAREWELL:
                with suppress(OSError):
                    # so that it cannot resume; its open pipe shows that the id is still its own
                    os.kill(self._mover, signal.SIGKILL)
                return f"the process that speaks to it passed on no feedback for {quiet * 1e3:.0f} ms"
            self._line.offer(standby=self._trouble)

    def _take_over(self, why: str) -> None:
        """Stop the arm twice; reconnect and retry on failure, for up to `_RETRY_TIME`."""
        self._line.say(takes_over=f"{why}; the stand-by stops the arm")
        until, stops = time.monotonic() + _RETRY_TIME, 0
        while time.monotonic() < until:
            try:
                self._connection.stop()
            except Exception as error:  # the API raises any type
                self._line.offer(takes_over=f"{why}; the stand-by cannot stop the arm yet: {said(error)}")
                self._reconnect()
                continue
            stops += 1
            if stops > 1:
                return
            self._line.say(takes_over=f"{why}; the stand-by has stopped the arm")
            time.sleep(_AGAIN)
        self._line.say(takes_over=f"{why}; the stand-by could not stop the arm in {_RETRY_TIME:.0f} s")

    def _keep(self) -> None:
        """Thread: keep the connection alive, and reconnect if it breaks."""
        while not self._over.wait(_KEEP_ALIVE):
            try:
                self._connection.cyclic.RefreshFeedback(0, self._connection.options())
                self._trouble = ""
            except Exception as error:
                self._trouble = f"its connection fails: {said(error)}"
                self._line.offer(standby=self._trouble)
                if not self._over.is_set():
                    self._reconnect()

    def _connected(self) -> Connection:
        return Connection(self._configuration, max(_IDLE_TIME, self._configuration.silence))

    def _reconnect(self) -> None:
        before = self._connection
        try:
            self._connection = self._connected()
        except Exception:
            time.sleep(_STEP)
        else:
            threading.Thread(target=before.close, name="close", daemon=True).start()
