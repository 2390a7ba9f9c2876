"""Views of a finished run: figures, recording and report, in parallel on its workers."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from estimators.evaluation.statistics import Row
from scenarios.execution.executor import Executor, Failure
from scenarios.views.figures import figures
from scenarios.views.pages import record_results, record_worst
from scenarios.views.report import report
from testbed.errors import HeftError


def write_views(folder: Path, rows: Sequence[Row], executor: Executor, *, recording: bool) -> Iterator[str]:
    """Write figures, report and recording of a finished run.

    Args:
        folder: results folder.
        rows: its rows.
        executor: idle executor, whose workers write.
        recording: True to write a recording of the whole run too.

    Yields:
        A line for each file, or for the reason why a view is missing.

    Raises:
        HeftError: figures or report could not be written; the other views are there.
    """
    root = folder.absolute()
    executor.start("worst", record_worst, root, rows)
    executor.start("figures", figures, root)
    written: dict[str, Any] = {}
    while executor.running:
        name, value = executor.wait()
        written[name] = value
        if name == "worst":
            executor.start("report", report, root)  # it links to the recordings of the worst
            if recording:
                executor.start("recording", record_results, root)
    for name, value in sorted(written.items()):
        if isinstance(value, Failure):
            yield f"no {'recording' if name == 'worst' else name}: {value.reason}"
        elif name != "worst":
            paths = value if isinstance(value, list) else [value]
            yield from (
                f"{name.removesuffix('s')}: {folder / p.relative_to(root)}" for p in paths if p.suffix != ".png"
            )
    for name in ("figures", "report"):
        if isinstance(written[name], Failure):
            raise HeftError(f"no {name}: {written[name].reason}")
