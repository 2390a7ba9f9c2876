"""heft export: an estimate as a model for another simulator, with its errors beside it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from testbed.errors import InvalidValueError

if TYPE_CHECKING:
    from estimators.evaluation.statistics import Row
    from testbed.objects.export import Exported

_ENDING = {"mjcf": "xml", "urdf": "urdf", "toml": "toml"}


def export(
    folder: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="DIR")],
    what: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="ESTIMATE")],
    *,
    format_: Annotated[Literal["mjcf", "urdf", "toml"], tyro.conf.arg(name="format")] = "mjcf",
    inertial: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False,
    out: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None,
) -> None:
    """Write an estimate for another simulator: a box a block. A JSON beside it says how sure every mass is.

    Examples: heft export results/blocks 3f9a
              heft export results/blocks 3f9a --format urdf --inertial --out my_robot/hammer.urdf

    Args:
        folder: of a run.
        what: beginning of an estimate's key (see its report).
        format_: mjcf, urdf, or toml: an object file that heft itself can run.
        inertial: one mass, centre and inertia for the whole object instead.
        out: DIR/exports/OBJECT_KEY if left out, with the format's ending.
    """
    from scenarios.results.estimates import row_of
    from testbed.objects.export import to_mjcf, to_object_file, to_sidecar, to_urdf
    from testbed.trajectory import write_whole

    row = row_of(folder, what)
    exported = exported_of(folder, row)
    if format_ == "toml":
        if inertial:
            raise InvalidValueError("--inertial", "--format toml", "mjcf or urdf: heft's objects are blocks")
        text = to_object_file(exported)
    else:
        text = (to_mjcf if format_ == "mjcf" else to_urdf)(exported, inertial=inertial)
    path = out or folder / "exports" / f"{exported.name}_{row['key'][:8]}.{_ENDING[format_]}"
    for file, content in ((path, text), (path.with_suffix(".json"), to_sidecar(exported))):
        write_whole(file, lambda part, content=content: part.write_text(content, encoding="utf-8"))
        print(file)


def exported_of(folder: Path, row: Row) -> Exported:
    """The masses of a row of the results, as they are exported.

    Raises:
        InvalidValueError: it has none.
    """
    from scenarios.views.estimate import estimate_view
    from testbed.objects.export import Exported

    view = estimate_view(folder, row)
    if view.answer is None:
        why = f"{row['status']}: {row['message']}"
        raise InvalidValueError("ESTIMATE", row["key"], f"one with masses; this one has none, {why}")
    why = f": {row['message']}" if row.get("message") else ""
    notes = (
        f"estimated by heft: {view.title}, draw {row['seed']}",
        f"status {row['status']}{why}",
        f"estimate {row['key']}",
    )
    return Exported(str(row["object"]), view.shape, view.answer, view.covariance, notes)
