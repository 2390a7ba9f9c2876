"""Marks of files that were read whole: such a file is not read again until its inode, size or times change."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterable
from pathlib import Path

import pyarrow as pa

from testbed.files import load_sealed, read_table, unless_damaged, write_table

Marks = dict[str, str]
"""Mark by the name of a folder, such as estimates/<key>; never an empty one."""
ESTIMATE = ("result.json", "estimate.npz")
"""Files of an estimate."""


def mark_of(folder: str | Path, files: Iterable[str]) -> str:
    """Mark of some files of a folder: a digest of inode, size, and times of each; empty where one is missing."""
    try:
        found = [os.stat(f"{folder}/{file}") for file in files]
    except OSError:
        return ""
    states = [(each.st_ino, each.st_size, each.st_mtime_ns, each.st_ctime_ns) for each in found]
    return hashlib.blake2b(repr(states).encode(), digest_size=8).hexdigest()


def load_marks(root: Path) -> Marks:
    """Marks that the last run of a results folder left; none where they are missing or damaged."""
    file = _file_of(root)
    if not file.is_file():
        return {}
    table = unless_damaged(lambda: load_sealed(file, "table of marks", read_table), "all files are read again")
    return {} if table is None else dict(zip(table["name"].to_pylist(), table["mark"].to_pylist(), strict=True))


def write_marks(root: Path, marks: Marks) -> None:
    """Write the marks of a results folder."""
    write_table(_file_of(root), pa.table({"name": list(marks), "mark": list(marks.values())}))


def _file_of(root: Path) -> Path:
    return root / "notes" / "marks.parquet"
