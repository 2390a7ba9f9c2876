"""Progress of a run: bars on a terminal, a plain line now and then elsewhere."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pydantic import ValidationError
from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TaskID,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

from scenarios.config import Scenario
from scenarios.results.lock import FolderInUseError, exclusive
from scenarios.results.store import read_json
from scenarios.study.dry_run import Plan
from testbed.errors import InvalidValueError

if TYPE_CHECKING:
    from scenarios.study.experiment import Progress as Told  # who draws a film need not wait for torch


EVERY_S = 10.0
"""Between two plain lines, s."""


@contextmanager
def show_progress(console: Console) -> Iterator[Told]:
    """What is to be told how far a run is; it shows throughput and time left."""
    if console.is_terminal:
        with Progress(
            TextColumn("{task.description:<10}"),
            BarColumn(),
            MofNCompleteColumn(),
            TextColumn("{task.fields[rate]}"),
            TimeElapsedColumn(),
            TimeRemainingColumn(),
            TextColumn("{task.fields[failed]}", style="red"),
            console=console,
            transient=True,
        ) as bars:
            yield _Bars(bars)
    else:
        yield _Lines()


class _Stages:
    """When each stage began, and at what count: what is there from an earlier run is no throughput."""

    def __init__(self) -> None:
        self._begun: dict[str, tuple[float, int]] = {}

    def rate(self, stage: str, done: int) -> float:
        """Done a second since the stage was first told of; 0 where nothing is known yet."""
        since, first = self._begun.setdefault(stage, (time.monotonic(), done))
        seconds = time.monotonic() - since
        return (done - first) / seconds if seconds > 0.5 else 0.0


class _Bars:
    def __init__(self, bars: Progress):
        self._bars, self._stages = bars, _Stages()
        self._tasks: dict[str, TaskID] = {}

    def __call__(self, stage: str, done: int, total: int, failed: int = 0) -> None:
        rate = self._stages.rate(stage, done)
        told, lost = f"{rate:.1f}/s" if rate else "", f"{failed} failed" if failed else ""
        if stage not in self._tasks:
            self._tasks[stage] = self._bars.add_task(stage, total=total, rate=told, failed=lost)
        self._bars.update(self._tasks[stage], completed=done, total=total, rate=told, failed=lost)


class _Lines:
    def __init__(self) -> None:
        self._stages, self._said, self._last = _Stages(), 0.0, ""

    def __call__(self, stage: str, done: int, total: int, failed: int = 0) -> None:
        rate = self._stages.rate(stage, done)
        if time.monotonic() - self._said < EVERY_S and done != total:
            return
        self._said = time.monotonic()
        parts = [f"{stage}: {done} of {'' if done == total else 'about '}{total}"]
        if rate and done != total:
            parts += [f"{rate:.1f}/s", f"about {(total - done) / rate:.0f} s left"]
        if failed:
            parts.append(f"{failed} failed")
        line = ", ".join(parts)
        if line != self._last:
            self._last = line
            print(line, flush=True)


MOST_LINES = 20
"""Failures that are listed."""


def show_status(console: Console, folder: Path) -> None:
    """Count what is there, against what the folder's scenario asks for.

    Raises:
        InvalidValueError: not a results folder.
    """
    manifest = read_json(folder / "manifest.json")
    if manifest is None:
        allowed = "a folder with a manifest.json, as `heft run` and `heft estimate` make it"
        raise InvalidValueError("DIR", str(folder), allowed)
    try:
        with exclusive(folder):
            state = "nothing is running here"
    except FolderInUseError:
        state = "a run is writing here now"
    trials = Counter(path.name for path in folder.glob("trials/*/*") if path.name in ("trial.json", "error.txt"))
    done = sorted(folder.glob("estimates/*/result.json"))
    finished = {path.parent for path in done}
    failed = [path for path in folder.glob("estimates/*/error.txt") if path.parent not in finished]
    of_trials, of_estimates = _asked(manifest)
    console.print(f"{folder}: {state}", highlight=False)
    console.print(
        f"trials: {trials['trial.json']} done{of_trials}, {trials['error.txt']} failed; "
        f"estimates: {len(done)} done{of_estimates}, {len(failed)} failed",
        highlight=False,
    )
    for error in [*failed, *folder.glob("trials/*/error.txt")][:MOST_LINES]:
        lines = error.read_text(encoding="utf-8").strip().splitlines()
        console.print(f"{error}: {lines[-1] if lines else 'no reason given'}", highlight=False, soft_wrap=True)


def _asked(manifest: dict[str, Any]) -> tuple[str, str]:
    """How many trials and estimates the folder's scenario asks for; nothing where its trials were measured."""
    try:
        plan = Plan.of(Scenario.model_validate(manifest["scenario"]))
    except ValidationError:
        return "", ""
    return f" of about {plan.trials}", f" of about {plan.estimates}"
