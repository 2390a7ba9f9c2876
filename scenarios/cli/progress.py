"""heft status, and the progress of a run: bars on a terminal, a plain line now and then elsewhere."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro
from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    TaskID,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.progress import Progress as Bars

from testbed.errors import InvalidValueError

if TYPE_CHECKING:
    from scenarios.study.experiment import Progress

EVERY_S = 10.0
"""Between two plain lines, s."""


@contextmanager
def show_progress(console: Console) -> Iterator[Progress]:
    """Show how far a run is, its throughput and the time left."""
    if console.is_terminal:
        with Bars(
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
    """Start and first count of each stage: what is there from an earlier run is no throughput."""

    def __init__(self) -> None:
        self._begun: dict[str, tuple[float, int]] = {}

    def rate(self, stage: str, done: int) -> float:
        """Number done a second since the stage began; 0 where nothing is known yet."""
        since, first = self._begun.setdefault(stage, (time.monotonic(), done))
        seconds = time.monotonic() - since
        return (done - first) / seconds if seconds > 0.5 else 0.0


class _Bars:
    def __init__(self, bars: Bars):
        self._bars, self._stages = bars, _Stages()
        self._tasks: dict[str, TaskID] = {}

    def __call__(self, stage: str, done: int, total: int, failed: int = 0) -> None:
        rate = self._stages.rate(stage, done)
        speed, lost = f"{rate:.1f}/s" if rate else "", f"{failed} failed" if failed else ""
        if stage not in self._tasks:
            self._tasks[stage] = self._bars.add_task(stage, total=total, rate=speed, failed=lost)
        self._bars.update(self._tasks[stage], completed=done, total=total, rate=speed, failed=lost)


class _Lines:
    def __init__(self) -> None:
        self._stages, self._printed, self._last = _Stages(), 0.0, ""

    def __call__(self, stage: str, done: int, total: int, failed: int = 0) -> None:
        rate = self._stages.rate(stage, done)
        if time.monotonic() - self._printed < EVERY_S and done != total:
            return
        self._printed = time.monotonic()
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


def status(folder: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="DIR")]) -> None:
    """Say how far a results folder is: trials and estimates done, failures with their reasons.

    Args:
        folder: of a run, finished, running or stopped.
    """
    from scenarios.results.store import FolderInUseError, exclusive, read_json

    console, manifest = Console(), read_json(folder / "manifest.json")
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
    """Numbers of trials and estimates in the folder's scenario; empty where its trials were measured."""
    from pydantic import ValidationError

    from scenarios.config import Scenario
    from scenarios.study.dry_run import DryRun

    try:
        plan = DryRun.of(Scenario.model_validate(manifest["scenario"]))
    except ValidationError:
        return "", ""
    return f" of about {plan.trials}", f" of about {plan.estimates}"
