"""heft report, heft figures: a finished run on paper."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import tyro
from rich.console import Console


def report(folder: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="DIR")]) -> None:
    """Write DIR/report.html: one file with tables, figures, failures and what is needed to run it again.

    Args:
        folder: of a finished run.
    """
    from scenarios.views.report import report as write

    print(write(folder))


def figures(
    folder: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="DIR")],
    what: Annotated[str | None, tyro.conf.Positional, tyro.conf.arg(metavar="ESTIMATE")] = None,
) -> None:
    """Draw figures for a paper, as PDF and PNG, into DIR/figures.

    Args:
        folder: of a finished run.
        what: beginning of an estimate's key: its maps, bars, losses and wrench fits; of the whole run if left out.
    """
    from scenarios.results.estimates import row_of
    from scenarios.views.figures import figures as draw

    for path in draw(folder, None if what is None else row_of(folder, what)):
        Console().print(f"figure: {path}", highlight=False, soft_wrap=True)
