"""Pipes to the process that speaks Kortex, and to the one that stops the arm if that ends."""

from __future__ import annotations

import contextlib
import json
import os
import subprocess
import sys
import threading
from collections import deque
from dataclasses import asdict
from pathlib import Path
from typing import Any

from testbed.robot.interfaces import ArmIdentity, ArmLostError, RobotError
from testbed.robot.kinova.session import Configuration, Feedback

PYTHON_VARIABLE = "HEFT_KORTEX_PYTHON"
"""Environment variable with the path of a Python that has `kortex_api`; heft's own if not set."""
WHEEL = "https://artifactory.kinovaapps.com/artifactory/generic-public/kortex/API/2.6.0/kortex_api-2.6.0.post3-py3-none-any.whl"
"""Address of the maker's wheel; it is not on the package index."""
_ROOT = str(Path(__file__).parents[3])
_START = (
    f"import sys; sys.path.insert(0, {_ROOT!r}); from testbed.robot.kinova import process; "
    f"sys.path.remove({_ROOT!r}); process."
)
_CONNECT_TIME = 15.0
_LAST_WORDS = 5


class KortexLink:
    """The other process. Feedback is kept as it comes; a reply wakes the thread that waits for it.

    A second process stands by: should the first be killed, it stops the arm over a connection of its own.
    """

    def __init__(self, configuration: Configuration):
        """Start it and connect.

        Args:
            configuration: how to reach the arm.

        Raises:
            RobotError: no such interpreter, no `kortex_api` in it, or no arm at the address.
        """
        self.python = _python()
        self.feedback: Feedback | None = None
        """The newest feedback."""
        self.lost = ""
        """Reason that the arm may not follow its commands any more, else empty."""
        self.tool: list[float] = []
        """Position of the tool stored in the arm [m]."""
        self.identity = ArmIdentity()
        self._replies: dict[int, dict[str, Any]] = {}
        self._count = 0
        self._writing, self._news = threading.Lock(), threading.Condition()
        self._greeting: dict[str, Any] | None = None
        self._stderr: deque[str] = deque(maxlen=_LAST_WORDS)
        try:
            self._process = self._started("serve()")
            self._standby = self._started("stand_by()")
        except OSError as error:
            raise RobotError(f"{PYTHON_VARIABLE}: got {self.python}, which does not start: {error.strerror}") from None
        for read in (self._read, self._read_errors):
            threading.Thread(target=read, name=f"kortex {read.__name__}", daemon=True).start()
        with contextlib.suppress(OSError):  # no Python, or it has no kortex_api: the first process says so
            self._write(self._standby, json.dumps(asdict(configuration)))
        self.send(**asdict(configuration))
        with self._news:
            self._news.wait_for(lambda: self._greeted or self.dead, _CONNECT_TIME)
        greeting = self._greeting or {}
        if "connected" not in greeting or self.feedback is None:
            self.close()
            raise self._refusal(greeting, configuration)
        self.tool, self.identity = greeting["connected"], ArmIdentity(*greeting["identity"])

    def _started(self, call: str) -> subprocess.Popen[str]:
        pipe, quiet = subprocess.PIPE, subprocess.DEVNULL
        served = call == "serve()"
        return subprocess.Popen(
            [self.python, "-c", _START + call],
            stdin=pipe,
            stdout=pipe if served else quiet,
            stderr=pipe if served else quiet,
            text=True,
            encoding="utf-8",
            start_new_session=True,
        )

    @staticmethod
    def _write(process: subprocess.Popen[str], line: str) -> None:
        """Write one line.

        Raises:
            OSError: nobody is there.
            ValueError: the pipe is closed.
        """
        assert process.stdin is not None
        process.stdin.write(line + "\n")
        process.stdin.flush()

    def _refusal(self, greeting: dict[str, Any], configuration: Configuration) -> RobotError:
        if "missing" in greeting:
            return RobotError(f"kortex_api: {_how_to_get_it(self.python, greeting['missing'])}")
        why = greeting.get("failed") or " ".join(self._stderr) or f"no answer in {_CONNECT_TIME:.0f} s"
        return ArmLostError(
            f"arm {configuration.address}: cannot be connected: {why}; check its power, the cable, that this computer "
            "has an address in its network, and that no other session controls it"
        )

    @property
    def _greeted(self) -> bool:
        """True once it is connected and gives feedback, or has failed."""
        return self._greeting is not None and ("connected" not in self._greeting or self.feedback is not None)

    @property
    def dead(self) -> bool:
        """True if the other process has ended."""
        return self._process.poll() is not None

    def send(self, **message: Any) -> None:
        """Send a message that gets no reply.

        Raises:
            ArmLostError: nobody is there.
        """
        with self._writing:
            try:
                self._write(self._process, json.dumps(message))
            except (OSError, ValueError):
                raise ArmLostError(f"arm: the process that speaks to it has ended; {' '.join(self._stderr)}") from None

    def ask(self, do: str, **request: Any) -> int:
        """Send a request; returns its number, for `reply`."""
        self._count += 1
        self.send(id=self._count, do=do, **request)
        return self._count

    def reply(self, number: int, seconds: float) -> dict[str, Any] | None:
        """The reply to a request if it comes within `seconds`, else None.

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

    def close(self) -> None:
        """End the other process; it stops the arm first. The one that stands by does so too if that one fails."""
        if _ended(self._process) and self._process.returncode == 0:
            with contextlib.suppress(OSError, ValueError):
                self._write(self._standby, "not needed")
        _ended(self._standby)

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
        with self._news:
            self.lost = "the process that speaks to it has ended"
            self._news.notify_all()
        if self._process.wait() != 0:
            _ended(self._standby)

    def _read_errors(self) -> None:
        assert self._process.stderr is not None
        self._stderr.extend(text.strip() for text in self._process.stderr if text.strip())


def _ended(process: subprocess.Popen[str]) -> bool:
    """Close a process's input and wait for its end; False if it had to be killed."""
    with contextlib.suppress(OSError):
        assert process.stdin is not None
        process.stdin.close()
    try:
        process.wait(2.0)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
        return False
    return True


def missing_api() -> str:
    """Reason that `kortex_api` cannot be imported and its remedy, else empty; the interpreter as in `KortexLink`."""
    interpreter = _python()
    code = (
        f"import sys; sys.path.insert(0, {_ROOT!r}); from testbed.robot.kinova.session import kortex_api; kortex_api()"
    )
    try:
        run = subprocess.run([interpreter, "-c", code], capture_output=True, text=True, check=False, timeout=60)
    except (OSError, subprocess.TimeoutExpired) as error:
        return _how_to_get_it(interpreter, str(error))
    return _how_to_get_it(interpreter, run.stderr.strip().splitlines()[-1]) if run.returncode else ""


def _python() -> str:
    """Interpreter of the other process: by the environment alone, since a robot file must not name a program."""
    return os.environ.get(PYTHON_VARIABLE) or sys.executable


def _how_to_get_it(python: str, why: str) -> str:
    return (
        f"not usable in {python} ({why}); make a virtual environment for it, pip install {WHEEL} there, and set "
        f"{PYTHON_VARIABLE} to its python"
    )
