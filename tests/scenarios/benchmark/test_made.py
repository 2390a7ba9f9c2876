"""The benchmark from simulation to scores: made, resumed, answered; and methods on its problems."""

import json

import numpy as np
import pytest

from estimators.base import Estimate
from estimators.testing.truth import truth_within_reach
from scenarios.benchmark import methods
from scenarios.benchmark import problems as problem_module
from scenarios.benchmark.answers import read_answers
from scenarios.benchmark.dataset import Benchmark
from scenarios.benchmark.make import make
from scenarios.benchmark.problems import PUBLISHED_SECRET, SPLITS, Kind
from scenarios.benchmark.score import figures, score, truths
from scenarios.cli.main import main
from scenarios.policies import Policy
from scenarios.results.store import Store
from testbed.errors import InvalidValueError
from testbed.objects.files import load_object
from testbed.objects.model import MassDistribution

ONE = {"train": 1, "validation": 0, "test": 1}


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


def quiet(stage: str, done: int, total: int, failed: int = 0) -> None: ...


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
    with pytest.raises(InvalidValueError, match="--output"):
        make(tmp_path / "set", ONE, "another secret of the tests", 0, quiet)


@pytest.mark.parametrize("secret", ["short", "", PUBLISHED_SECRET])
def test_a_short_or_published_secret_is_refused(tmp_path, secret):
    with pytest.raises(InvalidValueError, match="--secret") as refused:
        make(tmp_path / "set", dict.fromkeys(SPLITS, 1), secret, 0, quiet)
    assert not set(str(refused.value.given)) - {"*"}
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("arguments", [["--objects", "1", "2"], ["--objects", "0"], ["--objects", "-1"]])
def test_wrong_numbers_of_objects_are_refused(tmp_path, arguments):
    with pytest.raises(SystemExit) as ended:
        main(["benchmark", "make", *arguments, "--output", str(tmp_path / "set")])
    assert ended.value.code == 2


def test_answers_are_written_and_not_made_again(published, tmp_path, monkeypatch, capsys):
    command = ["benchmark", "answer", "tests.scenarios.benchmark.test_made:Even", "--workers", "0", "--output"]
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
    command = ["benchmark", "answer", "tests.scenarios.benchmark.test_made:Broken", "--workers", "0", "--output"]
    with pytest.raises(SystemExit) as ended:
        main([*command, str(tmp_path), "--benchmark", str(published.benchmark.folder)])
    assert ended.value.code == 1 and "no idea" in capsys.readouterr().out
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
