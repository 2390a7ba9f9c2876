"""A results folder's files: which folder an estimate is in, its losses, why it failed, and the trials behind it."""

from __future__ import annotations

import json
import zipfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from estimators.evaluation.statistics import AXIS, Row

MOST_TRACES = 40
"""Estimates of a method whose losses are read."""
_IDENTITY = ("object", "support", "sensing", "seed", "seconds", "nad")
"""Together these tell an estimate from every other: no two take the same time to the nanosecond."""


@dataclass(frozen=True, eq=False)
class TrialFile:
    """One trial as it lies in the folder."""

    key: str
    status: str
    reason: str
    asked: dict[str, Any]
    """All that decided it."""

    def of_masses(self, masses: Sequence[float]) -> bool:
        """Whether its object's groups have these masses, kg."""
        each, groups = np.array(self.asked["object"]["mass"]), np.array(self.asked["object"]["mass_group"])
        return len(each) == len(masses) and bool(
            np.allclose(each * np.bincount(groups, minlength=len(each)), masses, rtol=1e-6)
        )

    def world(self) -> str:
        """The same for the same object on the same bench."""
        return json.dumps({name: said for name, said in self.asked.items() if name != "action"}, sort_keys=True)


@dataclass(frozen=True)
class ResultFiles:
    """A results folder."""

    root: Path

    def estimate_keys(self, rows: Sequence[Row]) -> list[str | None]:
        """Folder of each row's estimate: by its own column `key`, or else by the row that the folder holds."""
        found = {}
        if not all(isinstance(row.get("key"), str) for row in rows):
            for path in sorted((self.root / "estimates").glob("*/result.json")):
                said = _read(path)
                found[tuple(said.get(name) for name in _IDENTITY)] = path.parent.name
        return [row.get("key") or found.get(tuple(row.get(name) for name in _IDENTITY)) for row in rows]

    def losses(self, rows: Sequence[Row], keys: Sequence[str | None]) -> dict[str, dict[str, list[np.ndarray]]]:
        """Losses, (I,) each, by method and optimiser; of methods with many estimates an even choice."""
        of: dict[str, list[str]] = {}
        for row, key in zip(rows, keys, strict=True):
            if key is not None:
                of.setdefault(row["method"], []).append(key)
        read: dict[str, dict[str, list[np.ndarray]]] = {}
        for method, folders in of.items():
            chosen = np.unique(np.linspace(0, len(folders) - 1, MOST_TRACES).astype(int))
            for index in chosen:
                for name, loss in _losses(self.root / "estimates" / folders[index] / "estimate.npz").items():
                    read.setdefault(method, {}).setdefault(name, []).append(loss)
        return read

    def tracebacks(self) -> dict[str, str]:
        """Why trials and estimates failed that are still not done, by path."""
        found = {}
        for kind, done in (("trials", "trial.json"), ("estimates", "result.json")):
            for path in sorted((self.root / kind).glob("*/error.txt")):
                if not (path.parent / done).is_file():
                    text = path.read_text(encoding="utf-8", errors="replace")
                    found[f"{kind}/{path.parent.name}/error.txt"] = text
        return found

    def trials(self) -> list[TrialFile]:
        """Every whole trial."""
        trials = []
        for path in sorted((self.root / "trials").glob("*/trial.json")):
            said = _read(path)
            asked = said.get("asked")
            if isinstance(asked, dict) and isinstance(asked.get("object"), dict):
                told = str(said.get("status", "?")), str(said.get("reason", ""))
                trials.append(TrialFile(path.parent.name, *told, asked))
        return trials


def trial_keys_of(row: Row, trials: Sequence[TrialFile]) -> list[str]:
    """Folders of the trials behind an estimate: by its own column `trial_keys`, or else by support and masses.

    None where that does not tell: where something is swept, or several objects have the same masses.
    """
    said, masses = row.get("trial_keys"), row.get("true_mass_kg")
    if said is not None:
        return [str(key) for key in said]
    if masses is None or any(name.startswith(AXIS) for name in row):
        return []
    found = [trial for trial in trials if trial.asked.get("support") == row["support"] and trial.of_masses(masses)]
    return [trial.key for trial in found] if len({trial.world() for trial in found}) == 1 else []


def _losses(path: Path) -> dict[str, np.ndarray]:
    try:
        with np.load(path, allow_pickle=False) as arrays:
            return {name.removesuffix(".loss"): arrays[name] for name in arrays if name.endswith(".loss")}
    except (OSError, ValueError, zipfile.BadZipFile):
        return {}


def _read(path: Path) -> dict[str, Any]:
    try:
        said = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return said if isinstance(said, dict) else {}
