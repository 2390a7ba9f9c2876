"""Methods of others that fail: named with file, line and traceback, and tables and a report in any case."""

import re
import shutil
from pathlib import Path
from typing import Any

import pytest
from mujoco import sysid

from estimators.registry import ESTIMATOR
from scenarios.cli import terminal
from scenarios.cli.main import main
from scenarios.results.estimates import load_results
from scenarios.study import run as study
from testbed.errors import HeftError, InvalidValueError
from testbed.plugins import load_class, placed_errors
from testbed.trial import parse_support
from tests.helpers.commands import ended, refusal

METHODS = """
import numpy as np
from estimators import Estimate
from testbed.objects.model import MassDistribution

class Fails:
    def estimate(self, shape, weight, trajectories, seed):
        np.linalg.inv(np.zeros((2, 2)))  # line 8

class Dict:
    def estimate(self, shape, weight, trajectories, seed):
        return {"mass": 1}

class Status:
    def estimate(self, shape, weight, trajectories, seed):
        return Estimate(None, "great")

class Short:
    def estimate(self, shape, weight, trajectories, seed):
        return Estimate(MassDistribution([1.0], [0.5]), "ok")

class Markup:
    def estimate(self, shape, weight, trajectories, seed):
        raise ValueError("[/oops] pip install 'x[sysid]'")

class Bare:
    def estimate(self, shape, weight, trajectories, seed):
        return Estimate(np.ones(shape.n_m), "ok")

class NotANumber:
    def estimate(self, shape, weight, trajectories, seed):
        return Estimate(MassDistribution(np.full(shape.n_m, np.nan), [0.5]), "ok")

class Exit:
    def estimate(self, shape, weight, trajectories, seed):
        raise SystemExit(3)
"""
BATCHES = """
from estimators import Estimate

class Apart:
    def estimate(self, shape, weight, trajectories, seed):
        if seed == 1:
            raise ValueError("not this one")
        return Estimate(None, "no_data", "one by one")

class Raises(Apart):
    def estimate_many(self, shape, weights, draws, seeds):
        open("Raises", "a").write(f"{len(draws)} ")
        raise ValueError("no")

class Nothing(Apart):
    def estimate_many(self, shape, weights, draws, seeds):
        open("Nothing", "a").write(f"{len(draws)} ")
        return []

class Nones(Apart):
    def estimate_many(self, shape, weights, draws, seeds):
        open("Nones", "a").write(f"{len(draws)} ")
        return [None] * len(draws)

class Together(Apart):
    def estimate_many(self, shape, weights, draws, seeds):
        return [Estimate(None, "no_data", f"{len(draws)} at once") for _ in draws]
"""
REASONS = {
    "Fails": r"LinAlgError: Singular matrix \(failing.py, line 8\)",
    "Dict": r"failing:Dict.estimate\(\): got {'mass': 1}; allowed: an Estimate of estimators.base",
    "Status": r"Estimate.status: got 'great'; allowed: one of ok, .* \(failing.py, line 16\)",
    "Short": r"failing:Short.estimate\(\): got '1 masses, 1 frictions'; allowed: 2 and 1, one of each mass group",
    "Bare": r"Estimate.distribution: got array.*; allowed: a MassDistribution, or None \(failing.py, line 28\)",
    "NotANumber": r"MassDistribution.mass: got '2 NaN.* \(failing.py, line 32\)",
    "Exit": r"SystemExit: 3 \(failing.py, line 36\)",
    "Markup": r"ValueError: \[/oops\] pip install 'x\[sysid\]' \(failing.py, line 24\)",
}

FAILED = "ValueError: [/oops] pip install 'x[sysid]' (failing.py, line 24)"
TERMINAL = Path(terminal.__file__)
CLI = TERMINAL.parent


@pytest.fixture
def here(tmp_path, as_user, finished) -> Path:
    """A user's folder with methods that fail, and `out` with the trials of a run and nothing else."""
    for part in ("trials", "notes"):
        shutil.copytree(finished.out / part, tmp_path / "out" / part)
    return as_user(failing=METHODS)


@pytest.mark.slow
def test_nothing_but_failures_is_a_table_a_report_and_the_place_of_each_error(here, finished, capsys):
    names = [f"failing:{name}" for name in REASONS]
    assert ended("run", str(finished.scenario), "--out", "out", "--workers", "0", "--methods", *names) == 1
    said = capsys.readouterr().out
    assert "Normalized absolute difference" in said and (here / "out" / "report.html").is_file()
    for name, reason in REASONS.items():
        (line,) = re.findall(
            rf"failing:{name}: 3 failed \(pair; own weight, .*\): .*{reason}.*\n  traceback: (.*)", said
        )
        assert "Traceback" in Path(line).read_text(encoding="utf-8")
    rows = load_results(here / "out")
    assert set(rows["status"]) == {"failed"} and rows["nad"].isna().to_numpy().all()
    main(["view", "out", "--figures"])
    main(["status", "out"])
    assert re.search(rf"error.txt: {REASONS['Fails']}", capsys.readouterr().out)


@pytest.mark.slow
@pytest.mark.usefixtures("no_views")
def test_a_method_beside_those_that_fail_answers(here, finished):
    names = ["failing:Fails", "failing:NotANumber", "failing:Exit", "tests.fakes.misbehaving:Misbehaving"]
    asked = [*names, "hidden_states"]
    assert ended("run", str(finished.scenario), "--out", "out", "--workers", "0", "--methods", *asked) == 1
    rows = load_results(here / "out").set_index("method")
    assert not set(rows.loc["hidden_states", "status"]) - {"ok", "unexplained"}
    assert set(rows.loc[names, "status"]) == {"failed"}
    assert all(
        "RuntimeError: out of ideas (" in m and "misbehaving.py, line" in m for m in rows.loc[names[3], "message"]
    )


@pytest.mark.slow
@pytest.mark.usefixtures("no_views")
def test_a_batch_that_fails_is_asked_one_draw_at_a_time(here, finished):
    (here / "failing.py").write_text(BATCHES, encoding="utf-8")
    batches = ["Raises", "Nothing", "Nones"]
    names = [f"failing:{name}" for name in ("Apart", *batches)]
    assert ended("run", str(finished.scenario), "--out", "out", "--workers", "0", "--methods", *names) == 1
    apart, *together = (load_results(here / "out").query(f"method == '{name}'") for name in names)
    for name, rows in zip(batches, together, strict=True):
        assert list(rows["status"]) == ["failed" if seed == 1 else "no_data" for seed in rows["seed"]]
        assert list(rows["message"]) == list(apart["message"])
        assert (here / name).read_text() == "3 "


@pytest.mark.slow
@pytest.mark.usefixtures("no_views")
def test_a_batch_goes_on_with_the_draws_that_are_left(here, finished):
    (here / "failing.py").write_text(BATCHES, encoding="utf-8")
    command = ["run", str(finished.scenario), "--out", "out", "--workers", "0", "--methods", "failing:Together"]
    assert ended(*command) == 1
    rows = load_results(here / "out")
    assert list(rows["message"]) == ["3 at once"] * 3
    shutil.rmtree(here / "out" / "estimates" / rows["key"][0])
    shutil.rmtree(here / "out" / "estimates" / rows["key"][2])
    assert ended(*command) == 1
    assert list(load_results(here / "out")["message"]) == ["2 at once", "3 at once", "2 at once"]


@pytest.mark.parametrize("command", ["run", "estimate"])
def test_a_missing_extra_is_said_before_any_trial(tmp_path, monkeypatch, capsys, command):
    monkeypatch.delattr(sysid, "SystemTrajectory", raising=False)
    monkeypatch.setattr(study, "experiments_of", pytest.fail)
    words = {"run": ["blocks", "--out", str(tmp_path / "out")], "estimate": [str(tmp_path)]}[command]
    assert "pip install 'heft-testbed[sysid]'" in refusal(capsys, command, *words, "--methods", "mujoco_sysid")
    assert not (tmp_path / "out").exists()


def test_an_error_is_placed_in_the_class_of_others_or_passed_on(as_user):
    as_user(failing=METHODS)
    kind: Any = load_class("failing:Fails", ESTIMATOR, "methods")
    with (
        pytest.raises(HeftError, match=r"^run\(\) ends in LinAlgError: .*failing.py, line 8"),
        placed_errors(kind, "run()"),
    ):
        kind().estimate(None, None, [], 0)
    with pytest.raises(InvalidValueError), placed_errors(kind, unless=(InvalidValueError,)):
        parse_support("air")


@pytest.mark.slow
def test_a_texts_brackets_are_printed_as_they_stand(here, finished, capsys):
    """Square brackets are rich's markup, also in a file's, a folder's or a method's name."""
    out, scenario = Path("[") / "oops]", Path("[bold]small.toml")
    scenario.write_text(
        finished.scenario.read_text("utf-8") + '[methods."[red]"]\nmethod = "failing:Markup"\n', "utf-8"
    )
    shutil.copytree(here / "out", out)
    assert ended("run", str(scenario), "--out", str(out), "--workers", "0", "--methods", "[red]") == 1
    said = capsys.readouterr().out
    assert " [red] " in said and f"[red]: 3 failed (pair; own weight, ideal; own weight, ft300s): {FAILED}" in said
    for words in (["status"], ["run", str(scenario), "--dry-run", "--out"]):
        main([*words, str(out)])
        assert "[/oops]" in capsys.readouterr().out
    assert not re.findall(
        r"\bConsole\(", "".join(path.read_text("utf-8") for path in CLI.rglob("*.py") if path != TERMINAL)
    )
