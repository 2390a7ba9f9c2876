"""Files: found in a library or by path, read within bounds, written whole or not at all, and sealed by a checksum.

A stored file holds its own checksum: the SHA-256 of all its bytes, the checksum itself taken as zeros. It shows damage,
not forgery.
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
"""Place for the checksum in what `write_sealed` is given to write: a field, an entry of metadata, a comment."""
MOST_BYTES = 200 * 2**20
"""Largest file that is read."""
MOST_VALUES = 20_000_000
"""Values in the largest table that is read: a record of a quarter of an hour at 500 Hz, or a sweep of 400,000 rows."""


class DamagedFileError(HeftError):
    """A stored file that is missing, is not as it was written, or is of another version of heft."""


class DamagedFileWarning(UserWarning):
    """A damaged file that is left out, or made again."""


_usual_format = warnings.formatwarning


def _format(message: Warning | str, category: type[Warning], *rest: Any, **named: Any) -> str:
    return f"heft: {message}\n" if category is DamagedFileWarning else _usual_format(message, category, *rest, **named)


def print_damage_plainly() -> None:
    """Let this process print warnings of damaged files as heft prints its errors, a line each."""
    warnings.formatwarning = _format


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
    part, held = path.with_name(f".{path.name}.{os.getpid()}.part"), None
    try:
        part.unlink(missing_ok=True)
        # made here: not every library says why it cannot open a file, and a link that lies in wait is not followed
        held = os.open(part, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o666)
        with suppress(OSError):  # a file system without locks
            fcntl.flock(held, fcntl.LOCK_EX)  # until it is whole: `remove_leftovers` takes what is not locked
        write(part)
        with open(part, "rb+") as file:
            os.fsync(file.fileno())
        os.replace(part, path)
    except OSError as error:  # a full disk names no file, and the part file is ours alone
        if error.errno is not None and error.filename in (None, str(part)):
            error.filename = str(path)
        raise
    finally:
        part.unlink(missing_ok=True)
        if held is not None:
            os.close(held)


def write_text(path: Path, text: str) -> None:
    """Write a text as UTF-8, as `write_whole` does."""
    write_whole(path, lambda part: part.write_text(text, encoding="utf-8"))


def remove_leftovers(folder: Path, depth: int = 0) -> None:
    """Remove from a folder, and those in it to a depth, what writers that were killed have left, and nothing else."""
    try:
        with os.scandir(folder) as entries:
            found = list(entries)
    except OSError:  # it is not there, or not ours
        return
    for entry in found:
        if depth and entry.is_dir(follow_symlinks=False):
            remove_leftovers(Path(entry.path), depth - 1)
        elif _PART.fullmatch(entry.name):
            _remove_unless_held(entry.path)


def _remove_unless_held(part: str) -> None:
    try:
        found = os.open(part, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK)
    except OSError:  # a link, or gone
        return
    try:
        fcntl.flock(found, fcntl.LOCK_EX | fcntl.LOCK_NB)
        Path(part).unlink(missing_ok=True)
    except OSError:  # somebody is writing it, or there is no telling
        pass
    finally:
        os.close(found)


def write_sealed(path: Path, write: Callable[[Path], Any]) -> None:
    """Write a file as `write_whole` does, and fill in its checksum where `write` has put `UNSEALED` last."""

    def sealed(part: Path) -> None:
        write(part)
        data = part.read_bytes()
        with open(part, "r+b") as file:
            file.seek(data.rindex(UNSEALED.encode()) + len(_MARK))
            file.write(hashlib.sha256(data).hexdigest().encode())

    write_whole(path, sealed)


def read_file(path: Path, most: int = MOST_BYTES) -> bytes:
    """Content of a plain file of at most so many bytes.

    Raises:
        OSError: no file, one that cannot be read, a pipe or a device, or a larger one.
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
    """Refuse a file that stands for another in a repository.

    Raises:
        InvalidValueError: a pointer of Git LFS.
    """
    with suppress(OSError), path.open("rb") as file:  # who reads it says why it cannot be read
        if file.read(len(_POINTER)) == _POINTER:
            allowed = "the file itself, not its Git LFS pointer; `git lfs pull` gets it"
            raise InvalidValueError(field, str(path), allowed)


def load_sealed(path: Path, what: str, parse: Callable[[bytes], T]) -> T:
    """A stored file as `parse` makes it of its bytes, once they are known to be those that were written.

    Args:
        path: the file.
        what: the kind of file, for the error.
        parse: reader of its bytes.

    Raises:
        DamagedFileError: missing, cut short, changed, or not what `parse` reads.
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
    except Exception as error:  # of another version, or of somebody else: a parser may raise anything
        raise DamagedFileError(f"{path}: not a whole {what}: {error}") from None


def read_table(data: bytes) -> pa.Table:
    """Table of a Parquet file.

    Raises:
        ValueError: not Parquet, or more than `MOST_VALUES` values, which may be packed into a few bytes.
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
        table: the table; its own metadata are left out.
        metadata: entries beside the checksum.
        options: options of `pyarrow.parquet.write_table`.
    """
    import pyarrow.parquet as pq  # noqa: PLC0415  this module loads quickly

    sealed = table.replace_schema_metadata({**(metadata or {}), "checksum": UNSEALED})
    write_sealed(path, lambda part: pq.write_table(sealed, part, compression="zstd", **options))


def unless_damaged(read: Callable[[], T], then: str) -> T | None:
    """Result of reading; None if a file is damaged, with a warning that names it and the consequence."""
    try:
        return read()
    except DamagedFileError as error:
        warnings.warn(f"{error}; {then}", DamagedFileWarning, stacklevel=2)
        return None
