"""Pipes to the Kortex process, and to the stand-by, which stops the arm if that process fails."""

from __future__ import annotations

import contextlib
import json
import math
import os
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

from testbed.robot.interfaces import ArmIdentity, ArmLostError, RobotError
from testbed.robot.kinova.connection import Configuration
from testbed.robot.kinova.session import Feedback

PYTHON_VARIABLE = "HEFT_KORTEX_PYTHON"
"""Environment variable with the path of a Python that has `kortex_api`; the running Python if not set."""
WHEEL = "https://artifactory.kinovaapps.com/artifactory/generic-public/kortex/API/2.6.0/kortex_api-2.6.0.post3-py3-none-any.whl"
"""Address of the manufacturer's wheel, which is not on the package index."""
_ROOT = str(Path(__file__).parents[3])
_START = (
    f"import sys; sys.path.insert(0, {_ROOT!r}); from testbed.robot.kinova import process; "
    f"sys.path.remove({_ROOT!r}); process."
)
_CONNECT_TIME = 15.0
_LAST_WORDS = 5
_GRACE = 0.01
"""Time to read received messages before a process counts as silent [s]."""


class KortexLink:
    """The Kortex process and the stand-by. Threads read feedback and replies as they arrive.

    The stand-by stops the arm over a connection of its own if the Kortex process ends without a goodbye or is frozen.
    """

    def __init__(self, configuration: Configuration):
        """Start both processes and connect.

        Raises:
            RobotError: no such interpreter, no `kortex_api` in it, or no arm at the address.
        """
        self.python = _python()
        self.feedback: Feedback | None = None
        """The newest feedback."""
        self.lost = ""
        """Reason that the arm may no longer follow commands, else empty."""
        self.takes_over = False
        """True once the stand-by has taken over to stop the arm."""
        self.tool: list[float] = []
        """Position of the tool stored in the arm [m]."""
        self.identity = ArmIdentity()
        self._replies: dict[int, dict[str, Any]] = {}
        self._count = 0
        self._news = threading.Condition()
        self._greeting: dict[str, Any] | None = None
        self._quiet = configuration.quiet
        self._beat, self._trouble, self._ended = -math.inf, "", False  # of the stand-by
        self._stderr: tuple[str, ...] = ()  # replaced, never changed: other threads read it
        beats, beating = os.pipe()
        try:
            self._process = self._started("serve", beating)
            self._standby = self._started("stand_by", beats, self._process.pid)
        except OSError as error:
            raise RobotError(f"{PYTHON_VARIABLE}: got {self.python}, which does not start: {error.strerror}") from None
        finally:
            os.close(beats)
            os.close(beating)
        for read in (self._read, self._read_standby, self._read_errors):
            threading.Thread(target=read, name=f"kortex {read.__name__}", daemon=True).start()
        with contextlib.suppress(OSError):  # no Python, or no kortex_api in it, which the first process reports
            _write(self._standby, asdict(configuration))
        self.send(**asdict(configuration))
        with self._news:
            self._news.wait_for(lambda: self._greeted or self.dead, _CONNECT_TIME)
        greeting = self._greeting or {}
        if "connected" not in greeting or self.feedback is None or self._beat < 0:
            self.close()
            raise self._refusal(greeting, configuration)
        self.tool, self.identity = greeting["connected"], ArmIdentity(*greeting["identity"])

    def _started(self, call: str, beats: int, *arguments: int) -> subprocess.Popen[str]:
        pipe = subprocess.PIPE
        return subprocess.Popen(
            [self.python, "-c", f"{_START}{call}{(beats, *arguments)}"],
            stdin=pipe,
            stdout=pipe,
            stderr=pipe if call == "serve" else subprocess.DEVNULL,
            encoding="utf-8",
            start_new_session=True,
            pass_fds=(beats,),
        )

    def _refusal(self, greeting: dict[str, Any], configuration: Configuration) -> RobotError:
        if "missing" in greeting:
            return RobotError(f"kortex_api: {_how_to_get_it(self.python, greeting['missing'])}")
        why = greeting.get("failed") or " ".join(self._stderr) or f"no answer in {_CONNECT_TIME:.0f} s"
        if "connected" in greeting:
            why = f"the stand-by, by a session of its own: {self._trouble or why}"
        return ArmLostError(
            f"arm {configuration.address}: cannot be connected: {why}; check its power, the cable, that this computer "
            "has an address in its network, and that no other session controls it"
        )

    @property
    def _greeted(self) -> bool:
        """True once both are connected and feedback arrives, or one has failed."""
        if self._greeting is None or self._ended or "connected" not in self._greeting:
            return self._greeting is not None
        return self.feedback is not None and self._beat > 0

    @property
    def dead(self) -> bool:
        """True if the Kortex process has ended."""
        return self._process.poll() is not None

    def send(self, **message: Any) -> None:
        """Send a message without a reply; never blocks.

        Raises:
            ArmLostError: the process has ended, or is frozen and no longer reads.
        """
        try:
            _write(self._process, message)
        except (OSError, ValueError):
            why = self.lost or f"the process that speaks to it has ended; {' '.join(self._stderr)}"
            raise ArmLostError(f"arm: {why}") from None

    def ask(self, do: str, **request: Any) -> int:
        """Send a request; returns its number, for `reply`."""
        self._count += 1
        self.send(id=self._count, do=do, **request)
        return self._count

    def reply(self, number: int, seconds: float) -> dict[str, Any] | None:
        """The reply to a request if it arrives within `seconds`, else None.

        Raises:
            ArmLostError: the arm is lost, and no reply will come.
        """
        with self._news:
            self._news.wait_for(lambda: number in self._replies or self.lost or self.dead, seconds)
            reply = self._replies.pop(number, None)
            if reply is None and (self.lost or self.dead):
                raise ArmLostError(f"arm: {self.lost or 'the process that speaks to it has ended'}")
            return reply

    def refused(self) -> str:
        """Reason of a twist's refusal since the last call, else empty."""
        with self._news:
            refused = [n for n, reply in self._replies.items() if "twist refused" in reply.get("error", "")]
            said = [self._replies.pop(number)["error"] for number in refused]
        return said[0] if said else ""

    @property
    def age(self) -> float:
        """Age of the newest feedback [s]."""
        return math.inf if self.feedback is None else time.monotonic() - self.feedback.time_s

    def check_standby(self) -> None:
        """Check that the stand-by could stop the arm.

        Raises:
            ArmLostError: it has ended, is silent, or has no connection.
        """
        why = ""
        if self._ended:
            why = "has ended"
        elif self._trouble:
            why = f"could not stop it: {self._trouble}"
        elif time.monotonic() - self._beat > self._quiet:
            with self._news:
                if not self._news.wait_for(lambda: time.monotonic() - self._beat < self._quiet, _GRACE):
                    why = f"was silent for {self._quiet * 1e3:.0f} ms"
        if why:
            raise ArmLostError(f"arm: {self.lost or f'the process that stands by to stop it {why}'}")

    def stop(self, epoch: int) -> None:
        """Stop the arm; blocks for `_GRACE` at most. A frozen process is killed, so that the stand-by stops the arm."""
        with self._news:
            awake = self._news.wait_for(lambda: self.dead or self.age < self._quiet, _GRACE)
        try:
            if not awake:
                raise ArmLostError("arm: the process that speaks to it is frozen")
            self.send(do="stop", epoch=epoch)
        except ArmLostError:
            self._process.kill()
            return
        if not (self.dead or self.takes_over):
            self.lost = ""

    def close(self) -> None:
        """End both processes. The first stops the arm; if it fails, the stand-by does, and ends only afterwards."""
        _end(self._process)
        _end(self._standby, spared=lambda: self.takes_over)

    def _read(self) -> None:
        assert self._process.stdout is not None
        for text in self._process.stdout:
            message = json.loads(text)
            with self._news:
                if "state" in message:
                    self.feedback = Feedback(**message["state"])
                elif "id" in message:
                    self._replies[message["id"]] = message
                elif "lost" in message:
                    self.lost = message["lost"]
                else:
                    self._greeting = message
                self._news.notify_all()
        self._process.wait()
        with self._news:
            self.lost = self.lost or "the process that speaks to it has ended"
            self._news.notify_all()

    def _read_standby(self) -> None:
        assert self._standby.stdout is not None
        for text in self._standby.stdout:
            message = json.loads(text)
            with self._news:
                self._trouble = message.get("standby", message.get("failed", ""))
                self._beat = time.monotonic() if "standby" in message else self._beat
                if why := message.get("takes_over"):
                    self.takes_over, self.lost = True, why
                self._news.notify_all()
        with self._news:
            self._ended = True
            self._news.notify_all()

    def _read_errors(self) -> None:
        assert self._process.stderr is not None
        for text in filter(None, map(str.strip, self._process.stderr)):
            self._stderr = (*self._stderr, text)[-_LAST_WORDS:]


def _write(process: subprocess.Popen[str], message: dict[str, Any]) -> None:
    """Write one line atomically, without blocking: it is shorter than a pipe's buffer.

    Raises:
        OSError: the process has ended, or its pipe is full.
        ValueError: the pipe is closed.
    """
    assert process.stdin is not None
    pipe = process.stdin.fileno()
    os.set_blocking(pipe, False)
    os.write(pipe, (json.dumps(message) + "\n").encode())


def _end(process: subprocess.Popen[str], spared: Callable[[], bool] = lambda: False) -> None:
    """Close a process's input and wait for its end; kill it after 2 s unless `spared` returns True."""
    with contextlib.suppress(OSError):
        assert process.stdin is not None
        process.stdin.close()
    try:
        process.wait(2.0)
    except subprocess.TimeoutExpired:
        if not spared():
            process.kill()
            process.wait()


def missing_api() -> str:
    """Reason that `kortex_api` cannot be imported, with a remedy, else empty; for the interpreter of `KortexLink`."""
    interpreter = _python()
    module = "testbed.robot.kinova.connection"
    code = f"import sys; sys.path.insert(0, {_ROOT!r}); from {module} import kortex_api; kortex_api()"
    try:
        run = subprocess.run([interpreter, "-c", code], capture_output=True, text=True, check=False, timeout=60)
    except (OSError, subprocess.TimeoutExpired) as error:
        return _how_to_get_it(interpreter, str(error))
    return _how_to_get_it(interpreter, run.stderr.strip().splitlines()[-1]) if run.returncode else ""


def _python() -> str:
    """Interpreter of the processes: from the environment only, since a robot file must not name a program."""
    return os.environ.get(PYTHON_VARIABLE) or sys.executable


def _how_to_get_it(python: str, why: str) -> str:
    return (
        f"not usable in {python} ({why}); make a virtual environment for it, pip install {WHEEL} there, and set "
        f"{PYTHON_VARIABLE} to its python"
    )
