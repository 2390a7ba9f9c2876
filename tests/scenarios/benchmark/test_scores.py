"""Answers as CSV, also one written by hand with its mistakes, and their scores against closed formulas."""

import json
import math

import numpy as np
import pytest

from scenarios.benchmark.answers import Answer, read_answers, write_answers
from scenarios.benchmark.score import (
    Moments,
    even_masses,
    figures,
    interval_score,
    judged_row,
    score,
    truths,
)
from scenarios.cli.main import main
from testbed.errors import InvalidValueError
from testbed.objects.files import load_object
from tests.helpers.pages import BLOCKS

NAME = "validation-turns-ideal_0"
GROUPS = ("A1", "B1", "B2", "B3", "B4", "A4")


def by_hand(published, tmp_path, change=lambda rows: rows, header="problem,group,mass_kg,error_kg,status"):
    """CSV file of the true masses, as a user may write it, changed."""
    problem, truth = published.benchmark.problems[NAME], published.benchmark.truth[NAME]
    rows = [f"{NAME},{group},{mass:.4f},0.01,ok" for group, mass in zip(problem.groups, truth.mass_kg, strict=True)]
    path = tmp_path / "mine.csv"
    path.write_text("\n".join([header, *change(rows)]) + "\n", encoding="utf-8")
    return path


def second(text):
    """Change of the third line of a file, the second row."""
    return lambda rows: [rows[0], text.format(rows[1].split(",")[1]), *rows[2:]]


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (second("validation-turns-ideal_1,{},0.1,,"), "line 3, problem.*nearest: validation-turns-ideal_0"),
        (second(NAME + ",{}x,0.1,,"), "line 3, group"),
        (second(NAME + ",{},nan,,"), "line 3, mass_kg"),
        (second(NAME + ",{},-0.1,,"), "line 3, mass_kg"),
        (second(NAME + ",{},0.1 kg,,"), "line 3, mass_kg"),
        (second(NAME + ",{},0.1,-1,"), "line 3, error_kg"),
        (second(NAME + ",{},0.1,nan,"), "line 3, error_kg"),
        (second(NAME + ",{},0.1,,okay"), "line 3, status.*nearest: ok"),
        (second(NAME + ",{},,,ok"), "line 3, mass_kg"),
        (second(NAME + ",{},0.1,0.1,ok,more"), "line 3, row"),
        (lambda rows: [*rows, rows[0]], f"line {len(GROUPS) + 2}, group"),
        (lambda rows: rows[1:], f"{NAME}: got 'no row of"),
        (second(NAME + ",{},0.1,,ok"), "error_kg"),
        (second(NAME + ",{},0.1,0.01,unexplained"), "status"),
    ],
)
def test_mistakes_of_a_file_by_hand_are_named(published, tmp_path, change, said):
    with pytest.raises(InvalidValueError, match=said):
        read_answers(by_hand(published, tmp_path, change), published.benchmark.problems)


@pytest.mark.parametrize(
    ("header", "said"), [("problem,group,mass", "line 1.*nearest: mass_kg"), ("", "column problem")]
)
def test_a_wrong_header_is_named(published, tmp_path, header, said):
    with pytest.raises(InvalidValueError, match=said):
        read_answers(by_hand(published, tmp_path, header=header), published.benchmark.problems)


def test_a_file_by_hand_needs_three_columns(published, tmp_path):
    path = by_hand(published, tmp_path, lambda rows: [row.rsplit(",", 2)[0] for row in rows], "problem, group,mass_kg")
    answer = read_answers(path, published.benchmark.problems)[NAME]
    assert answer == Answer(published.benchmark.truth[NAME].mass_kg, None, "ok")


def test_answers_return_from_their_file(published, tmp_path):
    problems = published.benchmark.problems
    answers = {
        name: Answer((0.1, 1 / 3, 0.0, 0.2, 0.3, 0.4), (math.inf, 0.1, 0.0, 1e-9, 2.0, 1.0), "underdetermined")
        for name in problems
    }
    answers[NAME] = Answer(None, None, "failed")
    write_answers(tmp_path / "a.csv", answers, problems.values())
    assert read_answers(tmp_path / "a.csv", problems) == answers


def test_true_masses_score_nothing_and_a_missing_answer_counts_as_even_masses(published):
    truth = published.benchmark.truth
    exact = {NAME: Answer(truth[NAME].mass_kg, tuple(0.001 for _ in GROUPS))}
    (row,) = score(published.benchmark, exact, truth, "validation")
    found = figures([row])
    assert [found[name] for name in ("nad", "com_error_m", "inertia_error", "silent")] == pytest.approx([0] * 4)
    assert found["held"] == found["answered"] == 1
    whole = sum(truth[NAME].mass_kg)
    assert found["interval_score"] == pytest.approx(2 * 1.6448536 * 0.001 / whole)
    (row,) = score(published.benchmark, {}, truth, "validation")
    even = np.full(len(GROUPS), published.benchmark.problems[NAME].weight_kg / len(GROUPS))
    assert row["nad"] == pytest.approx(np.abs(even - truth[NAME].mass_kg).sum() / whole)
    assert math.isnan(figures([row])["held"]) and figures([row])["missing"] == 1


@pytest.mark.parametrize(("status", "silent"), [("ok", 1.0), ("unexplained", 0.0)])
def test_a_mass_off_by_four_claimed_errors_is_silent_where_the_status_is_ok(published, status, silent):
    problem, truth = published.benchmark.problems[NAME], published.benchmark.truth[NAME]
    mass = (truth.mass_kg[0] + 0.04, *truth.mass_kg[1:])
    model = problem.model(published.benchmark.folder)
    row = judged_row(problem, model, truth, Answer(mass, (0.01,) * len(mass), status))
    found = figures([row])
    assert (found["silent"], found["held"]) == (silent, pytest.approx(5 / 6))


def test_interval_scores_by_hand():
    mass, error, truth = (
        np.array([1.0, 1.0, 0.0, 1.0]),
        np.array([0.1, 0.1, 0.0, np.inf]),
        np.array([1.1, 1.5, 0.2, 1.0]),
    )
    z = 1.6448536
    expected = [0.2 * z, 0.2 * z + 20 * (0.5 - 0.1 * z), 20 * 0.2, 3.0]
    assert interval_score(mass, error, truth, 3.0) == pytest.approx(expected)


def test_the_true_spread_has_the_least_interval_score():
    rng = np.random.default_rng(0)
    truth, mass = np.full(40_000, 1.0), rng.normal(1.0, 0.1, 40_000)
    means = [interval_score(mass, np.full(len(mass), spread), truth, 9.0).mean() for spread in (0.07, 0.1, 0.14)]
    assert np.argmin(means) == 1


@pytest.mark.parametrize("name", ["L2", "hammer"])
def test_moments_are_those_of_the_object(name):
    model = load_object(name)
    center, inertia = Moments.of(model).at(model.group_mass)
    assert center == pytest.approx(model.center_of_mass, abs=1e-12)
    assert inertia == pytest.approx(model.inertia_cm)
    assert even_masses(model.shape, 2.0).sum() == pytest.approx(2.0)


def test_test_is_scored_with_its_own_truth_file_alone(published, tmp_path):
    benchmark = published.benchmark
    with pytest.raises(InvalidValueError, match="--truth"):
        score(benchmark, {}, truths(benchmark, None), "test")
    (row,) = score(benchmark, {}, truths(benchmark, published.truth_file), "test")
    assert row["true_mass_kg"] == list(published.entries["test-turns-ideal_0"].truth.mass_kg)
    other = tmp_path / "truth.json"
    other.write_bytes(published.truth_file.read_bytes().replace(b"0.1", b"0.2", 1))
    with pytest.raises(InvalidValueError, match="--truth"):
        truths(benchmark, other)


def test_the_command_prints_and_writes_the_same_figures(published, tmp_path, capsys):
    path = by_hand(published, tmp_path)
    main(["score", str(path), "--benchmark", str(published.benchmark.folder), "--json", str(tmp_path / "s.json")])
    shown, content = capsys.readouterr().out, json.loads((tmp_path / "s.json").read_text())
    assert "ideal, turns" in shown and "even masses" in shown
    assert content["answers"]["mine"]["all"]["nad"] < 1e-3 < content["answers"]["even masses"]["all"]["nad"]
    with pytest.raises(SystemExit) as ended:
        main(["score", str(tmp_path / "none.csv"), "--benchmark", str(published.benchmark.folder)])
    assert ended.value.code == 2


def test_the_example_in_plain_python_writes_answers(published, tmp_path, monkeypatch, capsys):
    (example,) = [block.text for block in BLOCKS if block.page == "benchmark.md" and block.title == "even.py"]
    assert "heft" not in example and "scenarios" not in example
    (tmp_path / "results").mkdir()
    (tmp_path / "results" / "benchmark").symlink_to(published.benchmark.folder)
    monkeypatch.chdir(tmp_path)
    exec(compile(example, "even.py", "exec"), {})
    count = sum(len(trial.time_s) for trial in published.benchmark.trajectories(NAME))
    assert f"{NAME} ['name', 'blocks'] {count} wrenches" in capsys.readouterr().out
    answer = read_answers(tmp_path / "even.csv", published.benchmark.problems)[NAME]
    assert answer.mass_kg == answer.error_kg and answer.mass_kg is not None and len(answer.mass_kg) == len(GROUPS)
