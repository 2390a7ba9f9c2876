"""Results folders: read as tables and trajectories, counted by `heft status`, planned by --dry-run."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_array_equal
from rich.console import Console

from estimators.action_selection.cost import RobotTime
from estimators.base import Estimate, robot_seconds
from estimators.evaluation.statistics import axes_of
from estimators.testing.analytic_world import turns
from scenarios import Scenario, load_results, load_scenario, load_trajectories, run_scenario
from scenarios.cli.export import posterior_table
from scenarios.cli.main import main
from scenarios.cli.run import status
from scenarios.config import Sweep
from scenarios.results.estimates import load_rows, row_of
from scenarios.results.files import read_json, write_json
from scenarios.results.store import Store, write_arrays
from scenarios.results.table import rows_of, write_rows
from scenarios.results.trials import keys_of, kind_of_trial, trials_behind
from scenarios.study.dry_run import DryRun, show_dry_run
from scenarios.study.estimates import EstimateTask, judge
from scenarios.study.experiment import experiments_of
from scenarios.views import values
from scenarios.views.values import trial_view
from testbed import GRAVITY, InvalidValueError, ObjectModel, Trajectory, load_object
from tests.helpers.commands import ended, refusal
from tests.helpers.runs import quiet
from viz.report.tables import NAD, quantile_table
from viz.report.terminal import rich_table

SMALL = """
sensing = ["ft300s"]
seeds = 2
simulation = { grip = "weld", timestep_s = 0.002 }
grid = { feet = 2, particles = 2 }
[[random]]
name = "drawn"
count = 2
blocks = [2, 2]
[policy]
pivots = 2
duration = 2.0
accelerated = 0
held_out = 1
[sweep]
axes = { "methods.hidden_states.refinements" = [1, 3] }
[methods.hidden_states]
"""
AXIS = "axis.methods.hidden_states.refinements"


@pytest.fixture(scope="module")
def swept(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A finished folder: two drawn objects, one method with two settings, on the same trials."""
    folder = tmp_path_factory.mktemp("swept")
    (folder / "small.toml").write_text(SMALL)
    run_scenario(load_scenario(str(folder / "small.toml"))[1], folder / "out", 0, quiet)
    return folder / "out"


@pytest.mark.slow
def test_points_that_differ_in_the_estimator_alone_share_their_trials(swept):
    results = load_results(swept)
    assert len(results) == 2 * 2 * 2
    assert sorted(set(results[AXIS])) == [1, 3]
    assert len(list(swept.glob("trials/*/trial.json"))) == 2 * (1 + 2 + 1)
    by_rounds = {rounds: rows["nad"].tolist() for rounds, rows in results.groupby(AXIS)}
    assert by_rounds[1] != by_rounds[3]
    assert {path.name for path in (swept / "estimates").iterdir()} == set(results["key"])


@pytest.mark.slow
def test_drawn_objects_are_files_that_a_user_can_take(swept):
    files = sorted(swept.glob("objects/*/*.toml"))
    assert [path.stem for path in files] == ["drawn_0", "drawn_1"]
    results = rows_of(load_results(swept))
    for path in files:
        model = load_object(path)
        row = next(row for row in results if row["object"] == model.name)
        assert np.allclose(row["true_mass_kg"], model.group_mass)


def test_trajectories_are_read_one_by_one(finished):
    found = dict(load_trajectories(finished.out))
    assert len(found) == 4
    assert all(trajectory.ok for trajectory in found.values())
    with pytest.raises(InvalidValueError, match="trials/"):
        list(load_trajectories(finished.out / "estimates"))
    with pytest.raises(InvalidValueError, match=r"results\.parquet"):
        load_results(finished.out / "trials")


def said(show: object, *arguments: object) -> str:
    console = Console(width=200)
    with console.capture() as captured:
        show(console, *arguments)  # pyright: ignore[reportCallIssue]
    return captured.get()


def test_status_counts_what_is_there_what_failed_and_what_is_no_data(copied, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "200")
    trials, estimates = (sorted(copied.glob(name)) for name in ("trials/*/trial.json", "estimates/*/result.json"))

    def shown() -> str:
        main(["status", str(copied)])
        return capsys.readouterr().out

    text = shown()
    assert f"{copied}: finished" in text
    assert "trials: 4 done, 0 failed" in text
    assert re.search(r"estimates: 9 done( \([^)]*\))?, 0 failed", text)
    write_json(trials[0], (read_json(trials[0]) or {}) | {"status": "slipped"})
    for path in estimates:
        write_json(path, (read_json(path) or {}) | {"status": "no_data" if path == estimates[0] else "ok"})
    assert "trials: 4 done (1 slipped), 0 failed; estimates: 9 done (1 no data), 0 failed" in " ".join(shown().split())
    Store(copied).put_error("estimates", "0" * 20, "Traceback\nValueError: it broke\n")
    again = shown()
    assert "1 failed" in again
    assert "ValueError: it broke" in again
    with pytest.raises(InvalidValueError, match=r"manifest\.json"):
        status(copied / "trials")


def test_a_trial_is_viewed_as_a_method_was_given_it(copied):
    row = next(row for row in load_rows(copied) if row["sensing"] == "ft300s" and row["seed"] == 1)
    given, key = trials_behind(copied, row)[2], row["trial_keys"][2]
    view = trial_view(copied, key, seed=1, meshes=False)
    assert_array_equal(view.trajectory.wrench_on_object_world, given.wrench_on_object_world)
    assert view.facts["sensing"] == "ft300s, draw 1"
    (copied / "results.parquet").unlink()
    assert trial_view(copied, key, meshes=False).facts["sensing"] == "ft300s, an example draw"


def test_views_of_trials_read_the_table_once_until_it_is_written_again(copied, monkeypatch):
    key, read = load_rows(copied)[0]["trial_keys"][1], []
    monkeypatch.setattr(values, "load_results", lambda folder: read.append(folder) or load_results(folder))
    for times in (1, 2):
        for _ in range(2):
            trial_view(copied, key, meshes=False)
        assert len(read) == times
        write_rows(copied, rows_of(load_results(copied)))


def weighed(obj: ObjectModel) -> Trajectory:
    return Trajectory.of_scale(np.full(50, GRAVITY * obj.total_mass), np.arange(50) / 100, {})


def test_an_answer_without_data_counts_the_trials_that_are_none():
    obj = load_object("L2")
    good = turns(obj, [0, 1])
    trials = [weighed(obj), good[0], replace(good[1], status="slipped"), replace(good[1], status="fault")]
    row = judge(obj, Estimate(None, "no_data", "no trajectory"), trials, [], None)
    assert row["message"] == "no trajectory (of 4 trials: 1 slipped, 1 fault)"
    late = replace(good[0], time_s=good[0].time_s + 5)
    other = judge(obj, Estimate(None, "no_data", "none"), [trials[0], late], [], None)
    assert other["message"] == "none"
    recorded = robot_seconds([trials[0], good[0]])
    assert other["robot_s"] == pytest.approx(recorded + RobotTime().rise), "no time before a record counts"
    both = judge(obj, Estimate(None, "no_data", "none"), [*trials[:1], *good], [], None)
    way = RobotTime().between(obj.shape, good[0].action, good[1].action)
    assert both["robot_s"] == pytest.approx(recorded + robot_seconds(good[1:]) + RobotTime().rise + way)


def without(file: Path, name: str) -> None:
    """Take an array or a field out of a file."""
    if file.suffix == ".npz":
        with np.load(file) as arrays:
            kept = {key: value for key, value in arrays.items() if key != name}
        write_arrays(file, kept)
    else:
        write_json(file, {key: value for key, value in (read_json(file) or {}).items() if key != name})


ESTIMATE = (["view", "--web"], ["view", "--record"], ["view", "--figures"], ["export"])
TRIAL = (["view", "--web"], ["view", "--record"], ["view", "--film"])


def test_draws_are_of_the_method_as_a_sweep_sets_it(finished):
    row = next(row for row in load_rows(finished.out) if row["method"] == "hidden_states")
    asked = [{**row, "kind": "bayes"} | swept for swept in ({}, {"axis.methods.hidden_states.support": "rigid"})]
    base, rigid = (posterior_table(finished.out, each, 20).to_numpy() for each in asked)
    assert base.shape == rigid.shape and not np.allclose(base, rigid)
    with pytest.raises(InvalidValueError, match=r"got \{'support': 'soft'\}"):
        posterior_table(finished.out, asked[1] | {"axis.methods.hidden_states.support": "soft"}, 20)


def test_a_mapping_of_messages_is_not_written_over_its_objects_file(finished, tmp_path, capsys):
    turn = next(key for key in keys_of(finished.out) if kind_of_trial(finished.out, key) == "rotate")
    said = refusal(capsys, "export", str(finished.out), turn, "--format", "mcap", "--out", str(tmp_path / "pair.mcap"))
    assert "--out: got" in said and "allowed: another name: pair.toml beside it is the object's file" in said
    assert not list(tmp_path.glob("pair.*"))


@pytest.mark.parametrize(
    ("file", "harm", "commands"),
    [
        ("estimate.npz", "random.robot_seconds", ESTIMATE),
        ("estimate.npz", "random.loss", ESTIMATE),
        ("estimate.npz", "particles", ESTIMATE),
        ("estimate.npz", "friction", ESTIMATE),
        ("result.json", "status", ESTIMATE),
        ("trial.json", "asked", TRIAL),
        ("trial.json", "[]", TRIAL),
        ("trial.json", {"asked": {"action": "rotate"}}, TRIAL),
    ],
)
def test_a_file_of_another_format_is_one_clear_line(finished, copied, capsys, monkeypatch, file, harm, commands):
    row = finished.rows[finished.rows["method"] == "bare"].iloc[0]
    key = row["trial_keys"][1] if file == "trial.json" else row["key"]
    path = next(path for path in copied.rglob(file) if path.parent.name == key)
    if isinstance(harm, dict):
        write_json(path, harm)
    elif harm.isidentifier() or harm.startswith("random."):
        without(path, harm)
    else:
        path.write_text(harm, encoding="utf-8")
    monkeypatch.setattr("viz.recordings.viewer.served", pytest.fail)
    for command, *options in commands:
        assert key in refusal(capsys, command, str(copied), key, *options)


def test_an_export_says_what_its_masses_rest_on(finished, copied):
    row = finished.rows[finished.rows["method"] == "hidden_states"].iloc[0]
    main(["export", str(copied), row["key"], "--out", str(copied / "bar.xml")])
    for file in ("bar.xml", "bar.json"):
        text = (copied / file).read_text(encoding="utf-8")
        assert "status ok" in text and "assumed, not tested: every mass group rests on its own weight" in text


@pytest.mark.parametrize(
    ("support", "rigid", "first", "predicted"),
    [
        ("own_weight", False, True, True),
        ("rigid", True, True, True),
        ("1000 N/m", False, True, False),
        ("rigid", True, False, False),
    ],
)
def test_the_truth_predicts_with_its_own_support(support, rigid, first, predicted):
    obj = load_object("I2")
    task = EstimateTask(obj, support, {}, (), (), "", "ideal", (0,), "hidden_states", {}, reference=first)
    answer = Estimate(None, "no_data", "nothing")
    row = judge(obj, answer, [weighed(obj)], turns(obj, [0, 3], rigid=rigid), task.true_support)
    scores = [row["mpd_open_loop_of_truth_m"], row["mpd_turn_of_truth_m"]]
    assert (max(scores) < 1e-4) if predicted else np.isnan(scores).all()


@pytest.mark.parametrize(
    ("harm", "said"),
    [
        (lambda table, rows: table.write_bytes(table.read_bytes()[:5000]), "not a whole table"),
        (lambda table, rows: write_rows(table.parent, rows.drop(columns="nad").to_dict("records")), "no nad"),
    ],
    ids=["damaged", "another version"],
)
def test_a_table_that_cannot_be_read_is_one_clear_line(finished, copied, capsys, monkeypatch, harm, said):
    monkeypatch.setattr("viz.recordings.viewer.served", pytest.fail)
    harm(copied / "results.parquet", load_results(copied))
    export = ["export", finished.rows["key"][0]]
    for command, *words in (*(["view", f"--{way}"] for way in ("figures", "web", "record", "report")), export):
        line = refusal(capsys, command, str(copied), *words)
        assert line.startswith(f"heft: {copied}") and said in line


def test_an_ambiguous_key_is_called_so(copied, capsys):
    for kind in ("estimates", "trials"):
        for path in [path for path in copied.glob(f"{kind}/*") if path.name[0] != "0"]:
            path.rename(path.with_name("0" + path.name[1:]))
    rows = load_results(copied)
    write_rows(copied, [row | {"key": "0" + row["key"][1:]} for row in rows_of(rows)])
    for option, field in (("--figures", "ESTIMATE"), ("--record", "WHAT"), ("--film", "TRIAL")):
        said = refusal(capsys, "view", str(copied), "0", option)
        assert re.search(rf"heft: {field}: got '0'; .* this is ambiguous: \d+ begin so \(0", said)


def test_points_of_a_sweep_may_share_an_estimate(copied):
    rows = [row | {"axis.k": k} for k in (200, 400) for row in rows_of(load_results(copied))]
    write_rows(copied, rows)
    found = row_of(copied, str(rows[0]["key"]))
    assert (found["key"], found["axis.k"]) == (rows[0]["key"], 200)


@pytest.mark.slow
def test_views_of_a_damaged_folder_show_the_rest(finished, copied, capsys):
    row = finished.rows[finished.rows["method"] == "bare"].iloc[0]
    without(copied / "estimates" / row["key"] / "estimate.npz", "random.loss")
    write_json(copied / "trials" / row["trial_keys"][1] / "trial.json", {"asked": {"action": "rotate"}})
    write_json(copied / "manifest.json", {})
    for command in ("view --report", "status", "view --film"):
        name, *options = command.split()
        main([name, str(copied), *options])
    assert "estimates: 9 done" in capsys.readouterr().out


def test_a_dry_run_counts_and_writes_nothing(tmp_path):
    scenario = Scenario(objects=["I1", "L1"], support=["own_weight", "rigid"], sensing=["ideal", "low"], seeds=3)
    text = said(show_dry_run, scenario, tmp_path / "out", 2)
    assert "4 experiments" in text
    assert f"{4 * (1 + 6 + 6 + 2)} trials" in text
    assert f"{4 * (1 + 3)} estimates" in text
    assert ended("run", "blocks", "--dry-run", "--out", str(tmp_path / "out"), "--methods", "hidden") == 2
    with pytest.raises(InvalidValueError, match="object: got 'Q9'"):
        said(show_dry_run, scenario.model_copy(update={"objects": ["I1", "Q9"]}), tmp_path / "out", 2)
    main(["run", "blocks", "--dry-run", "--out", str(tmp_path / "out")])
    assert not (tmp_path / "out").exists()


def test_a_dry_run_counts_shared_trials_once_and_names_what_it_does_not_know():
    axes = {"truth.friction": [0.2, 0.4], "truth.seed": [0, 1, 2], "world.seed": [0, 1]}
    one = Scenario(objects=["I1"], sensing=["low"], methods={"hidden_states": {}, "mine": {"method": "my:Own"}})
    swept = Scenario.model_validate(one.model_dump() | {"sweep": {"axes": axes}})
    single, size = DryRun.of(one), DryRun.of(swept)
    assert size.points == 12 and size.trials == 2 * single.trials and size.estimates == 12 * single.estimates
    assert size.unknown == ("mine",)
    spread = swept.model_dump() | {"truth": {"friction_spread": 0.1}}
    assert DryRun.of(Scenario.model_validate(spread)).trials == 6 * single.trials
    lab = {"world": {"preset": "lab"}}  # whose seed decides trials
    swept_lab, single_lab = (DryRun.of(Scenario.model_validate(each.model_dump() | lab)) for each in (swept, one))
    assert swept_lab.trials == 4 * single_lab.trials


def test_a_dry_run_and_the_progress_count_the_objects_of_each_point(tmp_path):
    axes = {"objects": [["I1", "I2", "L2"], ["I1"]]}
    scenario = Scenario(objects=["I1"], sweep=Sweep(axes=axes))
    size, totals = DryRun.of(scenario), []
    assert (size.objects, size.experiments, size.estimates) == (3, 4, 4)
    assert size.trials == 3 * DryRun.of(Scenario(objects=["I1"])).trials
    experiments_of(scenario, Store(tmp_path), lambda stage, done, total, failed=0: totals.append((done, total)))
    assert totals == [(done, 4) for done in (1, 2, 3, 4)]


def test_many_objects_are_summarized_by_quantiles():
    rows = [
        {"object": f"o{i}", "support": "rigid", "sensing": "low", "axis.seeds": 1, "method": "a", "seed": s}
        | {"status": "ok", "nad": (i + 0.1 * s) / 100}
        for i in range(11)
        for s in (-1, 0, 1)
    ]
    rows.append(rows[0] | {"object": "lost", "status": "failed", "nad": None})
    assert axes_of(rows) == ["axis.seeds"]
    text = said(lambda console: console.print(rich_table(quantile_table(rows, NAD))))
    line = next(line for line in text.splitlines() if "rigid" in line)
    assert line.split() == ["rigid", "body", "low", "1", "a", "12", "1.0", "5.0", "9.0", "5.0", "1", "of", "34"]


@pytest.mark.parametrize("words", ["view DIR", "export DIR 3f9a", "doctor DIR"])
def test_a_missing_folder_is_named(tmp_path, capsys, words):
    missing = tmp_path / "nothing"
    said = refusal(capsys, *(str(missing) if word == "DIR" else word for word in words.split()))
    assert said == f"heft: DIR: got '{missing}'; allowed: a results folder; `heft run` makes one\n"


def test_options_of_a_film_are_only_for_films(copied, capsys):
    said = refusal(capsys, "view", str(copied), "--speed", "2")
    assert said == "heft: --speed: got 2.0; allowed: only with --film\n"
