"""Executors: values come back, failures come back as values, and workers are replaced."""

import errno
import importlib
import multiprocessing
import os
import re
import sys
import time
from collections.abc import Mapping
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from scenarios.execution.executor import Executor, Failure, Limits
from scenarios.execution.select import open_executor
from testbed.errors import HeftError, InvalidValueError
from tests.fakes.misbehaving import crash_once, misbehave, who, write

QUICK = Limits(timeout_s=4.0, tries=1, memory_gib=1.0)


def all_of(executor: Executor, tasks: Mapping[Any, tuple[Any, ...]]) -> dict[Any, Any]:
    """Every task's value."""
    for label, (function, *arguments) in tasks.items():
        executor.start(label, function, *arguments)
    values = {}
    while executor.running:
        label, value = executor.wait()
        values[label] = value
    return values


def test_inline_gives_values_and_failures():
    with open_executor("inline", 5) as executor:
        assert all_of(executor, {1: (who,)})[1] == (os.getpid(), 1)
        values = all_of(executor, {way: (misbehave, way) for way in ("well", "raise", "exit")})
    assert values["well"] == "well"
    assert values["raise"].reason == "RuntimeError: out of ideas"
    assert "Traceback" in values["raise"].detail
    assert values["exit"].reason == "SystemExit: 3"


def test_a_full_disk_ends_the_run():
    with open_executor("inline", 0) as executor, pytest.raises(OSError) as error:
        all_of(executor, {1: (write, "/dev/full")})
    assert error.value.errno == errno.ENOSPC


@pytest.mark.slow
def test_whatever_a_task_does_comes_back_as_a_value():
    ways = ("well", "raise", "exit", "eat", "hang", "crash")  # those that cost a worker last
    with open_executor("local", 2, QUICK) as executor:
        values = all_of(executor, {"who": (who,)} | {way: (misbehave, way) for way in ways})
        assert values["who"][1] == 1
        assert values["who"][0] != os.getpid()
    assert values["well"] == "well"
    reasons = {way: value.reason for way, value in values.items() if isinstance(value, Failure)}
    assert reasons["raise"] == "RuntimeError: out of ideas"
    assert reasons["exit"] == "SystemExit: 3"
    assert reasons["hang"] == "took longer than 4 s (tried once)"
    assert reasons["crash"] == "its worker process was killed by SIGSEGV (tried once)"
    assert "MemoryError: Unable to allocate" in reasons["eat"]
    assert not multiprocessing.active_children()


@pytest.mark.slow
def test_a_task_is_begun_again_up_to_a_number_of_times(tmp_path):
    with open_executor("local", 1, Limits(tries=2)) as executor:
        ways = {way: (misbehave, way) for way in ("crash", "leave", "well")}
        values = all_of(executor, {"crash once": (crash_once, str(tmp_path / "marker"))} | ways)
    assert values["crash once"] == values["well"] == "well"
    assert values["crash"].reason == "its worker process was killed by SIGSEGV (tried 2 times)"
    assert values["leave"].reason == "its worker process exited with code 0 (tried 2 times)"


def listening() -> set[str]:
    """Addresses and ports at which this machine listens, as the system writes them."""
    lines = [line.split() for name in ("tcp", "tcp6") for line in Path(f"/proc/net/{name}").read_text().splitlines()]
    return {fields[1] for fields in lines if fields[3] == "0A"}


def test_a_cluster_is_joined_only_where_the_environment_names_it(monkeypatch):
    asked = []

    class Ray(ModuleType):
        is_initialized = staticmethod(lambda: False)

        @staticmethod
        def init(address: str, **_: object) -> None:
            asked.append(address)
            raise ConnectionError("nobody there")

    monkeypatch.setitem(sys.modules, "ray", Ray("ray"))
    monkeypatch.setitem(sys.modules, "ray._private.ray_constants", ModuleType("ray._private.ray_constants"))
    monkeypatch.setenv("RAY_ADDRESS", "10.0.0.1:6379")
    with pytest.raises(HeftError, match=r"RAY_ADDRESS: got '10.*', where no cluster answers"):
        open_executor("ray", 2).__enter__()
    monkeypatch.delenv("RAY_ADDRESS")
    with pytest.raises(ConnectionError):
        open_executor("ray", 2).__enter__()
    assert asked == ["10.0.0.1:6379", "local"]


@pytest.mark.slow
def test_whatever_a_task_does_on_ray_comes_back_as_a_value_and_a_lost_cluster_is_no_failure_of_its_tasks():
    pytest.importorskip("ray", reason="Ray is not installed: pip install 'heft-testbed[ray]'")
    before = listening()
    with open_executor("ray", 2, Limits(timeout_s=8.0, tries=2, memory_gib=1.5)) as executor:
        values = all_of(executor, {way: (misbehave, way) for way in ("well", "raise", "exit", "hang", "crash", "eat")})
        new = listening() - before
        assert new and all(re.search("0100007F:|0{24}01000000:", address) for address in new), "on this machine alone"
        executor.start("first", time.sleep, 0.1)
        assert executor.wait() == ("first", None)
        executor.start("second", time.sleep, 60.0)
        importlib.import_module("ray._private.worker").global_worker.node.kill_raylet()
        with pytest.raises(HeftError, match=r"the Ray cluster is gone .*the same command goes on from there"):
            executor.wait()
    assert values["well"] == "well"
    assert values["raise"].reason == "RuntimeError: out of ideas"
    assert values["exit"].reason == "SystemExit: 3"
    assert values["hang"].reason == "took longer than 8 s"
    assert "its worker process was lost" in values["crash"].reason
    assert "MemoryError: Unable to allocate" in values["eat"].reason


@pytest.mark.parametrize(
    ("name", "workers", "error", "said"),
    [
        ("slurm", 2, InvalidValueError, "--executor: got 'slurm'; allowed: one of inline, local, ray"),
        ("local", -1, InvalidValueError, "--workers: got -1"),
        ("ray", 2, HeftError, r"pip install 'heft-testbed\[ray\]'"),
    ],
)
def test_an_executor_that_cannot_be_opened_is_refused(name, workers, error, said, monkeypatch):
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(error, match=said):
        open_executor(name, workers).__enter__()
