"""A benchmark with hidden truth: made, published, answered and scored."""

import hashlib
import json
import math
from dataclasses import asdict
from types import SimpleNamespace

import numpy as np
import pyarrow.parquet as pq
import pytest

from estimators import Estimate, build_method
from estimators.testing.recorded import load_block
from estimators.testing.truth import truth_within_reach
from scenarios.benchmark import methods
from scenarios.benchmark import problems as problem_module
from scenarios.benchmark.answers import Answer, read_answers, write_answers
from scenarios.benchmark.dataset import SAMPLES, STEPS, Benchmark
from scenarios.benchmark.make import failure_of, make
from scenarios.benchmark.problems import KINDS, PUBLISHED_SECRET, SPLITS, Cell, Kind, hidden, redrawn
from scenarios.benchmark.publish import publish
from scenarios.benchmark.score import even_masses, figures, interval_score, judged_row, score, truths, with_masses
from scenarios.cli.main import main
from scenarios.policies import Policy
from scenarios.results.store import Store, object_request
from testbed import InvalidValueError, MassDistribution, Push
from testbed.objects.files import ObjectFile, asset_folder, load_object
from testbed.trajectory import SERIES
from tests.helpers.commands import ended, refusal
from tests.helpers.pages import BLOCKS as PAGE_BLOCKS
from tests.helpers.runs import quiet
from tests.scenarios.benchmark.conftest import BLOCKS, SECRET

ONE = {"train": 1, "validation": 0, "test": 1}
NAME = "validation-turns-ideal_0"
GROUPS = ("A1", "B1", "B2", "B3", "B4", "A4")


@pytest.fixture
def small(monkeypatch):
    """Two kinds of problems of a trial or two, in a lab."""
    turns = Kind("turns", Policy(pivots=1, accelerated=1, duration=2.0, most=2, held_out=0))
    tools = problem_module.KINDS["tools"]
    lifted = Kind(
        "tools", Policy(pivots=1, accelerated=0, lifts=1, duration=2.0, held_out=0), "rigid", tools.shapes[1:]
    )
    monkeypatch.setattr(problem_module, "KINDS", {"turns": turns, "tools": lifted})
    monkeypatch.setattr(problem_module, "WORLDS", ("lab",))


@pytest.mark.slow
def test_a_benchmark_is_made_resumed_and_scored(small, tmp_path, monkeypatch):
    made = make(tmp_path / "set", ONE, "a long secret of the tests", 0, quiet)
    assert (made.left_out, [each.split for each in made.problems]) == ((), ["train", "train", "test", "test"])
    benchmark = Benchmark.open(tmp_path / "set")
    for each in made.problems:
        trials = benchmark.trajectories(each.problem)
        shape = each.model(benchmark.folder).shape
        store = Store(tmp_path / "set-private" / ("test" if each.split == "test" else "public"))
        clean = [store.trajectory(path.parent.name) for path in store.root.glob("trials/*/trial.json")]
        own = [t for t in clean if t.action == trials[0].action]
        model = load_object(next(store.root.glob(f"objects/*/{each.problem}.toml")))
        given = {"shape": shape, "weight": each.weight_kg, "trajectories": trials[:1], "seed": 0}
        assert not [said for one in own for said in truth_within_reach(given, model, [one])]
    known = truths(benchmark, made.truth)
    assert set(known) == {each.problem for each in made.problems}
    assert 0 < figures(score(benchmark, {}, known, "test"))["nad"] < 2
    before = {path: path.read_bytes() for path in sorted((tmp_path / "set").rglob("*")) if path.is_file()}
    monkeypatch.setattr("scenarios.study.trials.simulate", None)  # nothing is simulated again
    make(tmp_path / "set", ONE, None, 0, quiet)
    assert {path: path.read_bytes() for path in before} == before
    with pytest.raises(InvalidValueError, match=r"--out: "):
        make(tmp_path / "set", ONE, "another secret of the tests", 0, quiet)


@pytest.mark.parametrize("secret", ["short", "", PUBLISHED_SECRET])
def test_a_short_or_published_secret_is_refused(tmp_path, secret):
    with pytest.raises(InvalidValueError, match="--secret") as refused:
        make(tmp_path / "set", dict.fromkeys(SPLITS, 1), secret, 0, quiet)
    assert not set(str(refused.value.given)) - {"*"}
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("arguments", [["--objects", "1", "2"], ["--objects", "0"], ["--objects", "-1"]])
def test_wrong_numbers_of_objects_are_refused(tmp_path, arguments):
    assert ended("benchmark", "make", *arguments, "--out", str(tmp_path / "set")) == 2


@pytest.mark.parametrize(
    ("facts", "why"),
    [
        ({"keys": ["weighing", "push"]}, ""),
        ({"failure": "weigh: the scale broke"}, "weigh: the scale broke"),
        ({"reasons": {Push((0.0, 0.0), 0.0): "95 N"}}, "every action was refused: 95 N"),
        ({}, "it has no trial"),
    ],
)
def test_an_object_without_a_trial_is_no_problem(facts, why):
    experiment = SimpleNamespace(**{"failure": "", "keys": ["weighing"], "reasons": {}} | facts)
    assert failure_of(experiment) == why  # pyright: ignore[reportArgumentType]


@pytest.mark.slow
def test_answers_are_written_and_not_made_again(published, tmp_path, monkeypatch, capsys):
    command = ["benchmark", "answer", "tests.scenarios.benchmark.test_benchmark:Even", "--workers", "0", "--out"]
    command += [str(tmp_path), "--benchmark", str(published.benchmark.folder)]
    main(command)
    (path,) = tmp_path.glob("validation/*.csv")
    (answer,) = read_answers(path, published.benchmark.problems).values()
    assert len(set(answer.mass_kg or ())) == 1 and answer.error_kg is None
    assert answer.status in ("ok", "unexplained", "not_converged")
    text = path.read_text()
    path.unlink()
    monkeypatch.setattr(methods, "answer", None)  # none is asked for again
    main(command)
    assert path.read_text() == text
    capsys.readouterr()
    main(["score", str(path), "--benchmark", str(published.benchmark.folder), "--json", str(tmp_path / "scores.json")])
    content = json.loads((tmp_path / "scores.json").read_text())["answers"]
    assert content[path.stem]["all"]["nad"] == pytest.approx(content["even masses"]["all"]["nad"])


def test_a_method_that_fails_has_its_reason_and_an_empty_answer(published, tmp_path, capsys):
    command = ["benchmark", "answer", "tests.scenarios.benchmark.test_benchmark:Broken", "--workers", "0", "--out"]
    assert ended(*command, str(tmp_path), "--benchmark", str(published.benchmark.folder)) == 1
    assert "no idea" in capsys.readouterr().out
    (answer,) = read_answers(next(tmp_path.glob("validation/*.csv")), published.benchmark.problems).values()
    assert (answer.mass_kg, answer.status) == (None, "failed")


class Even:
    """Estimator of even masses."""

    def estimate(self, shape, weight, trajectories, seed):
        mass = weight / shape.particles_per_group.sum()
        return Estimate(MassDistribution(np.full(shape.n_m, mass), np.full(shape.n_mu, 0.5)), "ok")


class Broken:
    """Estimator that fails."""

    def estimate(self, shape, weight, trajectories, seed):
        raise RuntimeError("no idea")


@pytest.mark.parametrize("name", BLOCKS)
def test_trials_are_rebuilt_within_half_a_step_and_hold_no_truth(published, name):
    problem, entry = published.benchmark.problems[name], published.entries[name]
    rebuilt = published.benchmark.trajectories(name)
    _, *given = entry.trials()
    for before, after in zip(given, rebuilt, strict=True):
        for series in SERIES:
            off = np.abs(getattr(before, series) - getattr(after, series)).max(axis=0)
            assert (off <= 0.5001 * 2.0 ** np.array(STEPS[series])).all(), series
        for exact in ("time_s", "phase", "segment", "sensor_bias_std", "sensor_drift_std"):
            assert np.array_equal(getattr(before, exact), getattr(after, exact))
        assert (before.action, before.status, before.setup) == (after.action, after.status, after.setup)
        assert asdict(before.tool)["mass"] == asdict(after.tool)["mass"]
    assert np.array_equal(rebuilt[0].camera.poses, given[0].camera.poses)
    assert rebuilt[0].camera.delay_std == given[0].camera.delay_std
    assert rebuilt[1].camera is None
    shape = problem.model(published.benchmark.folder).shape
    asked = {"shape": shape, "weight": problem.weight_kg, "trajectories": rebuilt, "seed": 0}
    clean = load_block(f"{BLOCKS[name]}-own_weight").clean[:3]
    assert truth_within_reach(asked, entry.model, clean) == []
    assert truth_within_reach(asked | {"more": entry.truth}, entry.model)


@pytest.mark.slow
@pytest.mark.parametrize("method", ["hidden_states", "least_squares"])
def test_an_estimator_gives_the_same_answer_on_rebuilt_trials(published, method):
    problem, entry = published.benchmark.problems[NAME], published.entries[NAME]
    shape = problem.model(published.benchmark.folder).shape
    answers = [
        build_method(method, {}).estimate(shape, problem.weight_kg, trials, seed=0)
        for trials in (entry.trials()[1:], published.benchmark.trajectories(NAME))
    ]
    masses, errors = zip(*((a.group_mass(shape), a.group_error(shape)) for a in answers), strict=True)
    assert answers[0].status == answers[1].status
    assert (np.abs(np.subtract(*masses)) < 0.02 * errors[0]).all()


def test_no_secret_and_no_truth_of_test_in_the_folder(published):
    folder, name = published.benchmark.folder, "test-turns-ideal_0"
    secret_words = [SECRET, json.loads(published.truth_file.read_text())["salt"], str(published.truth_file.parent)]
    for path in (path for path in folder.rglob("*") if path.is_file()):
        assert not [word for word in secret_words if word.encode() in path.read_bytes()], path
        if path.suffix == ".parquet" and path.name != "file-000.parquet":
            assert not [w for w in secret_words if w in json.dumps(pq.read_table(path).to_pylist())], path
    assert name not in {row["problem"] for row in pq.read_table(folder / "truth.parquet").to_pylist()}
    problems = pq.read_table(folder / "problems.parquet").to_pylist()
    assert not [word for row in problems for word in ("mass_kg", "friction") if word in row["shape"]]
    headers = [json.loads(row["header"]) for row in pq.read_table(folder / "trials.parquet").to_pylist()]
    assert all(header["figures"] == {} for header in headers)
    assert {name for header in headers for name in header["provenance"]} <= {"runner", "sensing"}


def test_the_card_commits_to_the_truth_of_test(published, tmp_path):
    digest = hashlib.sha256(published.truth_file.read_bytes()).hexdigest()
    assert digest == published.benchmark.facts["truth_sha256"]
    assert digest in (published.benchmark.folder / "README.md").read_text()
    publish(tmp_path / "public", list(published.entries.values()), tmp_path / "truth.json", "another secret of tests")
    assert hashlib.sha256((tmp_path / "truth.json").read_bytes()).hexdigest() != digest  # the same masses


@pytest.mark.parametrize(
    "file", sorted({shape for kind in KINDS.values() for shape in kind.shapes}), ids=lambda f: f.stem
)
def test_a_hidden_shape_is_the_true_one(file):
    drawn = redrawn(file, "drawn", np.random.default_rng(1))
    true, shown = drawn.build(3, file.parent), ObjectFile.model_validate(hidden(drawn))
    folder = asset_folder("objects")
    if shown.mesh:
        parts = [part.model_copy(update={"file": part.file.removeprefix("meshes/")}) for part in shown.mesh.parts]
        shown = shown.model_copy(update={"mesh": shown.mesh.model_copy(update={"parts": parts})})
    masked = ("mass", "friction", "solids", "masses", "chain")
    one, other = (
        {name: value for name, value in object_request(model).items() if name not in masked}
        for model in (true, shown.build(3, folder))
    )
    assert one == other
    assert json.dumps(hidden(drawn)) == json.dumps(hidden(redrawn(file, "drawn", np.random.default_rng(2))))


def test_objects_follow_from_the_secret_and_differ_between_cells(tmp_path):
    def layouts(secret: str, cell: Cell) -> list[str]:
        (family,) = cell.scenario(Store(tmp_path, secret)).random
        return [family.draw(index, 0).model_dump_json() for index in range(2)]

    cell, other = (Cell("test", "turns", world, 2) for world in ("ideal", "lab"))
    assert layouts("one secret", cell) == layouts("one secret", cell)
    drawn = [*layouts("one secret", cell), *layouts("another secret", cell), *layouts("one secret", other)]
    assert len(set(drawn)) == len(drawn)


def test_samples_are_episodes_of_their_trials(published):
    folder = published.benchmark.folder
    samples = pq.read_table(folder / SAMPLES).to_pandas()
    episodes = pq.read_table(folder / "meta/episodes/chunk-000/file-000.parquet").to_pylist()
    info, stats = (json.loads((folder / f"meta/{name}.json").read_text()) for name in ("info", "stats"))
    assert info["total_frames"] == len(samples) and info["total_episodes"] == len(episodes) == 11
    assert info["splits"] == {"train": "0:2", "validation": "2:9", "test": "9:11"}
    assert list(samples.columns) == list(info["features"]) == list(stats)
    for row in episodes:
        own = samples[row["dataset_from_index"] : row["dataset_to_index"]]
        assert (own["episode_index"] == row["episode_index"]).all()
        assert np.allclose(own["timestamp"], np.arange(len(own)) / info["fps"], atol=1e-4)
    wrench = np.stack(samples["observation.sensor_wrench"].to_list())
    assert np.allclose(stats["observation.sensor_wrench"]["std"], wrench.std(axis=0, dtype=float), rtol=1e-5)


def test_croissant_has_the_checksum_of_every_file(published):
    folder = published.benchmark.folder
    content = json.loads((folder / "croissant.json").read_text())
    files = {str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file()}
    stated = {entry["contentUrl"]: entry["sha256"] for entry in content["distribution"]}
    assert set(stated) == files - {"croissant.json", "benchmark.json"}
    assert all(hashlib.sha256((folder / name).read_bytes()).hexdigest() == digest for name, digest in stated.items())
    for record in content["recordSet"]:
        source = record["field"][0]["source"]["fileObject"]["@id"]
        columns = pq.read_schema(folder / source).names
        assert [each["source"]["extract"]["column"] for each in record["field"]] == columns


@pytest.mark.slow
def test_mlcroissant_reads_every_record_set(published):
    mlc = pytest.importorskip("mlcroissant")
    dataset = mlc.Dataset(str(published.benchmark.folder / "croissant.json"))
    for name in ("problems", "trials", "truth", "samples"):
        assert next(iter(dataset.records(name)))


@pytest.mark.slow
def test_lerobot_loads_the_folder(published):
    lerobot = pytest.importorskip("lerobot.datasets.lerobot_dataset")
    window = {"observation.sensor_wrench": [-0.1, 0.0]}
    dataset = lerobot.LeRobotDataset(
        "local/benchmark", root=published.benchmark.folder, delta_timestamps=window, episodes=[2, 3]
    )
    _, first, *_ = published.entries[NAME].trials()
    item = dataset[50]
    assert item["task"] == "Turn the object on the table about a grasp with stepped acceleration."
    assert np.allclose(item["observation.sensor_wrench"], first.sensor_wrench[[40, 50]], atol=1e-3)


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
        (second(NAME + ",{},0.1_5,,"), "line 3, mass_kg"),
        (second(NAME + ",{}," + 200_000 * "1" + ",,"), "line 3: .*field larger"),
        (second(NAME + ",{},0.1,-1,"), "line 3, error_kg"),
        (second(NAME + ",{},0.1,nan,"), "line 3, error_kg"),
        (second(NAME + ",{},0.1,,okay"), "line 3, status.*nearest: ok"),
        (second(NAME + ",{},,,ok"), "line 3, mass_kg"),
        (second(NAME + ",{},0.1,0.1,ok,more"), "line 3, row"),
        (lambda rows: [*rows, rows[0]], f"line {len(GROUPS) + 2}, group"),
        (lambda rows: rows[1:], f"{NAME}: got 'no row of"),
        (second(NAME + ",{},0.1,,ok"), "error_kg"),
        (second(NAME + ",{},0.1,0.01,unexplained"), "status"),
        ("problem,group,mass", "line 1.*nearest: mass_kg"),
        ("", "column problem"),
        ("problem,group,mass_kg,mass_kg,status", "line 1.*mass_kg once"),
    ],
)
def test_mistakes_of_a_file_by_hand_are_named(published, tmp_path, change, said):
    """A change of the rows, or another header."""
    path = by_hand(published, tmp_path, **{"header" if isinstance(change, str) else "change": change})
    with pytest.raises(InvalidValueError, match=said):
        read_answers(path, published.benchmark.problems)


def test_a_file_by_hand_needs_three_columns(published, tmp_path):
    path = by_hand(published, tmp_path, lambda rows: [row.rsplit(",", 2)[0] for row in rows], "problem, group,mass_kg")
    answer = read_answers(path, published.benchmark.problems)[NAME]
    assert answer == Answer(published.benchmark.truth[NAME].mass_kg, None, "ok")


def test_answers_return_from_their_file(published, tmp_path):
    problems = published.benchmark.problems
    answers = {
        name: Answer((0.1, 1 / 3, 0.0, 0.2, 0.3, 3.4e4), (math.inf, 0.1, 0.0, 1e-9, 2.0, 1.0), "underdetermined")
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
def test_an_object_takes_other_masses(name):
    model = load_object(name)
    same, heavy = (with_masses(model, f * model.group_mass, model.truth.friction) for f in (1, 3))
    assert same.center_of_mass == pytest.approx(model.center_of_mass)
    assert (same.inertia_cm, heavy.inertia_cm) == pytest.approx((model.inertia_cm, 3 * model.inertia_cm))
    first = with_masses(model, np.eye(model.shape.n_m)[0], model.truth.friction)  # the others have none
    alone = model.solids[0].center_of_mass[:2] if model.solids else model.shape.middle_of(0)
    assert first.center_of_mass == pytest.approx(alone, abs=1e-8)
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
    assert ended("score", str(tmp_path / "none.csv"), "--benchmark", str(published.benchmark.folder)) == 2
    even = path.rename(tmp_path / "even masses.csv")
    assert "none of them even masses" in refusal(
        capsys, "score", str(even), "--benchmark", str(published.benchmark.folder)
    )


def test_the_example_in_plain_python_writes_answers(published, tmp_path, monkeypatch, capsys):
    (example,) = [block.text for block in PAGE_BLOCKS if block.page == "benchmark.md" and block.title == "even.py"]
    assert "heft" not in example and "scenarios" not in example
    (tmp_path / "results").mkdir()
    (tmp_path / "results" / "benchmark").symlink_to(published.benchmark.folder)
    monkeypatch.chdir(tmp_path)
    exec(compile(example, "even.py", "exec"), {})
    count = sum(len(trial.time_s) for trial in published.benchmark.trajectories(NAME))
    assert f"{NAME} ['name', 'blocks'] {count} wrenches" in capsys.readouterr().out
    answer = read_answers(tmp_path / "even.csv", published.benchmark.problems)[NAME]
    assert answer.mass_kg == answer.error_kg and answer.mass_kg is not None and len(answer.mass_kg) == len(GROUPS)
