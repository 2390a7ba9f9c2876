"""Kortex process and stand-by process, which run Kinova's `kortex_api` in any Python that has it and its protobuf.

`testbed.robot.kinova.link` starts them, each in a session of its own, so that signals of heft's terminal and the end of
heft do not reach them. Of heft they import only modules of this package, and they are written for Python 3.8.
Requests are JSON lines on standard input, replies and feedback JSON lines on standard output; the first request is a
`Configuration`.
"""

from __future__ import annotations

import json
import os
import signal
import sys
import threading
from collections.abc import Callable
from contextlib import suppress
from queue import SimpleQueue
from typing import Any

from testbed.robot.kinova.connection import Configuration
from testbed.robot.kinova.session import Gen3
from testbed.robot.kinova.standby import Beats, StandBy

_IGNORED = ("SIGINT", "SIGHUP", "SIGTERM", "SIGQUIT", "SIGTSTP", "SIGTTIN", "SIGTTOU")
"""Signals for heft only: heft stops the arm, then ends this process."""
_MOST_WAITING = 10


class Line:
    """Writer of lines to standard output from any thread; it does not block if heft no longer reads."""

    def __init__(self) -> None:
        # output of the API must not mix with the lines
        self._out = os.fdopen(os.dup(sys.stdout.fileno()), "w", encoding="utf-8")
        os.dup2(sys.stderr.fileno(), sys.stdout.fileno())
        self._waiting: SimpleQueue[dict[str, Any] | None] = SimpleQueue()
        self._writer = threading.Thread(target=self._write, name="write", daemon=True)
        self._writer.start()

    def say(self, **message: Any) -> None:
        """Send one message; it is lost if heft has ended."""
        self._waiting.put(message)

    def offer(self, **message: Any) -> None:
        """Send one message unless `_MOST_WAITING` are queued, since a newer one will follow."""
        if self._waiting.qsize() < _MOST_WAITING:
            self._waiting.put(message)

    def close(self) -> None:
        """Write all queued messages, for at most 0.1 s."""
        self._waiting.put(None)
        self._writer.join(0.1)

    def _write(self) -> None:
        while (message := self._waiting.get()) is not None:
            with suppress(OSError):
                self._out.write(json.dumps(message) + "\n")
                self._out.flush()


def serve(pipe: int) -> None:
    """Connect by the first line, then serve the requests of the following lines; beats are written to `pipe`."""
    _ignore_signals()
    line, beats = Line(), Beats(pipe)
    arm = _begun(line, lambda configuration: Gen3(configuration, line, beats))
    if arm is None:
        beats.bye()
        return
    try:
        line.say(connected=arm.tool(), identity=arm.identity())
        for text in sys.stdin:
            request = json.loads(text)
            arm.hear(request)
            do = request["do"]
            if do == "twist":
                arm.twist(request)
            elif do == "stop":
                arm.stop(request["epoch"])
            elif do != "alive":
                threading.Thread(target=_tried, args=(getattr(arm, do), request, line), daemon=True).start()
    except BaseException:
        beats.end()  # no goodbye
        raise
    finally:
        arm.close()
        line.close()


def stand_by(pipe: int, mover: int) -> None:
    """Connect by the first line, then stop the arm if the process with id `mover` fails; `pipe` carries its beats."""
    _ignore_signals()
    line = Line()
    standby = _begun(line, lambda configuration: StandBy(configuration, line, pipe, mover))
    if standby is not None:
        standby.run()
        line.close()


def _begun(line: Line, begin: Callable[[Configuration], Any]) -> Any:
    """Result of `begin` with the configuration on the first line; None after a failure, which is reported."""
    try:
        return begin(Configuration(**json.loads(sys.stdin.readline())))
    except ImportError as error:
        line.say(missing=str(error))
    except Exception as error:  # the API raises any type, and heft learns of it only by this line
        line.say(failed=f"{type(error).__name__}: {error}")
    line.close()
    return None


def _ignore_signals() -> None:
    for name in _IGNORED:
        signal.signal(getattr(signal, name), signal.SIG_IGN)


def _tried(call: Any, request: dict, line: Line) -> None:
    """Serve a slow request in a thread of its own, so that a stop never waits for it."""
    try:
        call(request)
    except Exception as error:
        line.say(id=request["id"], error=f"{type(error).__name__}: {error}")
