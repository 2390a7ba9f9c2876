"""`heft status`: how far a results folder is."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Any

from pydantic import ValidationError
from rich.console import Console

from scenarios.folder_lock import FolderInUseError, exclusive
from scenarios.plan import Plan
from scenarios.schema import Scenario
from scenarios.store import read_json
from testbed.errors import InvalidValueError

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
