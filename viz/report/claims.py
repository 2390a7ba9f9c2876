"""Table of claimed errors: do the error bars of each method hold?"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from estimators.evaluation.statistics import SILENT, Claims, Row, methods_of, select
from viz.report.tables import Entry, Table, percent

CLAIMS = "Errors of the masses over those claimed"


def claims_table(rows: Sequence[Row], title: str = CLAIMS) -> Table | None:
    """Errors against those claimed: a row a method; None where no method claims any."""
    lines = []
    for method in methods_of(rows):
        of = select(rows, method=method)
        if (found := Claims.of(of)) is not None:
            good = sum(row["status"] == "ok" for row in of)
            misfit = [row["misfit"] for row in of if row.get("misfit") is not None]
            counts = (f"{found.ratio:.2f}", percent(found.held), percent(good / len(of)), percent(found.silent))
            cells = (*counts, f"{np.median(misfit):.2g}" if misfit else "-")
            lines.append(((method,), tuple(map(Entry, cells))))
    note = f"silent: status ok, and a group off by over {SILENT:g} claimed errors" if lines else ""
    columns = ("error / claimed", "90 % intervals hold", "status ok", "silent", "misfit")
    return Table(title, columns, tuple(lines), note=note) if lines else None
