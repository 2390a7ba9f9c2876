"""Recorded trials played back: a `TrialRunner` whose bench is a folder of trajectories."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

import pyarrow as pa
import pyarrow.parquet as pq

from testbed.actions.base import Action, action_from_dict
from testbed.errors import InfeasibleTrialError, InvalidValueError
from testbed.files import DamagedFileError, load_sealed
from testbed.sensing.noise import draw_sensing
from testbed.sensing.presets import preset
from testbed.trajectory import Trajectory, load_trajectory
from testbed.trial import Trial
from testbed.worlds.seeds import new_secret

UNNAMED = "an object without a name"
"""Object name of a trial whose folder does not name one; it matches no trial."""
_TOLERANCE = 1e-6
_MOST_LISTED = 8


@dataclass(frozen=True)
class Recording:
    """Header of a recorded trajectory; the samples stay in their file."""

    path: Path
    """Parquet file."""
    action: Action
    """Executed action."""
    object: str | None
    """Name of the object, if known."""
    support: str | None
    """Name of the support model, if known."""

    def fits(self, trial: Trial) -> bool:
        """True if it has the action of a trial, and its object and support as far as they are known."""
        return (
            self.object in (None, trial.object.name)
            and self.support in (None, trial.support.name)
            and _same(self.action.to_dict(), trial.action.to_dict())
        )

    @property
    def description(self) -> str:
        """Object and action in a few words."""
        settings = self.action.to_dict()
        kind = settings.pop("kind")
        rest = ", ".join(f"{name} {_short(value)}" for name, value in settings.items() if value is not None)
        return f"{self.object or 'any object'}: {kind}{' (' if rest else ''}{rest}{')' if rest else ''}"


def _short(value: Any) -> str:
    """Numbers to four digits, also in a list of them."""
    if isinstance(value, list | tuple):
        return f"({', '.join(map(_short, value))})"
    return f"{value:.4g}" if isinstance(value, float) else str(value)


class ReplayRunner:
    """A `TrialRunner` that gives back what was recorded, repeats in the order of recording.

    A simulated record of a results folder has no sensing in it yet: it gets the trial's own draw, as in a simulation.
    What a bench measured is given back as it is. Entering it starts every repeat over again.
    """

    def __init__(self, folder: str | Path, secret: str | None = None):
        """Look through a folder; no record is read yet.

        Args:
            folder: a results folder, or a folder of trajectory files. Within it, files are taken in order of their
                `recorded` provenance, then of their names.
            secret: as `SimulationRunner` takes it.

        Raises:
            InvalidValueError: no such folder, or nothing recorded in it.
            DamagedFileError: a file that is no trajectory, or a damaged trial.json.
        """
        root = Path(folder)
        finished = [p.with_name("trajectory.parquet") for p in sorted((root / "trials").glob("*/trial.json"))]
        files = finished or sorted(root.glob("*.parquet"))
        if not files:
            raise InvalidValueError("replay folder", str(folder), "a results folder, or one of trajectory files")
        recorded = sorted((_recording(path) for path in files), key=lambda found: (found[0], found[1].path))
        self.recordings: tuple[Recording, ...] = tuple(recording for _, recording in recorded)
        """Recordings in order."""
        self._folder, self._secret = root, new_secret() if secret is None else secret
        self._played: set[Path] = set()

    def __enter__(self) -> Self:
        self._played.clear()
        return self

    def __exit__(self, *_: object) -> None:
        return None

    def run(self, trial: Trial) -> Trajectory:
        """The next recording of this trial.

        Raises:
            InfeasibleTrialError: it was never recorded, or all its repeats have been played; the message says what
                there is.
            DamagedFileError: its file is damaged.
        """
        fitting = [r for r in self.recordings if r.fits(trial)]
        left = [r for r in fitting if r.path not in self._played]
        if not left:
            raise InfeasibleTrialError(f"replay: {self._missing(trial, len(fitting))}")
        self._played.add(left[0].path)
        trajectory = load_trajectory(left[0].path)
        if trajectory.is_clean:
            return draw_sensing(trajectory, preset(trial.sensing), trial.seed_under(self._secret))
        return trajectory

    def _missing(self, trial: Trial, played: int) -> str:
        wanted = Recording(Path(), trial.action, trial.object.name, trial.support.name).description
        if played:
            return f"{wanted}: all {played} recordings have been played; enter the runner again to start over"
        there = list(dict.fromkeys(r.description for r in self.recordings))
        shown = "; ".join(there[:_MOST_LISTED]) + (f"; {len(there) - _MOST_LISTED} more" * (len(there) > _MOST_LISTED))
        return f"{self._folder} has no {wanted}, support {trial.support.name}; it has {shown}"


def _recording(path: Path) -> tuple[str, Recording]:
    """Time of recording, if known, and header of a trajectory file, without its samples."""
    try:
        header = json.loads((pq.read_schema(path).metadata or {})[b"heft"])
        action, provenance = action_from_dict(header["action"]), header["provenance"]
    except (OSError, pa.ArrowException, KeyError, ValueError, TypeError) as error:
        raise DamagedFileError(f"{path}: not a trajectory file: {error}") from None
    recording = Recording(path, action, _object_of(path, provenance), provenance.get("support"))
    return provenance.get("recorded", ""), recording


def _object_of(path: Path, provenance: Mapping[str, str]) -> str | None:
    """The object's name: from the record itself, or from the trial.json that a results folder has beside it."""
    if "object" in provenance:
        return provenance["object"]
    trial = path.with_name("trial.json")
    if not (path.name == "trajectory.parquet" and trial.is_file()):
        return None
    try:
        return str(load_sealed(trial, "trial file", json.loads)["names"]["object"])
    except (KeyError, TypeError):
        return UNNAMED


def _same(a: Any, b: Any) -> bool:
    """True if two plain values are equal, numbers within rounding."""
    if isinstance(a, dict) and isinstance(b, dict):
        return a.keys() == b.keys() and all(_same(a[k], b[k]) for k in a)
    if isinstance(a, list | tuple) and isinstance(b, list | tuple):
        return len(a) == len(b) and all(_same(x, y) for x, y in zip(a, b, strict=True))
    if isinstance(a, float) and isinstance(b, float):
        return math.isclose(a, b, rel_tol=_TOLERANCE, abs_tol=_TOLERANCE)
    return a == b
