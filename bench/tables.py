"""Tables of the README and the documentation from results folders: python bench/tables.py [RESULTS].

Writes every table whose run is in RESULTS (results/ if left out) between its marks in the page. By these secrets the
runs come again:
    heft run blocks --secret readme            README.md, docs/baselines.md
    heft run lab --secret readme               README.md, docs/planning.md
    heft run lab_fixed --secret readme         docs/planning.md
    heft run lab_pads --secret readme          docs/planning.md
    heft run budget|trust|support|push|articulated --secret docs                              docs/measurements.md
    heft run articulated --world lab --seeds 4 --out results/articulated_lab --secret docs    docs/measurements.md
Figures of the README's are kept in docs/tables/*.csv too; tests/scenarios/cli/test_shown_outputs.py holds the pages
against them, and a part of them against a run.
"""

from __future__ import annotations

import csv
import math
import shlex
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from io import StringIO
from pathlib import Path
from statistics import fmean, median, stdev
from typing import Any

from rich.console import Console

from estimators.evaluation.statistics import Claims, draws_of, methods_of, select
from scenarios.results.estimates import load_results
from scenarios.results.files import read_manifest
from scenarios.results.table import rows_of
from viz.report.tables import NAD, metric_table
from viz.report.terminal import rich_table

ROOT = Path(__file__).parents[1]
TABLES = ROOT / "docs" / "tables"
FIELDS: Sequence[str] = ("support", "method", "object", "draws", "ok", "nad_mean", "nad_std", "hold")
"""Columns of a file of figures: NAD in percent, and of all objects the percentage of 90 % intervals that hold."""
METHODS = {
    "blocks": {
        "hidden_states": " (Algorithm 1)",
        "bayes": " (every error of the setup as an unknown)",
        "hidden_states_published": " (as printed, on our trials)",
        "random_search": "",
        "weighted_sampling": "",
        "explicit_state": "",
        "diff_lcp": "",
        "explicit_state_M_cov": " (given M and covariance)",
    },
    "lab": {
        "hidden_states": "",
        "bayes": " (every error of the setup as an unknown)",
        "least_squares": " (all wrenches at once, given M)",
        "explicit_state_M_cov": "",
        "hidden_states_published": "",
    },
}
"""Rows of the README's table of each run, and what stands behind their names."""
LABS = {"lab_fixed": "turns about the grasps", "lab": "planned", "lab_pads": "planned, on pads"}
"""Runs in a lab, and what stands for them in a table."""
PADS = "_on_pads"
"""Ending of the name of an object on printed pads."""
SEARCHES = "weighted_sampling_M", "random_search_M"
SHOWN_SUPPORT = "own_weight"


@dataclass(frozen=True)
class Figures:
    """Figures of one run."""

    command: str
    """Command that made them, with its secret."""
    rows: tuple[dict[str, str], ...]
    """A row per support, method and object, and one of all objects."""

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
        words = shlex.split(str(manifest.get("command")))
        if "--out" in words:  # a folder of its own
            del words[(at := words.index("--out")) : at + 2]
        return Figures(shlex.join(words), tuple(rows))

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
    mean = f"{fmean(nad):.4f}" if nad else ""
    spread = f"{stdev(nad):.4f}" if len(nad) > 1 else ""
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
    lines = [head]
    for method, values in columns.items():
        cells = [
            f"**{shown(v)}**" if shown(v) == shown(best) else shown(v) for v, best in zip(values, least, strict=True)
        ]
        claims = [f"{held[method]} %" if held[method] else "claims none"] if held else []
        lines.append([f"`{method}`{METHODS[name][method]}", *cells, *claims])
    return markdown(lines)


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


def markdown(lines: Sequence[Sequence[str]]) -> str:
    """A table of which the first line is the head."""
    head, *rest = lines
    return "\n".join("| " + " | ".join(line) + " |" for line in (head, ["---"] * len(head), *rest)).replace(
        "|  |", "| |"
    )


def nad_of(rows: Sequence[Any], by: Callable[[list[float]], float] = fmean) -> str:
    """NAD of some answers in percent, their mean or what `by` says; "-" without any."""
    nad = [NAD.scale * row["nad"] for row in rows if row.get("nad") is not None and not math.isnan(row["nad"])]
    return shown(by(nad)) if nad else "-"


def held(rows: Sequence[Any]) -> str:
    """Percentage of 90 % intervals that hold; empty of methods that claim none."""
    claims = Claims.of(rows)
    return "" if claims is None else f"{100 * claims.held:.0f}"


def claimed(rows: Sequence[Any]) -> list[str]:
    """Error over claimed error, 90 % intervals that hold, and silent answers; empty of methods that claim no errors."""
    claims = Claims.of(rows)
    if claims is None:
        return ["", "", ""]
    return [f"{claims.ratio:.2f}", f"{100 * claims.held:.0f} %", f"{claims.silent * claims.count:.0f} of {len(rows)}"]


def seconds_of(rows: Sequence[Any]) -> str:
    """Mean robot time of some answers, s."""
    return f"{fmean(row['robot_s'] for row in rows):.0f}"


def budget_table(results: Sequence[Any]) -> str:
    """Sources of a lab's errors, each alone: median NAD, and error over claimed error."""
    methods = ("hidden_states", "bayes", "least_squares", "hidden_states_published", "explicit_state_M")
    lines = [["source", *(f"`{method}`" for method in methods)]]
    for source in dict.fromkeys(row["axis.world.only"] for row in results):
        cells = []
        for method in methods:
            rows = select([row for row in results if row["axis.world.only"] == source], method=method)
            claims = Claims.of(rows)
            cells.append(nad_of(rows, median) + ("" if claims is None else f" ({claims.ratio:.1f})"))
        lines.append([source, *cells])
    return markdown(lines)


def labs_table(runs: Mapping[str, Sequence[Any]]) -> str:
    """Trials of the objects of blocks in a lab, by run: mean NAD, claims and the robot's time."""
    methods = ("bayes", "hidden_states", "least_squares", "hidden_states_published")
    lines = [["trials", "method", "NAD, mean", "error / claimed", "90 % hold", "silent", "robot, s"]]
    blocks = [name.removesuffix(PADS) for name in objects_of(runs["lab_pads"])]
    for run, title in LABS.items():
        for method in methods:
            rows = [row for row in select(runs[run], method=method) if row["object"].removesuffix(PADS) in blocks]
            first = title if method == methods[0] else ""
            lines.append([first, f"`{method}`", nad_of(rows), *claimed(rows), seconds_of(rows)])
    return markdown(lines)


def trust_table(results: Sequence[Any]) -> str:
    """Methods that test the support, under both: mean NAD, FT-300S and perfect sensor."""
    names, labels = objects_of(results), {"own_weight": "own weight", "rigid": "rigid"}
    lines = [["", *names]]
    for support, label in labels.items():
        for method in methods_of(results):
            rows = select(results, support=support, method=method)
            cells = [", ".join(nad_of(select(rows, object=n, sensing=s)) for s in ("ft300s", "ideal")) for n in names]
            lines.append([f"{label}, {method}", *cells])
    return markdown(lines)


def springs_table(results: Sequence[Any]) -> str:
    """NAD by the support, from own weight over springs between the blocks to one rigid body."""
    supports = list(dict.fromkeys(row["support"] for row in results))
    lines = [["", *(support.replace("_", " ").removesuffix(" N/m") for support in supports)]]
    for name in objects_of(results):
        for method in methods_of(results):
            rows = select(results, object=name, method=method)
            lines.append([f"{name}, `{method}`", *(nad_of(select(rows, support=support)) for support in supports)])
    return markdown(lines)


def articulated_table(results: Sequence[Any]) -> str:
    """Objects in links, by camera: mean NAD, and the error of the hinges' friction of methods that estimate it."""
    names = objects_of(results)
    lines = [["", *names, "90 % hold"]]
    for sensing in dict.fromkeys(row["sensing"] for row in results):
        for method in ("hidden_states", "bayes", "least_squares", *([] if _in_lab(results) else SEARCHES)):
            rows = select(results, sensing=sensing, method=method)
            cells = [nad_of(each := select(rows, object=name)) + hinges_of(each) for name in names]
            lines.append([f"{sensing}, `{method}`", *cells, held(rows)])
    return markdown(lines)


def _in_lab(results: Sequence[Any]) -> bool:
    """True if each draw has trials of its own, as those of a world have."""
    return len({tuple(row["trial_keys"]) for row in results}) > 2 * len(objects_of(results))


def hinges_of(rows: Sequence[Any]) -> str:
    """Mean error of the hinges' friction in percent, after a comma; empty of methods without."""
    found = [100 * row["hinge_error"] for row in rows if row.get("hinge_error") is not None]
    found = [value for value in found if not math.isnan(value)]
    return f", {shown(fmean(found))}" if found else ""


def push_table(results: Sequence[Any]) -> str:
    """Pushes by camera and world: mean NAD of both rectangles, median of all objects, and how often intervals hold."""
    sensors = list(dict.fromkeys(row["sensing"] for row in results))
    named = [name for name in objects_of(results) if name.startswith("rectangle")]
    cameras = ["exact" if "exact" in sensor else "30 Hz" for sensor in sensors]
    columns = [*(name.removeprefix("rectangle_") for name in named), "all", "90 % hold"]
    lines = [["", *(f"{column}, {camera}" for camera in cameras for column in columns)]]
    for world in dict.fromkeys(row["axis.world.preset"] for row in results):
        for method in methods_of(results):
            cells = []
            for sensor in sensors:
                rows = select([r for r in results if r["axis.world.preset"] == world], method=method, sensing=sensor)
                cells += [*(nad_of(select(rows, object=name)) for name in named), nad_of(rows, median), held(rows)]
            lines.append([f"{world}, `{method}`", *cells])
    return markdown(lines)


def objects_of(results: Sequence[Any]) -> list[str]:
    """Names of the objects in order."""
    return list(dict.fromkeys(row["object"] for row in results))


APPENDIX: dict[str, Callable[[Sequence[Any]], str]] = {
    "budget": budget_table,
    "trust": trust_table,
    "support": springs_table,
    "push": push_table,
    "articulated": articulated_table,
    "articulated_lab": articulated_table,
}
"""Table of each run in docs/measurements.md."""


def main(results: Path) -> None:
    """Write figures and tables."""
    if all((results / name).is_dir() for name in METHODS):
        readme = (ROOT / "README.md").read_text(encoding="utf-8")
        for name in METHODS:
            figures = Figures.of(results / name)
            figures.write(name)
            readme = replaced(readme, name, readme_table(name, figures))
        (ROOT / "README.md").write_text(readme, encoding="utf-8")
        put("baselines", "blocks", printed_table(results / "blocks"))
    if all((results / name).is_dir() for name in LABS):
        put("planning", "labs", labs_table({name: rows_of(load_results(results / name)) for name in LABS}))
    for name, table in APPENDIX.items():
        if (results / name / "results.parquet").is_file():
            put("measurements", name, table(rows_of(load_results(results / name))))


def put(page: str, mark: str, table: str) -> None:
    """Write a table into a page of the documentation."""
    path = ROOT / "docs" / f"{page}.md"
    path.write_text(replaced(path.read_text(encoding="utf-8"), mark, table), encoding="utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else ROOT / "results")
