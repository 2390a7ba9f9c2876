"""Report of a run: right numbers, harmless text, whole files."""

import json
import re
import tomllib
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

from estimators.evaluation import paper
from estimators.evaluation.statistics import object_means
from scenarios.results.files import write_json
from scenarios.results.store import write_arrays
from scenarios.results.table import write_rows
from scenarios.views.report import report
from testbed.errors import InvalidValueError
from testbed.toml import toml_text
from tests.helpers.rows import row
from viz.figures.loss import normalised
from viz.report.report import inline_svg, mapped_objects, middle_object
from viz.report.tables import (
    HINGES,
    SHORTER_MPDS,
    hidden_table,
    metric_table,
    metrics_of,
    over_objects,
    overview,
    points_of,
    sweep_table,
)
from viz.report.tables import NAD as NAD_METRIC

EVIL = "<script>alert('x')</script>"
REASON = '"><img src=x onerror=alert(1)> & more'
SECTIONS = ("result", "run", "tables", "distributions", "losses", "maps", "worst", "failures")
VOID = {"meta", "br", "wbr", "img", "hr", "link", "input"}
NAD = {"hidden_states": (0.0123, 0.0151), "random_search": (0.411, 0.473), "diff_lcp": (0.2, 0.3)}


def write(folder: Path, rows: list[dict]) -> Path:
    """A results folder."""
    folder.mkdir(parents=True, exist_ok=True)
    write_rows(folder, rows)
    scenario = {"objects": ["L2"], "seeds": 2, "methods": {"random_search": {"iterations": 7}}, "grid": {"feet": 3}}
    manifest = {"scenario": scenario, "python": "3.11.0", "packages": {"heft": "9.8.7"}}
    write_json(folder / "manifest.json", manifest)
    return folder


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two objects, one without geometry and with a bad name; a failed method; traces; a traceback; no trials."""
    rows = [row(m, s, v) for m, values in NAD.items() for s, v in enumerate(values)]
    names = [f"$\\x{i}\x01<" for i in range(6)]
    rows += [row("hidden_states", s, v, EVIL, group_names=names) for s, v in enumerate((0.02, 0.03))]
    rows += [row("random_search", 0, None, EVIL, status="underdetermined", message="too few turns")]
    for seed in (0, 1):  # most columns of a failed estimate are missing
        head = {key: row("diff_lcp", seed, None)[key] for key in ("sensing", "seed", "method", "kind")}
        failed = {"object": EVIL, "support": "rigid", "status": "failed", "message": f"ValueError: {REASON}"}
        rows += [head | failed | {"nad": np.nan}]
    rows[3]["key"] = "0123abcd"
    rows[0]["assumes"] = "the blocks are apart"
    rows = [each | {"robot_s": (10.0, 100.0)[each["seed"]]} for each in rows]
    folder = write(tmp_path_factory.mktemp("results") / "made up", rows)
    for key, name, text in (
        ("0123abcd", "result.json", json.dumps(rows[3])),
        ("ffff", "error.txt", f"Traceback: </pre>{EVIL}\nValueError: {REASON}\n"),
    ):
        (folder / "estimates" / key).mkdir(parents=True)
        (folder / "estimates" / key / name).write_text(text, encoding="utf-8")
    traces = {"random.loss": np.geomspace(8, 0.1, 50), "random.seconds": np.linspace(0, 1, 50)}
    write_arrays(folder / "estimates" / "0123abcd" / "estimate.npz", traces)
    return folder


@pytest.fixture(scope="module")
def page(folder: Path) -> str:
    """Its report."""
    path = report(folder)
    assert path == folder / "report.html"
    return path.read_text(encoding="utf-8")


class Reader(HTMLParser):
    """Text, identifiers and addresses; fails on tags that do not balance."""

    def __init__(self, page: str):
        super().__init__()
        self.open, self.ids, self.links, self.tags, self.rows = [], [], [], set(), []
        self.feed(page)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.add(tag)
        self.ids += [value for name, value in attrs if name == "id"]
        self.links += [value for name, value in attrs if name in ("src", "href", "xlink:href", "action") and value]
        assert not any(name.startswith("on") for name, _ in attrs)
        if tag not in VOID:
            self.open.append(tag)
        if tag == "tr":
            self.rows.append("")

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.handle_starttag(tag, attrs)
        if tag not in VOID:
            self.open.pop()

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if "tr" in self.open:
            self.rows[-1] += data + "|" if data.strip() else ""


@pytest.fixture(scope="module")
def read(page: str) -> Reader:
    return Reader(page)


def test_every_section_is_there_and_reachable(page: str, read: Reader):
    assert set(SECTIONS) <= set(read.ids)
    assert len(set(read.ids)) == len(read.ids)
    assert {f"#{name}" for name in SECTIONS} <= set(read.links)
    assert '<meta name="viewport"' in page and "@media print" in page
    assert page.count("<figure") == page.count("<figcaption>") == page.count('role="img"') > 4


def test_the_result_comes_before_the_facts_of_the_run(page: str, read: Reader):
    first, rest = page.split('<section class="first" id="result">')[1].split("</section>", 1)
    assert first.count("<tr") == 1 + len(NAD) and first.count("<svg") == 1
    assert "L2: true mass, estimated mass" in first
    assert "heft 9.8.7" not in page.split('id="tables"', maxsplit=1)[0] and "heft 9.8.7" in rest
    assert "55.0 s of moving" in rest, "the mean over draws, whose trials all methods share"
    sections = [link for link in read.links if link[1:] in SECTIONS and link.startswith("#")]
    assert [link for link in dict.fromkeys(sections) if link != "#failures"][:2] == ["#result", "#tables"]


def test_methods_are_ordered_by_the_first_group_and_lost_answers_come_last():
    nads = {"a": (0.4, 0.1), "b": (0.2, 0.2), "c": (0.01, None), "d": (0.9, 0.9), "e": (0.3, 0.3)}
    groups = {str(g): [row(m, 0, pair[g]) for m, pair in nads.items()] for g in (0, 1)}
    table = overview(groups)
    assert [(labels[0], *(cell.text for cell in cells)) for labels, cells in table.rows] == [
        ("b", "20.0", "20.0"), ("e", "30.0", "30.0"), ("a", "40.0", "10.0"), ("d", "90.0", "90.0"), ("c", "1.00", "-"),
    ]  # fmt: skip
    assert overview({}).rows == ()


def test_the_overview_counts_answers_that_are_ok_and_has_the_papers_figures():
    rows = [row("explicit_state", 0, nad, name) for name, nad in (("I1", 0.1), ("L2", 0.2), ("x", 0.6))]
    rows[1] |= {"status": "unexplained"}
    rows[2] |= {"nad": None, "status": "failed"}
    table = overview(points_of(rows))
    assert table.columns == ("own weight, ft300s", "paper, real robot")
    ((_, (ours, theirs)),) = table.rows
    assert (ours.text, ours.missing) == ("15.0", "1 of 3 ok")
    assert theirs.text == f"{(paper.NAD['explicit_state']['I1'] + paper.NAD['explicit_state']['L2']) / 2:.1f}"


def test_points_are_named_by_what_differs_among_them():
    rows = [row("a", 0, 0.1) | {"axis.k": k, "sensing": sensing} for k in (1, 2.5) for sensing in ("low", "high")]
    assert list(points_of(rows)) == ["low, k 1", "high, k 1", "low, k 2.5", "high, k 2.5"]


def test_points_that_differ_in_the_seventh_digit_are_not_one():
    rows = [
        row("a", 0, 0.1) | {"axis.seed": seed, "axis.k": k} for seed in (1234567, 1234568) for k in (1e6, 1e6 + 1.5)
    ]
    assert list(points_of(rows)) == [
        f"seed {seed}, k {k}" for seed in (1234567, 1234568) for k in ("1000000", "1000001.5")
    ]


def test_the_middle_object_is_chosen_among_those_with_a_map_and_an_answer():
    rows = [row("a", 0, nad, name) for name, nad in (("x", 0.1), ("y", 0.9), ("z", 0.5), ("w", None), ("v", 0.3))]
    assert middle_object(rows, "a", ["x", "y", "z", "w"]) == "z"
    assert middle_object(rows, "a", ["w"]) is None
    assert middle_object(rows, "b", ["x"]) is None


VALUES = 100 * np.array(NAD["hidden_states"])


@pytest.mark.parametrize(
    ("start", "parts"),
    [
        ("hidden_|states|", (f"{VALUES.mean():.2f} ± {VALUES.std(ddof=1):.2f}",)),
        ("  paper, real robot|", ("46.4",)),
        ("the true masses|", ("0.33 ± 0.00",)),
        ("the true masses|", ("0.44 ± 0.00",)),
        ("L2|47.3|random_|search", ("estimates/0123abcd/",)),
        ("L2|41.1|", ("folder not known", "2 trials", "trials/turn/trajectory.parquet")),
        ("diff_|lcp|failed|2|", (f"ValueError: {REASON}", "estimates/ffff/error.txt", "rigid body, ft300s")),
        ("random_|search|underdetermined|1|", ("too few turns",)),
    ],
)
def test_a_row_has_its_numbers_files_and_reasons(read: Reader, start: str, parts: tuple[str, ...]):
    assert any(line.startswith(start) and all(part in line for part in parts) for line in read.rows)


def test_an_interval_of_two_draws_is_no_interval(page: str, read: Reader):
    assert "(NAD), %; 1 to 2 draws" in page and "take 5 draws or objects, or more" in " ".join(page.split())
    assert not any(re.search(r"\[\d", line) for line in read.rows)
    assert "Assumed, not tested: the blocks are apart (hidden_states)." in page


def test_names_and_messages_do_no_harm(page: str, read: Reader):
    assert not read.tags & {"script", "img", "iframe", "object", "embed", "link", "base"}
    assert EVIL not in page
    assert any(EVIL in line for line in read.rows)
    assert "estimates/0123abcd/result.json" in read.links
    assert all(re.match(r"#|estimates/|trials/|data:image/png;base64,", link) for link in read.links)
    assert not re.search(r"https?://", page)
    for part in ("default-src 'none'", "iterations = 7", "heft 9.8.7"):
        assert part in page


@pytest.mark.slow
def test_many_objects_swept_are_aggregated(tmp_path: Path):
    """Only the columns that every row has; some rows are of objects without any estimate."""
    rows = [
        {"object": f"o{i:02d}", "support": "rigid", "sensing": "low", "seed": s, "method": m, "kind": m, "status": "ok",
         "nad": 0.01 * (1 + i) * (1 + s) * (1 + (m == "b")), "axis.grid.feet": feet, "axis.truth.who": who,
         "mass_kg": None, "trial_keys": None}
        for i in range(20) for s in (0, 1) for m in ("a", "b") for feet, who in ((2, "x"), (4, "y"))
    ]  # fmt: skip
    rows += [rows[0] | {"object": "odd", "method": "", "kind": "", "sensing": "", "status": "infeasible", "nad": np.nan,
                        "message": "too wide"}]  # fmt: skip
    page = report(write(tmp_path / "many", rows)).read_text(encoding="utf-8")
    read = Reader(page)
    nads = np.array([1.5 * (1 + i) for i in range(20)])
    (line,) = [line for line in read.rows if line.startswith("a|") and "±" in line]
    assert line.startswith(f"a|{nads.mean():.1f} ± ")
    for part in (f"{np.median(nads):.1f}", f"{nads.max():.1f}", "★"):  # a beats b on every object
        assert part in line
    for part in ("NAD against grid.feet", "NAD against truth.who", "5 objects are left out"):
        assert part in page
    assert any(line.startswith("every method|infeasible|1|too wide") for line in read.rows)


def test_maps_are_of_the_worst_objects_and_a_few_others():
    rows = [{"object": f"o{i}", "kind": "hidden_states", "nad": 0.01 * i} for i in range(40)]
    chosen = mapped_objects(rows, [r["object"] for r in rows])
    assert chosen[:10] == [f"o{i}" for i in range(39, 29, -1)]
    assert len(set(chosen)) == 15
    assert {"o29", "o0"} <= set(chosen)
    assert mapped_objects(rows[:12], ["o1"]) == ["o1"]


def test_a_folder_without_results_is_refused(tmp_path: Path):
    with pytest.raises(InvalidValueError, match=r"^DIR.*heft run"):
        report(tmp_path)
    assert not (tmp_path / "report.html").exists()


def test_points_of_a_sweep_are_one_sample_of_an_object():
    rows = [row("a", s, 0.1 * k) | {"axis.k": k} for k in (1, 3) for s in (0, 1)]
    assert object_means(rows, "a", "nad", 100) == {0: pytest.approx(20)}
    table = sweep_table(rows, "axis.k", "t")
    assert table.columns == ("1", "3")
    assert [cell.words for cell in table.rows[0][1]] == ["10.0", "30.0"]
    rows = [each | {"axis.k": f"word {each['axis.k']}", "mass_error_kg": None} for each in rows]
    table = sweep_table(rows, "axis.k", "t")
    assert table.columns == ("a",) and [labels for labels, _ in table.rows] == [("word 1",), ("word 3",)]
    assert [cells[0].words for _, cells in table.rows] == ["10.0", "30.0"]


def test_a_sweep_counts_each_object_once_and_answers_that_are_missing():
    nads = {"o": (0.01, 0.09), "p": (0.02, 0.02), "q": (0.03, 0.032)}
    rows = [row("a", s, nad, name) | {"axis.k": 1} for name, pair in nads.items() for s, nad in enumerate(pair)]
    rows += [row("b", 0, 0.01, "o") | {"axis.k": 1}]
    rows += [row("b", 0, None, name) | {"axis.k": 1, "status": "failed"} for name in "pq"]
    (_, (a,)), (_, (b,)) = sweep_table(rows, "axis.k", "t").rows
    assert a.text == "3.10"
    assert b.missing == "1 of 3 ok"


def test_identifiers_of_two_figures_do_not_clash():
    figure = Figure()
    figure.subplots().plot([1, 2], [1, 2], marker="o")
    first, second = inline_svg(figure, 'a "title" <b>', "f1"), inline_svg(figure, "b", "f2")
    ids = [set(re.findall(r' id="([^"]+)"', svg)) for svg in (first, second)]
    assert ids[0] and not ids[0] & ids[1]
    for svg, known in zip((first, second), ids, strict=True):
        assert set(re.findall(r'(?:href="#|url\(#)([^")]+)', svg)) == known
    assert "<b>" not in first
    assert first == inline_svg(figure, 'a "title" <b>', "f1")


def test_losses_start_at_one_and_may_differ_in_length():
    table = normalised([np.array([4.0, 2.0, 1.0]), np.array([2.0, np.inf]), np.array([np.nan, 1.0]), np.array([])])
    np.testing.assert_array_equal(table, [[1.0, 0.5, 0.25], [1.0, np.inf, np.inf]])
    ended = normalised([np.array([4.0, 2.0, 1.0]), np.array([2.0, 0.5]), np.array([1.0, 0.0])])
    np.testing.assert_array_equal(ended, [[1.0, 0.5, 0.25], [1.0, 0.25, 0.25], [1.0, np.nan, np.nan]])


def test_the_scenario_reads_back_from_the_report():
    scenario = {
        "objects": ['odd "name"', "L2"],
        "support": ["rigid", 500.0],
        "truth": {"friction": None, "seed": 0},
        "random": [{"name": "r", "count": 2}],
        "sweep": {"mode": "grid", "axes": {"grid.feet": [2, 3]}},
        "methods": {"hidden_states": {}, "x y": {"method": "diff_lcp", "use_weight": True}},
    }
    back = tomllib.loads(toml_text(scenario))
    assert back == scenario | {"truth": {"seed": 0}}


def test_methods_that_know_no_hinges_have_no_row_of_them():
    rows = [row("hidden_states", seed, 0.01, hinge_error=0.02) for seed in range(3)]
    rows += [row("least_squares", seed, 0.03, hinge_error=float("nan")) for seed in range(3)]
    assert metrics_of(rows) == [NAD_METRIC, HINGES, *SHORTER_MPDS]
    exact = metric_table([row("hidden_states", 0, 0.01, hinge_error=0.0)], HINGES, "")
    assert [labels for labels, _ in exact.rows] == [("hidden_states",)]
    unpredicted = {metric.column: None for metric in SHORTER_MPDS}
    assert metrics_of([each | unpredicted for each in rows]) == [NAD_METRIC, HINGES]
    for table in (metric_table(rows, HINGES, ""), over_objects(rows, HINGES, "")):
        assert [labels for labels, _ in table.rows] == [("hidden_states",)]
    assert len(metric_table(rows, NAD_METRIC, "").rows) > 1


def test_hidden_states_have_a_row_a_label():
    one = [row("hidden_states", 0, 0.1, com_error_m=0.001, inertia_error=0.02, unobserved="")]
    two = [row("gradient", 0, 0.1, kind="hidden_states", com_error_m=0.003, inertia_error=0.04, unobserved="")]
    words = [(labels, cells[0].text) for labels, cells in hidden_table([*one, *two], ["L2"]).rows]
    assert words == [
        (("c, mm, ft300s, hidden_states",), "1.00"),
        (("c, mm, ft300s, gradient",), "3.00"),
        (("I_cm, %, ft300s, hidden_states",), "2.00"),
        (("I_cm, %, ft300s, gradient",), "4.00"),
    ]
    assert [labels for labels, _ in hidden_table(one, ["L2"]).rows] == [("c, mm, ft300s",), ("I_cm, %, ft300s",)]
