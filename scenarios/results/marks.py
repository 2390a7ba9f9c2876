"""Marks of files that were read whole: as in git's index, a file is not read again until the system shows a change."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterable
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

from testbed.files import UNSEALED, load_sealed, read_table, unless_damaged, write_sealed

Marks = dict[str, str]
"""Mark by the name of a folder, such as estimates/<key>."""


def mark_of(files: Iterable[str | Path]) -> str:
    """Mark of some files: a digest of inode, size, and time of change of each; empty where one is missing."""
    try:
        found = [os.stat(file) for file in files]
    except OSError:
        return ""
    states = [(each.st_ino, each.st_size, each.st_mtime_ns, each.st_ctime_ns) for each in found]
    return hashlib.blake2b(repr(states).encode(), digest_size=8).hexdigest()


def load_marks(root: Path) -> Marks:
    """Marks that the last run of a results folder left; none where they are missing or damaged."""
    file = root / "notes" / "marks.parquet"
    if not file.is_file():
        return {}
    table = unless_damaged(lambda: load_sealed(file, "table of marks", read_table), "all files are read again")
    return {} if table is None else dict(zip(table["name"].to_pylist(), table["mark"].to_pylist(), strict=True))


def write_marks(root: Path, marks: Marks) -> None:
    """Write the marks of a results folder."""
    table = pa.table({"name": list(marks), "mark": list(marks.values())})
    table = table.replace_schema_metadata({b"checksum": UNSEALED.encode()})
    file = root / "notes" / "marks.parquet"
    write_sealed(file, lambda part: pq.write_table(table, part, compression="zstd"))
