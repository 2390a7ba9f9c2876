"""Replay of recorded trials: a `TrialRunner` on a folder of trajectories."""

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
"""Object name of a record whose trial.json names no object; it matches no trial."""
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
        """True if action, and object and support if known, are those of a trial."""
        return (
            self.object in (None, trial.object.name)
            and self.support in (None, trial.support.name)
            and _same(self.action.to_dict(), trial.action.to_dict())
        )

    @property
    def description(self) -> str:
        """Short description of object and action."""
        settings = self.action.to_dict()
        kind = settings.pop("kind")
        rest = ", ".join(f"{name} {_short(value)}" for name, value in settings.items() if value is not None)
        return f"{self.object or 'any object'}: {kind}{' (' if rest else ''}{rest}{')' if rest else ''}"


def _short(value: Any) -> str:
    """Text of a value, or of a list, with four significant digits."""
    if isinstance(value, list | tuple):
        return f"({', '.join(map(_short, value))})"
    return f"{value:.4g}" if isinstance(value, float) else str(value)


class ReplayRunner:
    """`TrialRunner` that returns recorded trajectories, repeats in the order of recording.

    A simulated record of a results folder has no sensor errors yet: they are drawn as in a simulation of the trial.
    Records of a bench are returned unchanged. Entering the runner restarts all repeats.
    """

    def __init__(self, folder: str | Path, secret: str | None = None):
        """Read the headers of the records in a folder.

        Args:
            folder: a results folder, or a folder of trajectory files. The order of the files is that of their
                `recorded` provenance, then of their paths.
            secret: as for `SimulationRunner`.

        Raises:
            InvalidValueError: no such folder, or no records in it.
            DamagedFileError: a file that is not a trajectory, or a damaged trial.json.
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
        """Return the next recording of a trial.

        Raises:
            InfeasibleTrialError: no recording of the trial, or all of them have been played; the message lists the
                recordings.
            DamagedFileError: a damaged file.
        """
        fitting = [r for r in self.recordings if r.fits(trial)]
        unplayed = [r for r in fitting if r.path not in self._played]
        if not unplayed:
            raise InfeasibleTrialError(f"replay: {self._refusal(trial, len(fitting))}")
        self._played.add(unplayed[0].path)
        trajectory = load_trajectory(unplayed[0].path)
        if trajectory.is_clean:
            return draw_sensing(trajectory, preset(trial.sensing), trial.seed_under(self._secret))
        return trajectory

    def _refusal(self, trial: Trial, played: int) -> str:
        """Message for a trial of which `played` recordings have been played, and none is left."""
        wanted = Recording(Path(), trial.action, trial.object.name, trial.support.name).description
        if played:
            return f"{wanted}: all {played} recordings have been played; enter the runner again to start over"
        known = list(dict.fromkeys(r.description for r in self.recordings))
        shown = "; ".join(known[:_MOST_LISTED]) + (f"; {len(known) - _MOST_LISTED} more" * (len(known) > _MOST_LISTED))
        return f"{self._folder} has no {wanted}, support {trial.support.name}; it has {shown}"


def _recording(path: Path) -> tuple[str, Recording]:
    """Time of recording, if known, and header of a trajectory file, without its samples."""
    try:
        header = json.loads((pq.read_schema(path).metadata or {})[b"heft"])
        action, provenance = action_from_dict(header["action"]), header["provenance"]
        if not isinstance(provenance, dict) or not all(isinstance(text, str) for text in provenance.values()):
            raise InvalidValueError("provenance", provenance, "a table of texts")
    except (OSError, pa.ArrowException, KeyError, ValueError, TypeError) as error:
        raise DamagedFileError(f"{path}: not a trajectory file: {error}") from None
    recording = Recording(path, action, _object_of(path, provenance), provenance.get("support"))
    return provenance.get("recorded", ""), recording


def _object_of(path: Path, provenance: Mapping[str, str]) -> str | None:
    """Name of the object, from the record or from the trial.json beside it in a results folder; None if unknown."""
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
    """True if two plain values are equal, floats within `_TOLERANCE`."""
    if isinstance(a, dict) and isinstance(b, dict):
        return a.keys() == b.keys() and all(_same(a[k], b[k]) for k in a)
    if isinstance(a, list | tuple) and isinstance(b, list | tuple):
        return len(a) == len(b) and all(_same(x, y) for x, y in zip(a, b, strict=True))
    if isinstance(a, float) and isinstance(b, float):
        return math.isclose(a, b, rel_tol=_TOLERANCE, abs_tol=_TOLERANCE)
    return a == b
