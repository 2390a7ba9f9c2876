"""Connections to a Gen3 over Kinova's `kortex_api`, for the Kortex and stand-by processes; written for Python 3.8."""

from __future__ import annotations

import collections
import collections.abc
import importlib
import sys
from concurrent.futures import TimeoutError as Timeout
from contextlib import suppress
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

_STUBS, _MESSAGES = "autogen.client_stubs", "autogen.messages"
_USED = {
    "BaseClient": f"{_STUBS}.BaseClientRpc",
    "BaseCyclicClient": f"{_STUBS}.BaseCyclicClientRpc",
    "ControlConfigClient": f"{_STUBS}.ControlConfigClientRpc",
    "DeviceConfigClient": f"{_STUBS}.DeviceConfigClientRpc",
    "KException": "Exceptions.KException",
    "RouterClient": "RouterClient",
    "RouterClientSendOptions": "RouterClient",
    "SessionManager": "SessionManager",
    "TCPTransport": "TCPTransport",
}
"""Classes of `kortex_api` in use, and their modules."""


@dataclass
class Configuration:
    """Connection to the arm."""

    address: str
    port: int = 10000
    username: str = "admin"
    password: str = "admin"
    silence: float = 0.1
    """Time without feedback after which a moving arm is stopped [s]; also the arm's own connection timeout."""
    watchdog: float = 0.05
    """Time without a request of heft after which an engaged arm is stopped [s]."""

    @property
    def quiet(self) -> float:
        """Time without a beat after which a process counts as frozen [s]: short enough to stop within `silence`."""
        return 0.6 * self.silence


class Connection:
    """An open session, and the clients of the arm's services."""

    def __init__(self, configuration: Configuration, idle: float):
        """Connect; `idle` is the silence of this connection after which the arm stops by itself [s].

        Raises:
            ImportError: no `kortex_api`.
            Exception: any error of the API.
        """
        self.api = api = kortex_api()
        self._silence = configuration.silence
        self._transport = api.TCPTransport()
        router = api.RouterClient(self._transport, lambda error: print(error, file=sys.stderr))
        self._transport.connect(configuration.address, configuration.port)
        info = api.Session.CreateSessionInfo()
        info.username, info.password = configuration.username, configuration.password
        info.session_inactivity_timeout = 60000
        info.connection_inactivity_timeout = round(idle * 1000)
        self._session = api.SessionManager(router)
        try:
            self._session.CreateSession(info)
        except BaseException:
            self._transport.disconnect()
            raise
        self.router, self.base, self.cyclic = router, api.BaseClient(router), api.BaseCyclicClient(router)

    def options(self) -> Any:
        """Options of a call, with `silence` as its timeout."""
        options = self.api.RouterClientSendOptions()
        options.timeout_ms = round(self._silence * 1000)
        return options

    def stop(self) -> None:
        """Stop the arm; by the emergency stop if it refuses or does not answer.

        Raises:
            Failure: neither was accepted, or the connection is broken.
        """
        try:
            self.base.Stop(0, self.options())
        except self.api.Failure as error:
            if broken(error):
                raise
            self.base.ApplyEmergencyStop(0, self.options())

    def close(self) -> None:
        """End the session."""
        with suppress(*self.api.Failure):
            self._session.CloseSession(self.options())
        self._transport.disconnect()


def broken(error: BaseException) -> bool:
    """True if an error shows that the connection has ended, so that no call can succeed over it."""
    return isinstance(error, OSError) and not isinstance(error, Timeout)


def said(error: BaseException) -> str:
    """Name and text of an error; a timeout has no text."""
    return f"{type(error).__name__} {error}".strip()


def kortex_api() -> Any:
    """The used part of `kortex_api`: classes, the messages Base, Common and Session, and the errors of calls (Failure).

    Raises:
        ImportError: it is not installed, or its protobuf does not fit this Python.
    """
    for name in ("MutableMapping", "MutableSequence"):  # protobuf 3.5 on Python 3.10 and later
        if not hasattr(collections, name):
            setattr(collections, name, getattr(collections.abc, name))
    used = {name: getattr(importlib.import_module(f"kortex_api.{module}"), name) for name, module in _USED.items()}
    for name in ("Base", "Common", "Session"):
        used[name] = importlib.import_module(f"kortex_api.{_MESSAGES}.{name}_pb2")
    return SimpleNamespace(Failure=(used["KException"], OSError, Timeout), **used)
