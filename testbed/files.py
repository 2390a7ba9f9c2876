"""Files: lookup by name or path, bounded reading, atomic writing, and checksums.

A sealed file contains its own checksum: the SHA-256 of all its bytes, with zeros in place of the checksum. It detects
damage, not forgery.
"""

from __future__ import annotations

import errno
import fcntl
import hashlib
import os
import re
import stat
import warnings
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from testbed.errors import HeftError, InvalidValueError, nearest

if TYPE_CHECKING:
    import pyarrow as pa

T = TypeVar("T")
_MARK = b"heft-sha256:"
_POINTER = b"version https://git-lfs"
_PART = re.compile(r"\..+\.\d+\.part")
UNSEALED = _MARK.decode() + "0" * 64
"""Placeholder of the checksum in a file for `write_sealed`: in a field, an entry of metadata, or a comment."""
MOST_BYTES = 200 * 2**20
"""Largest size of a file that is read [B]."""
MOST_VALUES = 20_000_000
"""Largest number of values of a table that is read: a record of 15 min at 500 Hz, or a sweep of 400,000 rows."""


class DamagedFileError(HeftError):
    """A stored file that is missing, was changed after it was written, or is of another version of heft."""


class DamagedFileWarning(UserWarning):
    """A damaged file that is left out, or written again."""


_default_format = warnings.formatwarning


def _format(message: Warning | str, category: type[Warning], *rest: Any, **named: Any) -> str:
    return (
        f"heft: {message}\n" if category is DamagedFileWarning else _default_format(message, category, *rest, **named)
    )


def print_damage_plainly() -> None:
    """Print this process's warnings of damaged files like heft's errors, one line each."""
    warnings.formatwarning = _format


def find_file(name_or_path: str | Path, library: Path, what: str) -> Path:
    """Path of a TOML file, from a name in a library ("L2") or a path.

    Raises:
        InvalidValueError: no such name or file; the message lists the names and the nearest one.
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
    """Names in a library folder, sorted."""
    return sorted(path.stem for path in library.glob("*.toml"))


def write_whole(path: Path, write: Any) -> None:
    """Write a file atomically: `write` writes a part file, which is synced and renamed to `path`."""
    path.parent.mkdir(parents=True, exist_ok=True)
    part, held = path.with_name(f".{path.name}.{os.getpid()}.part"), None
    try:
        part.unlink(missing_ok=True)
        # created here: not every library reports why it cannot open a file, and O_EXCL follows no link
        held = os.open(part, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o666)
        with suppress(OSError):  # a file system without locks
            fcntl.flock(held, fcntl.LOCK_EX)  # `remove_leftovers` removes unlocked part files
        write(part)
        with open(part, "rb+") as file:
            os.fsync(file.fileno())
        os.replace(part, path)
    except OSError as error:  # a full disk names no file; the name of the part file is internal
        if error.errno is not None and error.filename in (None, str(part)):
            error.filename = str(path)
        raise
    finally:
        part.unlink(missing_ok=True)
        if held is not None:
            os.close(held)


def write_text(path: Path, text: str) -> None:
    """Write a text as UTF-8, atomically."""
    write_whole(path, lambda part: part.write_text(text, encoding="utf-8"))


def remove_leftovers(folder: Path, depth: int = 0) -> None:
    """Remove part files of killed writers from a folder, and from its subfolders to a depth."""
    try:
        with os.scandir(folder) as entries:
            found = list(entries)
    except OSError:  # missing or not readable
        return
    for entry in found:
        if depth and entry.is_dir(follow_symlinks=False):
            remove_leftovers(Path(entry.path), depth - 1)
        elif _PART.fullmatch(entry.name):
            _remove_unless_held(entry.path)


def _remove_unless_held(part: str) -> None:
    try:
        found = os.open(part, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK)
    except OSError:  # a link, or removed meanwhile
        return
    try:
        fcntl.flock(found, fcntl.LOCK_EX | fcntl.LOCK_NB)
        Path(part).unlink(missing_ok=True)
    except OSError:  # locked by its writer, or a file system without locks
        pass
    finally:
        os.close(found)


def write_sealed(path: Path, write: Callable[[Path], Any]) -> None:
    """Write a file atomically, with its checksum in place of the last `UNSEALED` that `write` has written."""

    def sealed(part: Path) -> None:
        write(part)
        data = part.read_bytes()
        with open(part, "r+b") as file:
            file.seek(data.rindex(UNSEALED.encode()) + len(_MARK))
            file.write(hashlib.sha256(data).hexdigest().encode())

    write_whole(path, sealed)


def read_file(path: Path, most: int = MOST_BYTES) -> bytes:
    """Content of a regular file of at most `most` bytes.

    Raises:
        OSError: a file that is missing, unreadable or larger, a pipe, or a device.
    """
    descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    found = os.fstat(descriptor)
    if not stat.S_ISREG(found.st_mode):
        os.close(descriptor)
        raise OSError(errno.EINVAL, "not a plain file", str(path))
    with open(descriptor, "rb") as file:
        if found.st_size > most:
            size = f"{found.st_size / 2**20:.0f} MiB, more than the {most / 2**20:g} that are read"
            raise OSError(errno.EFBIG, size, str(path))
        return file.read(most)


def refuse_pointer(path: Path, field: str) -> None:
    """Refuse a Git LFS pointer in place of a file.

    Raises:
        InvalidValueError: a Git LFS pointer.
    """
    with suppress(OSError), path.open("rb") as file:  # an unreadable file is reported when it is read
        if file.read(len(_POINTER)) == _POINTER:
            allowed = "the file itself, not its Git LFS pointer; `git lfs pull` gets it"
            raise InvalidValueError(field, str(path), allowed)


def load_sealed(path: Path, what: str, parse: Callable[[bytes], T]) -> T:
    """Parsed content of a sealed file, after a check of its checksum.

    Args:
        path: the file.
        what: kind of file, for the error.
        parse: parser of the bytes.

    Raises:
        DamagedFileError: a file that is missing, truncated, changed, or refused by `parse`.
    """
    try:
        data = read_file(path)
    except OSError as error:
        raise DamagedFileError(f"{path}: not a whole {what}: {error.strerror}") from None
    at = data.rfind(_MARK) + len(_MARK)
    digest = hashlib.sha256(data[:at])
    digest.update(b"0" * 64)
    digest.update(data[at + 64 :])
    if at < len(_MARK) or data[at : at + 64] != digest.hexdigest().encode():
        raise DamagedFileError(f"{path}: not a whole {what}: it is not as it was written (checksum)")
    try:
        return parse(data)
    except Exception as error:  # a file of another version or program: a parser may raise anything
        raise DamagedFileError(f"{path}: not a whole {what}: {error}") from None


def read_table(data: bytes) -> pa.Table:
    """Table of a Parquet file.

    Raises:
        ValueError: not Parquet, or more than `MOST_VALUES` values, which may be compressed to a few bytes.
    """
    import pyarrow as pa  # noqa: PLC0415  this module loads quickly
    import pyarrow.parquet as pq  # noqa: PLC0415

    file = pq.ParquetFile(pa.BufferReader(data))
    values = file.metadata.num_rows * file.metadata.num_columns
    if values > MOST_VALUES:
        raise ValueError(f"{values} values, more than the {MOST_VALUES} that are read")
    return file.read()


def write_table(path: Path, table: pa.Table, metadata: Mapping[str, str] | None = None, **options: Any) -> None:
    """Write a table as a sealed Parquet file.

    Args:
        path: the file.
        table: the table; its own metadata are dropped.
        metadata: entries in addition to the checksum.
        options: options of `pyarrow.parquet.write_table`.
    """
    import pyarrow.parquet as pq  # noqa: PLC0415  this module loads quickly

    sealed = table.replace_schema_metadata({**(metadata or {}), "checksum": UNSEALED})
    write_sealed(path, lambda part: pq.write_table(sealed, part, compression="zstd", **options))


def unless_damaged(read: Callable[[], T], then: str) -> T | None:
    """Result of `read`; None and a warning if a file is damaged, with the consequence `then` in its message."""
    try:
        return read()
    except DamagedFileError as error:
        warnings.warn(f"{error}; {then}", DamagedFileWarning, stacklevel=2)
        return None
