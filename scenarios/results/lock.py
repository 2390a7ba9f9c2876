"""One run a folder."""

from __future__ import annotations

import fcntl
import os
import socket
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from testbed.errors import HeftError

LOCK = ".lock"
"""File in the results folder, held while a run writes there; the system lets go of it when the run ends or dies."""


class FolderInUseError(HeftError):
    """Another run writes to the results folder."""


@contextmanager
def exclusive(folder: Path) -> Iterator[None]:
    """Hold a results folder, made if it is not there.

    Raises:
        FolderInUseError: another run holds it.
        OSError: the folder cannot be made or written to.
    """
    new = not folder.exists()
    folder.mkdir(parents=True, exist_ok=True)
    with open(folder / LOCK, "a+", encoding="utf-8") as file:
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
