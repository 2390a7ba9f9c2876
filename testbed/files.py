"""Files: found in a library or by path, and written whole or not at all."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

from testbed.errors import InvalidValueError, nearest


def find_file(name_or_path: str | Path, library: Path, what: str) -> Path:
    """A library name ("L2") or a path to a TOML file, as a path.

    Raises:
        InvalidValueError: no such name and no such file; the message lists the names and the nearest one.
    """
    text = str(name_or_path)
    if text.endswith(".toml") or "/" in text:
        path = Path(text)
        if not path.is_file():
            raise InvalidValueError(what, text, "a path to an existing .toml file")
        return path
    path = library / f"{text}.toml"
    if path.is_file():
        return path
    names = library_names(library)
    allowed = f"one of {', '.join(names)}{nearest(text, names, 0.4)}, or a path to a .toml file"
    raise InvalidValueError(what, text, allowed)


def library_names(library: Path) -> list[str]:
    """Names that a library folder offers, sorted."""
    return sorted(path.stem for path in library.glob("*.toml"))


def write_whole(path: Path, write: Any) -> None:
    """Write a file beside its place, sync and rename: a reader sees the old file, the new one, or none."""
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        part.unlink(missing_ok=True)
        # made here: not every library says why it cannot open a file, and a link that lies in wait is not followed
        os.close(os.open(part, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o666))
        write(part)
        with open(part, "rb+") as file:
            os.fsync(file.fileno())
        os.replace(part, path)
    except OSError as error:  # a full disk names no file, and nobody knows the part
        if error.errno is not None and error.filename in (None, str(part)):
            error.filename = str(path)
        raise
    finally:
        part.unlink(missing_ok=True)
