"""Tasks on a Ray cluster. They write to the results folder, which all its machines must share."""

from __future__ import annotations

import faulthandler
import importlib
import logging
import os
import signal
import sys
import traceback
from collections.abc import Callable
from functools import lru_cache
from types import FrameType
from typing import Any, Self

from scenarios.execution.executor import Failure, Limits, call, given_back, set_up_worker
from testbed.errors import HeftError

_IN_FLIGHT = 3
"""Tasks in flight for each CPU of the cluster: enough to hide latency, few enough to bound memory."""
_GRACE_S = 10.0
"""Time from the interrupt of a hung task to the exit of its process [s]."""
ADDRESS = "RAY_ADDRESS"
"""Environment variable with the address of a cluster to join."""
_LOOPBACK = "RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER"
"""Ray's switch between loopback and all interfaces, on Linux too despite its name."""


class RayExecutor:
    """Tasks on the cluster at RAY_ADDRESS, or on one of `workers` CPUs that listens on this machine alone.

    A cluster that this process has joined already is used as it is.
    """

    def __init__(self, workers: int, limits: Limits):
        self._ray = _import_ray()
        self._limits = limits
        self._joined = self._ray.is_initialized()
        if not self._joined:
            quiet = {"logging_level": logging.ERROR, "log_to_driver": False}
            if address := os.environ.get(ADDRESS):
                try:
                    self._ray.init(address=address, **quiet)
                except (ConnectionError, ValueError) as error:
                    why = f"where no cluster answers: {error}; one that asks for a token needs RAY_AUTH_MODE=token"
                    raise HeftError(f"{ADDRESS}: got {address!r}, {why}") from None
            else:
                self._start(max(workers, 1), quiet)
        # Ray restarts a task that was lost with its worker or its machine
        self._run = self._ray.remote(num_cpus=1, max_retries=limits.tries - 1)(_run)
        self._labels: dict[Any, Any] = {}

    def _start(self, workers: int, quiet: dict[str, Any]) -> None:
        """Start a cluster on the loopback interface: anyone who reaches its ports can run code."""
        constants: Any = importlib.import_module("ray._private.ray_constants")
        constants.ENABLE_RAY_CLUSTER = False  # Ray may have been imported before the switch was set
        self._ray.init(address="local", num_cpus=workers, include_dashboard=False, **quiet)
        if not (at := self._ray.util.get_node_ip_address()).startswith("127."):
            self._ray.shutdown()
            raise HeftError(f"--executor ray: this version of Ray would listen at {at}; start a cluster, set {ADDRESS}")

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        for task in self._labels:
            self._ray.cancel(task, force=True)
        if not self._joined:
            self._ray.shutdown()

    @property
    def capacity(self) -> int:
        """A few tasks for every present CPU; machines may join and leave."""
        return _IN_FLIGHT * max(int(self._ray.cluster_resources().get("CPU", 1)), 1)

    @property
    def running(self) -> int:
        """Number of tasks whose values have not returned."""
        return len(self._labels)

    def start(self, label: Any, function: Callable[..., Any], *arguments: Any) -> None:
        """Send a task to the cluster."""
        self._labels[self._run.remote(self._limits, sys.path, function, *arguments)] = label

    def wait(self) -> tuple[Any, Any]:
        """Label and value, or `Failure`, of a task that has ended."""
        (task, *_), _ = self._ray.wait(list(self._labels), num_returns=1)
        label = self._labels.pop(task)
        try:
            value = self._ray.get(task)
        except self._ray.exceptions.RayTaskError as error:  # arguments or a value that cannot be sent
            value = Failure(str(error).strip().splitlines()[-1], f"{error}\n")
        except self._ray.exceptions.RayError as error:
            self._check_cluster(error)
            times = "once" if self._limits.tries == 1 else f"{self._limits.tries} times"
            kind = type(error).__name__
            reason = f"its worker process was lost, or hung for {self._limits.timeout_s:g} s: {kind} (tried {times})"
            value = Failure(reason, f"{error}\n")
        return given_back(label, value)

    def _check_cluster(self, error: Exception) -> None:
        """Raise HeftError if no machine of the cluster is left, which is no failure of the task."""
        try:
            left = any(node["Alive"] for node in self._ray.nodes())
        except Exception:  # Ray raises errors of several types without its head node
            left = False
        if not left:
            self._labels.clear()
            what = type(error).__name__
            raise HeftError(
                f"the Ray cluster is gone ({what}): what is done is kept; the same command goes on from there, on the "
                f"cluster at {ADDRESS} or a new one of its own"
            ) from None


def _import_ray() -> Any:
    if not os.environ.get(ADDRESS):
        os.environ.setdefault(_LOOPBACK, "0")  # its processes read it too
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")  # no usage data are sent
    try:
        return importlib.import_module("ray")
    except ImportError:
        raise HeftError("--executor ray needs Ray, which is not installed: pip install 'heft-testbed[ray]'") from None


class _TooSlow(BaseException):
    """Interrupt of a task; not an Exception, so that no method catches it."""


def _run(limits: Limits, paths: list[str], function: Callable[..., Any], *arguments: Any) -> Any:
    """Run a task on a worker of the cluster within its time limit, with the caller's module paths."""
    _set_up_once(limits)
    sys.path.extend(path for path in paths if path not in sys.path)
    before = signal.signal(signal.SIGALRM, _stop)
    try:
        signal.setitimer(signal.ITIMER_REAL, limits.timeout_s)
        faulthandler.dump_traceback_later(limits.timeout_s + _GRACE_S, exit=True)  # for hangs outside Python
        return call(function, *arguments)
    except _TooSlow:
        return Failure(f"took longer than {limits.timeout_s:g} s", traceback.format_exc())
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        faulthandler.cancel_dump_traceback_later()
        signal.signal(signal.SIGALRM, before)


def _stop(number: int, frame: FrameType | None) -> None:
    raise _TooSlow


_set_up_once = lru_cache(maxsize=1)(set_up_worker)
