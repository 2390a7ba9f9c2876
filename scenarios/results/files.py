"""Files of a results folder: JSON, and the lock of the one run that may write there. It loads quickly."""

from __future__ import annotations

import errno
import fcntl
import json
import os
import socket
import stat
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import IO, Any

import numpy as np

from testbed.errors import HeftError, InvalidValueError, listed
from testbed.files import UNSEALED, DamagedFileError, load_sealed, unless_damaged, write_sealed

LOCK = ".lock"
"""Lock file of a results folder, held while a run writes there; the system releases it when the process ends."""

_MANIFEST = {
    "scenario": dict,
    "secret": str,
    "packages": dict,
    "expected": dict,
    "contents": dict,
    "name": str,
    "command": str,
    "finished": bool,
}
_SCENARIO = {"objects": list, "sensing": list, "methods": dict}
_EXPECTED = {"trials": int, "estimates": int}
STAGES = {"trials": "trial.json", "estimates": "result.json"}
"""File that marks a trial, or an estimate, as done, by the name of their folder."""
SHOWN, MOST_KEYS = 8, 6
"""Number of letters of a key, and number of keys, in an error."""


class FolderInUseError(HeftError):
    """Another run writes to the results folder."""


def inside(root: Path, *names: str) -> Path:
    """Path of a file in a results folder, by names that may come from a file.

    Raises:
        HeftError: a name or a link leads out of the folder.
    """
    path = root.joinpath(*names)
    plain = all(name not in ("", ".", "..") and not {"/", "\0"} & {*name} for name in names)
    linked = plain and any(os.path.islink(root.joinpath(*names[:end])) for end in range(1, len(names)))
    if not plain or (linked and not path.parent.resolve().is_relative_to(root.resolve())):
        raise HeftError(f"{root}: {'/'.join(names)!r} leads out of the folder")
    return path


def read_json(path: Path) -> dict[str, Any] | None:
    """Content of a JSON file, without its checksum; None where there is no file.

    Raises:
        DamagedFileError: it is damaged.
    """

    def parsed(data: bytes) -> dict[str, Any]:
        content = json.loads(data)
        del content["checksum"]
        return content

    return load_sealed(path, "JSON file", parsed) if os.path.lexists(path) else None


def stored(root: Path, stage: str, then: str = "left out") -> Iterator[tuple[Path, dict[str, Any] | None]]:
    """Folder of each finished trial or estimate, sorted, and the content of its file; None where it is damaged.

    Args:
        root: results folder.
        stage: "trials" or "estimates".
        then: consequence for a damaged one, in the warning.
    """
    for path in sorted(root.glob(f"{stage}/*/{STAGES[stage]}")):
        yield path.parent, unless_damaged(partial(read_json, path), then)


def done_keys(root: Path, stage: str) -> list[str]:
    """Keys of the "trials" or "estimates" that are done, sorted."""
    return sorted(path.parent.name for path in root.glob(f"{stage}/*/{STAGES[stage]}"))


def errors_left(root: Path, stage: str) -> list[Path]:
    """Files error.txt of the "trials" or "estimates" that failed and are still not done, sorted."""
    errors = sorted(root.glob(f"{stage}/*/error.txt"))
    return [path for path in errors if not (path.parent / STAGES[stage]).is_file()]


def check_results(folder: Path) -> None:
    """Raise InvalidValueError where there is no such results folder."""
    if not folder.is_dir():
        raise InvalidValueError("DIR", str(folder), "a results folder; `heft run` makes one")


def tally(statuses: Iterable[str]) -> str:
    """Number of each status that is not ok, in words, the most frequent first; empty where all are ok."""
    amiss = Counter(status.replace("_", " ") for status in statuses if status != "ok")
    return ", ".join(f"{count} {status}" for status, count in amiss.most_common())


def read_manifest(folder: Path) -> dict[str, Any] | None:
    """Manifest of a results folder, with fields of the right types; None where there is none.

    Raises:
        DamagedFileError: it is damaged, or of another version.
    """
    path = folder / "manifest.json"
    found = read_json(path) or {}
    for place, kinds in (("", _MANIFEST), ("scenario", _SCENARIO), ("expected", _EXPECTED)):
        table = (found.get(place) or {}) if place else found
        for name, kind in kinds.items():
            if not isinstance(table.get(name), kind | None):
                raise DamagedFileError(f"{path}: not of this version of heft: {name} is a {type(table[name]).__name__}")
    return found or None


def write_json(path: Path, data: dict[str, Any]) -> None:
    """Write JSON with its checksum, whole or not at all; NaN becomes null."""
    text = json.dumps(plain(data) | {"checksum": UNSEALED}, indent=1) + "\n"
    write_sealed(path, lambda part: part.write_text(text, encoding="utf-8"))


def plain(value: Any) -> Any:
    """Value as JSON has it: NaN and infinity become null, arrays lists."""
    if isinstance(value, dict):
        return {str(k): plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple | np.ndarray):
        return [plain(v) for v in value]
    if isinstance(value, float | np.floating):
        return float(value) if np.isfinite(value) else None
    return value.item() if isinstance(value, np.generic) else value


def some_keys(keys: Sequence[str]) -> str:
    """Beginnings of the first keys, for a message."""
    return listed([key[:SHOWN] for key in keys], MOST_KEYS)


def check_unambiguous(field: str, beginning: str, keys: Sequence[str]) -> None:
    """Raise InvalidValueError where more than one key has a beginning; `field` is what the command line calls it."""
    if len(keys) > 1:
        several = f"{len(keys)} begin so ({some_keys(keys)})"
        raise InvalidValueError(field, beginning, f"more of the key, this is ambiguous: {several}")


@contextmanager
def exclusive(folder: Path) -> Iterator[None]:
    """Lock a results folder for a run, and create it if it is missing; adding whole files needs no lock.

    Raises:
        FolderInUseError: another run holds it.
        OSError: the folder cannot be made or written to.
    """
    new = not folder.exists()
    folder.mkdir(parents=True, exist_ok=True)
    with _opened(folder / LOCK, os.O_RDWR | os.O_CREAT, "r+") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            file.seek(0)
            holder = file.read().strip() or "unknown"
            raise FolderInUseError(
                f"{folder}: another run ({holder}) is writing here; wait for it, or choose another folder with --out"
            ) from None
        file.truncate(0)
        file.write(f"process {os.getpid()} on {socket.gethostname()}\n")
        file.flush()
        try:
            yield
        finally:
            if new and os.listdir(folder) == [LOCK]:  # refused before anything was written: leave no trace
                (folder / LOCK).unlink()
                folder.rmdir()


def _opened(lock: Path, flags: int, mode: str) -> IO[str]:
    """Open the lock file; links, pipes and other names of a file are refused.

    Raises:
        HeftError: it is not a plain file with one name.
        OSError: it cannot be opened.
    """
    try:
        number = os.open(lock, flags | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC, 0o666)
    except OSError as error:
        if error.errno in (errno.ELOOP, errno.ENXIO):
            raise HeftError(f"{lock}: not a file of heft's; delete it") from None
        raise
    found = os.fstat(number)
    if not stat.S_ISREG(found.st_mode) or found.st_nlink > 1:
        os.close(number)
        raise HeftError(f"{lock}: not a file of heft's; delete it")
    return open(number, mode, encoding="utf-8")


def is_held(folder: Path) -> bool:
    """True if a run is writing to a results folder; the check writes nothing."""
    try:
        with _opened(folder / LOCK, os.O_RDONLY, "r") as file:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except FileNotFoundError:
        return False
    except BlockingIOError:
        return True
    return False
