"""The published folder: trials rebuilt as they were, and no truth of the test split."""

import hashlib
import json
from dataclasses import asdict

import numpy as np
import pyarrow.parquet as pq
import pytest

from estimators.registry import build_method
from estimators.testing.recorded import load_block
from estimators.testing.truth import truth_within_reach
from scenarios.benchmark.dataset import SAMPLES, STEPS
from scenarios.benchmark.problems import KINDS, Cell, hidden, redrawn
from scenarios.benchmark.publish import publish
from scenarios.results.store import Store, object_request
from testbed.objects.files import ObjectFile, asset_folder
from testbed.trajectory import SERIES
from tests.scenarios.benchmark.conftest import BLOCKS, SECRET


@pytest.mark.parametrize("name", BLOCKS)
def test_trials_are_rebuilt_within_half_a_step(published, name):
    rebuilt = published.benchmark.trajectories(name)
    _, *given = published.entries[name].trials()
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


@pytest.mark.slow
@pytest.mark.parametrize("method", ["hidden_states", "least_squares"])
def test_an_estimator_gives_the_same_answer_on_rebuilt_trials(published, method):
    name = "validation-turns-ideal_0"
    problem, entry = published.benchmark.problems[name], published.entries[name]
    shape = problem.model(published.benchmark.folder).shape
    answers = [
        build_method(method, {}).estimate(shape, problem.weight_kg, trials, seed=0)
        for trials in (entry.trials()[1:], published.benchmark.trajectories(name))
    ]
    masses, errors = zip(*((a.group_mass(shape), a.group_error(shape)) for a in answers), strict=True)
    assert answers[0].status == answers[1].status
    assert (np.abs(np.subtract(*masses)) < 0.02 * errors[0]).all()


@pytest.mark.parametrize("name", BLOCKS)
def test_no_truth_within_reach_of_a_method(published, name):
    problem = published.benchmark.problems[name]
    shape = problem.model(published.benchmark.folder).shape
    trials = published.benchmark.trajectories(name)
    given = {"shape": shape, "weight": problem.weight_kg, "trajectories": trials, "seed": 0}
    clean = load_block(f"{BLOCKS[name]}-own_weight").clean[:3]
    assert truth_within_reach(given, published.entries[name].model, clean) == []
    assert truth_within_reach(given | {"more": published.entries[name].truth}, published.entries[name].model)


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
    assert info["total_frames"] == len(samples) and info["total_episodes"] == len(episodes) == 21
    assert info["splits"] == {"train": "0:7", "validation": "7:14", "test": "14:21"}
    assert list(samples.columns) == list(info["features"]) == list(stats)
    for row in episodes:
        own = samples[row["dataset_from_index"] : row["dataset_to_index"]]
        assert (own["episode_index"] == row["episode_index"]).all()
        assert np.allclose(own["timestamp"], np.arange(len(own)) / info["fps"], atol=1e-4)
    wrench = np.stack(samples["observation.sensor_wrench"].to_list())
    assert np.allclose(stats["observation.sensor_wrench"]["std"], wrench.std(axis=0), rtol=1e-5)


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
        "local/benchmark", root=published.benchmark.folder, delta_timestamps=window, episodes=[7, 8]
    )
    _, first, *_ = published.entries["validation-turns-ideal_0"].trials()
    item = dataset[50]
    assert item["task"] == "Turn the object on the table about a grasp with stepped acceleration."
    assert np.allclose(item["observation.sensor_wrench"], first.sensor_wrench[[40, 50]], atol=1e-3)
