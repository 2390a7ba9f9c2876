"""`heft export`: an estimate as a file for another simulator, with all that is known of its errors beside it."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from estimators.evaluation.statistics import Row
from scenarios.results.estimates import estimate_shown, rows_in
from testbed.errors import InvalidValueError
from testbed.objects.export import Exported, to_mjcf, to_object_file, to_sidecar, to_urdf
from testbed.trajectory import write_whole

Format = Literal["mjcf", "urdf", "toml"]
_ENDING = {"mjcf": "xml", "urdf": "urdf", "toml": "toml"}


def export(folder: Path, beginning: str, kind: Format, out: Path | None, *, inertial: bool) -> list[Path]:
    """Write an estimate and its sidecar; their paths.

    Args:
        folder: results folder.
        beginning: of the estimate's key.
        kind: of the file.
        out: its path; in folder/exports if None.
        inertial: one inertial for the whole instead of a mass a block.

    Raises:
        InvalidValueError: no such estimate, one without an answer, or an object that the format cannot hold.
    """
    row = _row_of(folder, beginning)
    exported = exported_of(folder, row)
    if kind == "toml":
        if inertial:
            raise InvalidValueError("--inertial", "--format toml", "mjcf or urdf: heft's objects are blocks")
        text = to_object_file(exported)
    else:
        text = (to_mjcf if kind == "mjcf" else to_urdf)(exported, inertial=inertial)
    path = out or folder / "exports" / f"{exported.name}_{row['key'][:8]}.{_ENDING[kind]}"
    for file, content in ((path, text), (path.with_suffix(".json"), to_sidecar(exported))):
        write_whole(file, lambda part, content=content: part.write_text(content, encoding="utf-8"))
    return [path, path.with_suffix(".json")]


def exported_of(folder: Path, row: Row) -> Exported:
    """The answer of a row of the results.

    Raises:
        InvalidValueError: there is none.
    """
    shown = estimate_shown(folder, row)
    if shown.answer is None:
        why = f"{row['status']}: {row['message']}"
        raise InvalidValueError("ESTIMATE", row["key"], f"one with masses; this one has none, {why}")
    why = f": {row['message']}" if row.get("message") else ""
    notes = (
        f"estimated by heft: {shown.title}, draw {row['seed']}",
        f"status {row['status']}{why}",
        f"estimate {row['key']}",
    )
    return Exported(str(row["object"]), shown.shape, shown.answer, shown.covariance, notes)


def _row_of(folder: Path, beginning: str) -> Row:
    found = [row for row in rows_in(folder) if str(row.get("key") or "").startswith(beginning)]
    if len(found) != 1:
        allowed = f"the beginning of one estimate's key in {folder}/estimates; {len(found)} begin so"
        raise InvalidValueError("ESTIMATE", beginning, allowed)
    return found[0]
