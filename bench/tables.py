"""Tables of the README and of docs/baselines.md from the results of `make run`: python bench/tables.py [RESULTS].

Run first, in RESULTS (results/ if left out), by the secret that makes them again:
    heft run blocks --secret readme
    heft run lab --secret readme
Writes the figures into docs/tables/*.csv, and the tables between their marks in README.md and docs/baselines.md;
tests/scenarios/cli/test_shown_outputs.py holds the pages against the figures, and a part of the figures against a run.
"""

from __future__ import annotations

import csv
import math
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from io import StringIO
from pathlib import Path
from statistics import fmean, median, stdev
from typing import Any

from rich.console import Console

from estimators.evaluation.statistics import Claims, draws_of, methods_of, select
from scenarios.results.estimates import load_results
from scenarios.results.files import read_manifest
from scenarios.results.store import rows_of
from viz.report.tables import NAD, metric_table
from viz.report.terminal import rich_table

ROOT = Path(__file__).parents[1]
TABLES = ROOT / "docs" / "tables"
FIELDS: Sequence[str] = ("support", "method", "object", "draws", "ok", "nad_mean", "nad_std", "hold")
"""Columns of a file of figures: NAD in percent, and of all objects the percentage of 90 % intervals that hold."""
METHODS = {
    "blocks": {
        "hidden_states": " (Algorithm 1)",
        "hidden_states_published": " (as printed, on our trials)",
        "random_search": "",
        "weighted_sampling": "",
        "explicit_state": "",
        "diff_lcp": "",
        "explicit_state_M_cov": " (given M and covariance)",
    },
    "lab": {
        "hidden_states": "",
        "least_squares": " (all wrenches at once, given M)",
        "explicit_state_M_cov": "",
        "hidden_states_published": "",
    },
}
"""Rows of the README's table of each run, and what stands behind their names."""
SHOWN_SUPPORT = "own_weight"


@dataclass(frozen=True)
class Figures:
    """Figures of one run."""

    command: str
    """Command that made them, with its secret."""
    rows: tuple[dict[str, str], ...]
    """A row a support, method and object, and one of all objects."""

    @staticmethod
    def of(folder: Path) -> Figures:
        """Figures of a results folder."""
        manifest, results = read_manifest(folder) or {}, rows_of(load_results(folder))
        rows = []
        for support in dict.fromkeys(row["support"] for row in results):
            for method in methods_of(results):
                of_method = select(results, support=support, method=method)
                claims = Claims.of(of_method)
                for name in dict.fromkeys(row["object"] for row in of_method):
                    found = select(of_method, object=name)
                    nad = [v for v in draws_of(found, NAD.column, NAD.scale).values() if not math.isnan(v)]
                    rows.append(_row(support, method, name, found, nad))
                held = "" if claims is None else f"{100 * claims.held:.0f}"
                rows.append(_row(support, method, "all", of_method, []) | {"hold": held})
        return Figures(str(manifest.get("command")), tuple(rows))

    @staticmethod
    def read(name: str) -> Figures:
        """Figures as they are kept."""
        first, *rest = (TABLES / f"{name}.csv").read_text(encoding="utf-8").splitlines()
        return Figures(first.removeprefix("# "), tuple(csv.DictReader(rest)))

    def write(self, name: str) -> None:
        """Keep them."""
        text = StringIO()
        writer = csv.DictWriter(text, FIELDS, lineterminator="\n")
        writer.writeheader()
        writer.writerows(self.rows)
        TABLES.mkdir(exist_ok=True)
        (TABLES / f"{name}.csv").write_text(f"# {self.command}\n{text.getvalue()}", encoding="utf-8")

    def cell(self, method: str, name: str, field: str) -> str:
        """One figure on the support that is shown."""
        wanted = {"support": SHOWN_SUPPORT, "method": method, "object": name}
        return next(row[field] for row in self.rows if wanted.items() <= row.items())


def _row(support: str, method: str, name: str, found: Sequence[Any], nad: list[float]) -> dict[str, str]:
    ok = sum(row["status"] == "ok" for row in found)
    mean = f"{fmean(nad):.3f}" if nad else ""
    spread = f"{stdev(nad):.3f}" if len(nad) > 1 else ""
    return dict(zip(FIELDS, (support, method, name, str(len(found)), str(ok), mean, spread, ""), strict=True))


def shown(percent: float) -> str:
    """A percentage, two digits of it."""
    return f"{percent:.1f}" if percent < 9.95 else f"{percent:.0f}"


def readme_table(name: str, figures: Figures) -> str:
    """The README's table of a run, the least NAD of each column in bold."""
    objects = list(dict.fromkeys(row["object"] for row in figures.rows if row["object"] != "all"))
    means = {m: [float(figures.cell(m, each, "nad_mean")) for each in objects] for m in METHODS[name]}
    columns = {m: [*values, median(values)] for m, values in means.items()}
    least = [min(values) for values in zip(*columns.values(), strict=True)]
    held = {m: figures.cell(m, "all", "hold") for m in METHODS[name]} if name == "lab" else {}
    head = ["in a lab" if name == "lab" else "", *objects, "median", *(["90 % intervals hold"] if held else [])]
    lines = [head, ["---"] * len(head)]
    for method, values in columns.items():
        cells = [
            f"**{shown(v)}**" if shown(v) == shown(best) else shown(v) for v, best in zip(values, least, strict=True)
        ]
        claims = [f"{held[method]} %" if held[method] else "claims none"] if held else []
        lines.append([f"`{method}`{METHODS[name][method]}", *cells, *claims])
    return "\n".join("| " + " | ".join(line) + " |" for line in lines).replace("|  |", "| |")


def replaced(page: str, mark: str, text: str) -> str:
    """The page with what stands between a mark and its end replaced."""
    begin, end = f"<!-- table: {mark} -->\n", f"\n<!-- end: {mark} -->"
    before, _, rest = page.partition(begin)
    assert rest and end in rest, f"no marks of {mark}"
    return before + begin + text + end + rest.partition(end)[2]


def printed_table(folder: Path) -> str:
    """The table of NAD that `heft run` prints, on the support that is shown."""
    rows = select(rows_of(load_results(folder)), support=SHOWN_SUPPORT)
    console = Console(width=130, file=StringIO(), record=True)
    title = f"{NAD.title}: own weight, ft300s"
    console.print(rich_table(metric_table(rows, NAD, title)))
    return "```\n" + "\n".join(line.rstrip() for line in console.export_text().splitlines()).strip("\n") + "\n```"


def main(results: Path) -> None:
    """Write figures and tables."""
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    for name in METHODS:
        figures = Figures.of(results / name)
        figures.write(name)
        readme = replaced(readme, name, readme_table(name, figures))
    (ROOT / "README.md").write_text(readme, encoding="utf-8")
    page = ROOT / "docs" / "baselines.md"
    page.write_text(replaced(page.read_text(encoding="utf-8"), "blocks", printed_table(results / "blocks")), "utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else ROOT / "results")
