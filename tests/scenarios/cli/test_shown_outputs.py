"""Outputs that the README and the documentation show are what their commands print."""

import re
import runpy
import shlex
from pathlib import Path
from statistics import fmean

import pytest

from bench.tables import METHODS, Figures, readme_table, replaced, shown
from estimators.testing.conformance import recovers
from estimators.testing.recorded import load_block
from scenarios import load_scenario, run_scenario
from scenarios.cli.main import main
from scenarios.results.table import rows_of
from tests.helpers.pages import BLOCKS, README, ROOT, Block, blocks_of, run_file, write_tutorial
from tests.helpers.runs import quiet

SHOWN = [*blocks_of(README), *BLOCKS]
QUICK = [block for block in SHOWN if block.mark.startswith("output: ")]
LONG = sorted(
    (block for block in SHOWN if block.mark.startswith("long output: ")), key=lambda block: block.page == "python.md"
)
"""Blocks of commands that take long, in order: python.md reads results of the tutorial."""
NUMBER = re.compile(r"\d+(?:\.\d+)?")


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """A clone's `docs/objects`, and every titled file of the tutorial."""
    path = tmp_path_factory.mktemp("shown")
    (path / "docs").symlink_to(ROOT / "docs")
    return write_tutorial(path)


@pytest.fixture
def inside(folder, monkeypatch) -> Path:
    monkeypatch.chdir(folder)
    monkeypatch.syspath_prepend(str(folder))
    monkeypatch.setenv("COLUMNS", "80")
    run_file("make_mallet.py")
    return folder


def command_of(block: Block) -> list[str]:
    return shlex.split(block.mark.split(": ", 1)[1])


def lines_of(text: str) -> list[str]:
    return [line.rstrip() for line in text.rstrip().splitlines()]


def near(shown: str, printed: str) -> bool:
    """True if two lines have the same words, and numbers within 5 % and one of the last place.

    Other processors round otherwise, and a simulated grip amplifies it.
    """
    if " ".join(NUMBER.sub("#", shown).split()) != " ".join(NUMBER.sub("#", printed).split()):
        return False
    pairs = zip(NUMBER.findall(shown), NUMBER.findall(printed), strict=True)
    return all(abs(float(a) - float(b)) <= 0.05 * float(a) + 1.01 * 0.1 ** len(a.partition(".")[2]) for a, b in pairs)


def missing(shown: str, printed: str) -> str:
    """First shown line that is not among the printed ones, in their order; empty if all are. `...` stands for a cut."""
    rest = iter(printed.splitlines())
    wanted = [line for line in shown.splitlines() if line.strip() not in ("", "...") and "──" not in line]
    return next((line for line in wanted if not any(near(line, other) for other in rest)), "")


@pytest.mark.parametrize(
    ("shown", "printed", "lacks"),
    [
        ("a 1.00\n...\nb 2", "head\n a  1.04\nc\nb 2", ""),
        ("NAD: 0.013", "NAD: 0.008", "NAD: 0.013"),
        ("a 0.9±0.4", "a 0.9±0.4*", "a 0.9±0.4"),
        ("b 2\na 1", "a 1\nb 2", "a 1"),
        ("60 trials", "60 trials of 61", "60 trials"),
    ],
)
def test_a_stale_line_is_found(shown, printed, lacks):
    assert missing(shown, printed) == lacks


def test_every_shown_output_names_its_command():
    pages = ("README.md", "tutorial.md", "write_an_estimator.md")
    bare = [block.text for block in SHOWN if block.page in pages and not block.language and not block.mark]
    assert not bare, "no test compares it: mark it as `<!-- output: COMMAND -->` or `<!-- long output: COMMAND -->`"
    slow = {f"python {block.title}" for block in SHOWN if block.mark == "slow"}
    assert slow <= {block.mark.removeprefix("long output: ") for block in LONG}


@pytest.mark.parametrize("block", QUICK, ids=lambda b: b.mark)
def test_a_quick_command_prints_what_is_shown(block, inside, monkeypatch, capsys):
    shown = lines_of(block.text)
    if max(map(len, shown)) > 80:
        monkeypatch.setenv("COLUMNS", "120")
    main(command_of(block)[1:])
    assert lines_of(capsys.readouterr().out) == shown


@pytest.mark.slow
def test_a_long_command_prints_what_is_shown(inside, monkeypatch, capsys):
    monkeypatch.setenv("COLUMNS", "120")
    stale = []
    for block in LONG:
        program, *words = command_of(block)
        if program == "python":
            run_file(*words)
        else:
            main([*words, *(["--workers", "0"] if words[0] == "run" else [])])
        if line := missing(block.text, capsys.readouterr().out):
            stale.append((block.mark, line))
    assert not stale


def test_the_kit_reports_an_object_of_two_frictions_as_shown(inside, monkeypatch):
    """The report that `write_an_estimator.md` shows for its class without the two lines on `n_mu`."""
    text = (inside / "my_estimator.py").read_text(encoding="utf-8")
    guard = re.compile(r"^        if shape\.n_mu > 1:\n.*\n", re.MULTILINE)
    assert guard.search(text)
    (inside / "unguarded.py").write_text(guard.sub("", text), encoding="utf-8")
    method = runpy.run_path("unguarded.py")["LeastSquares"]()
    block = load_block("two_frictions-own_weight")
    with pytest.raises(AssertionError) as error:
        recovers(method, block, "ideal", block.trials("ideal"))
    shown = next(b.text for b in SHOWN if b.mark == "report of the kit")
    assert not missing(shown, str(error.value))


@pytest.mark.parametrize("page", ["README.md", "docs/index.md", "docs/tutorial.md", "viz/report/report.html.j2"])
def test_nad_is_said_to_be_twice_the_misplaced_part(page):
    text = " ".join((ROOT / page).read_text(encoding="utf-8").split())
    meaning = text.split("ormalized absolute difference", 1)[1][:250]
    assert "sum of" in meaning and "twice" in meaning and "misplaced" in meaning


@pytest.mark.parametrize("name", METHODS)
def test_a_table_of_the_readme_is_that_of_its_figures(name: str):
    page = README.read_text(encoding="utf-8")
    assert replaced(page, name, readme_table(name, Figures.read(name))) == page, "python bench/tables.py writes it"


def test_the_printed_table_of_the_comparison_is_that_of_its_figures():
    figures = Figures.read("blocks")
    block = next(block.text for block in SHOWN if block.page == "baselines.md" and "own weight, ft300s" in block.text)
    means = {row.split()[0]: re.findall(r"([\d.]+)±", row) for row in block.splitlines() if "±" in row}
    assert {*METHODS["blocks"]} < {*means}
    objects = list(dict.fromkeys(row["object"] for row in figures.rows if row["object"] != "all"))
    for method, cells in means.items():
        kept = [float(figures.cell(method, name, "nad_mean")) for name in objects]
        assert [shown(mean) for mean in kept] == [shown(float(cell)) for cell in cells], method


@pytest.mark.slow
def test_figures_of_the_lab_come_again(tmp_path: Path):
    """One object of the table by the methods that take no time, from its secret."""
    figures, methods = Figures.read("lab"), ("least_squares", "explicit_state_M_cov")
    secret = figures.command.rpartition("--secret ")[2]
    scenario = load_scenario("lab")[1].changed(objects=["L1"], methods=methods)
    rows = rows_of(run_scenario(scenario, tmp_path, 2, quiet, secret=secret))
    for method in methods:
        mean = fmean(100 * row["nad"] for row in rows if row["method"] == method)
        assert near(figures.cell(method, "L1", "nad_mean"), f"{mean:.4f}"), method
