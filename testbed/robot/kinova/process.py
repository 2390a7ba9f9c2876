"""The process beside heft: Kinova's `kortex_api` with its old protobuf, in any Python that has both.

`testbed.robot.kinova.link` starts it. It imports next to nothing of heft, and is written for Python 3.8.
Requests come as JSON lines on standard input, replies and feedback go as JSON lines to standard output; the first line
in is a `Configuration`.
"""

from __future__ import annotations

import json
import os
import signal
import sys
import threading
from typing import Any

from testbed.robot.kinova.session import Configuration, Gen3


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
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for heft, which then says stop
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
        line.say(connected=arm.tool())
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


def _tried(call: Any, request: dict, line: Line) -> None:
    """Serve a slow request beside the reading of others, so that a stop never waits for it."""
    try:
        call(request)
    except Exception as error:
        line.say(id=request["id"], error=f"{type(error).__name__}: {error}")
