"""A fake Gen3 and a fake FT-300S on one simulated bench, in a process of their own that runs in real time."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from multiprocessing import get_context
from multiprocessing.connection import Connection
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np

from testbed.objects.model import ObjectModel
from testbed.sensing.presets import Sensing, preset
from testbed.trial import OWN_WEIGHT, Support
from tests.fakes.ft300s import FakeFt300s
from tests.fakes.gen3 import FakeGen3
from tests.fakes.gen3_world import Gen3World

FT300S = preset("ft300s")
KORTEX = str(Path(__file__).parent / "kortex")
"""Folder of the fake `kortex_api`, for PYTHONPATH."""


@dataclass(frozen=True)
class Wires:
    """What a driver opens."""

    arm_port: int
    sensor_port: str


class FakeRig:
    """Runs while it is entered. What happens on the bench is asked for by `do`."""

    def __init__(self, obj: ObjectModel, support: Support = OWN_WEIGHT, *, noise: Sensing = FT300S, seed: int = 0):
        self._asked = (obj, support, noise, seed)

    def __enter__(self) -> Self:
        context = get_context("spawn")
        self._ours, theirs = context.Pipe()
        self._process = context.Process(target=_live, args=(theirs, *self._asked), daemon=True)
        self._process.start()
        self.wires: Wires = self._ours.recv()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._ours.close()
        self._process.join(5.0)
        self._process.kill()

    def do(self, name: str, *arguments: Any) -> Any:
        """One of the functions below, on the bench."""
        self._ours.send((name, arguments))
        return self._ours.recv()


def _live(theirs: Connection, obj: ObjectModel, support: Support, noise: Sensing, seed: int) -> None:
    world = Gen3World(obj, support, noise=noise, seed=seed)
    with FakeGen3(world) as arm, FakeFt300s(lambda _: world.wrench) as sensor:
        theirs.send(Wires(arm.port, sensor.port))
        while True:
            try:
                name, arguments = theirs.recv()
            except EOFError:
                return
            theirs.send(DEEDS[name](arm, sensor, *arguments))


def _place(arm: FakeGen3, _: FakeFt300s, pose: np.ndarray, grasp: int) -> None:
    with arm.lock:
        arm.world.place(pose, grasp)


def _driven_after(arm: FakeGen3, _: FakeFt300s, moment: float) -> float:
    return arm.driven_after(moment)


def _trouble(arm: FakeGen3, _: FakeFt300s, **changes: object) -> None:
    for name, value in changes.items():
        setattr(arm.faults, name, value)


DEEDS: dict[str, Callable[..., Any]] = {
    "place": _place,
    "driven_after": _driven_after,
    "drop the arm": lambda arm, _: arm.drop(),
    "unplug the sensor": lambda _, sensor: sensor.unplug(),
    "fault": lambda arm, _, bank: setattr(arm.faults, "fault_bank", bank),
    "slowest tick": lambda arm, _: float(np.diff([at for at, *_ in arm.motion]).max()),
}


def python_with_fake_kortex() -> None:
    """Let the process that speaks Kortex find the fake."""
    os.environ["PYTHONPATH"] = KORTEX
