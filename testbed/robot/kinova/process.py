"""The process beside heft: Kinova's `kortex_api` with its old protobuf, in any Python that has both.

`testbed.robot.kinova.link` starts it, in a session of its own: no key of heft's terminal and no end of heft reaches it.
It imports next to nothing of heft, and is written for Python 3.8. Requests come as JSON lines on standard input,
replies and feedback go as JSON lines to standard output; the first line in is a `Configuration`.
"""

from __future__ import annotations

import json
import os
import signal
import sys
import threading
from typing import Any

from testbed.robot.kinova.session import Configuration, Gen3, kortex_api, stop_once

_IGNORED = ("SIGINT", "SIGHUP", "SIGTERM", "SIGQUIT", "SIGTSTP", "SIGTTIN", "SIGTTOU")
"""Signals that are for heft alone: the arm is stopped first, then its process ends."""


class Line:
    """Standard output, a line at a time from any thread."""

    def __init__(self) -> None:
        # whatever the API prints must not get between the lines
        self._out = os.fdopen(os.dup(sys.stdout.fileno()), "w", encoding="utf-8")
        os.dup2(sys.stderr.fileno(), sys.stdout.fileno())
        self._lock = threading.Lock()

    def say(self, **message: Any) -> None:
        """Send one message; it is lost if nobody reads any more."""
        with self._lock:
            try:
                self._out.write(json.dumps(message) + "\n")
                self._out.flush()
            except OSError:
                pass


def serve() -> None:
    """Connect by the first line, then serve the requests of the others until they end."""
    _ignore_signals()
    line = Line()
    try:
        arm = Gen3(Configuration(**json.loads(sys.stdin.readline())), line)
    except ImportError as error:
        line.say(missing=str(error))
        return
    except Exception as error:  # the API raises what it likes, and the other side has only this line
        line.say(failed=f"{type(error).__name__}: {error}")
        return
    try:
        line.say(connected=arm.tool(), identity=arm.identity())
        for text in sys.stdin:
            request = json.loads(text)
            arm.hear()
            do = request["do"]
            if do == "twist":
                arm.twist(request)
            elif do == "stop":
                arm.stop(request["epoch"])
            elif do != "alive":
                threading.Thread(target=_tried, args=(getattr(arm, do), request, line), daemon=True).start()
    finally:
        arm.close()


def stand_by() -> None:
    """Wait for the end of the input, then stop the arm over a connection of its own; a second line calls that off."""
    _ignore_signals()
    configuration = Configuration(**json.loads(sys.stdin.readline()))
    kortex_api()  # imported in time: it takes a good part of a second
    if not sys.stdin.readline():
        stop_once(configuration)


def _ignore_signals() -> None:
    for name in _IGNORED:
        signal.signal(getattr(signal, name), signal.SIG_IGN)


def _tried(call: Any, request: dict, line: Line) -> None:
    """Serve a slow request beside the reading of others, so that a stop never waits for it."""
    try:
        call(request)
    except Exception as error:
        line.say(id=request["id"], error=f"{type(error).__name__}: {error}")
