"""Estimators of other packages: found without registration, checked in the user's words, run on worker processes."""

from __future__ import annotations

import sys
from importlib.metadata import EntryPoint, EntryPoints
from pathlib import Path

import pytest

from estimators.registry import ESTIMATOR, METHODS, build_method
from scenarios.cli.main import main
from scenarios.cli.run import Asked, changed
from scenarios.config import Scenario, load_scenario
from scenarios.results.load import load_results
from testbed import plugins
from testbed.errors import InvalidValueError
from testbed.objects.files import InvalidFileError
from testbed.plugins import configured, load_class, source_hash

MODULE = '''
from dataclasses import dataclass
import numpy as np
from estimators.base import Estimate
from testbed.objects.model import MassDistribution

@dataclass(frozen=True)
class Even:
    """The same mass everywhere."""
    friction: float = 0.5
    times: tuple = (1.0,)
    def __post_init__(self):
        if not 0 < self.friction < 2:
            raise ValueError("friction is not from 0 to 2")
    def estimate(self, shape, weight, trajectories, seed):
        mass = np.full(shape.n_m, weight / len(shape.particles))
        return Estimate(MassDistribution(mass, np.full(shape.n_mu, self.friction)), "ok", seconds=1e-3)

class Needy:
    def __init__(self, path):
        self.path = path
    def estimate(self, shape, weight, trajectories, seed):
        raise NotImplementedError

class Deaf:
    def estimate(self, data):
        return data

class Mute:
    pass

def function(shape):
    return shape
'''


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """Where a user keeps modules."""
    path = tmp_path_factory.mktemp("user")
    (path / "of_a_user.py").write_text(MODULE, encoding="utf-8")
    (path / "half_done.py").write_text("import no_such_thing\n", encoding="utf-8")
    (path / "wrong_words.py").write_text("def f(:\n", encoding="utf-8")
    return path


@pytest.fixture
def here(folder, monkeypatch) -> Path:
    """The user's folder as the current one; what is found there is forgotten again."""
    monkeypatch.chdir(folder)
    monkeypatch.setattr("sys.path", [p for p in sys.path if p not in ("", str(folder))])
    return folder


@pytest.mark.usefixtures("here")
def test_a_class_of_the_current_folder_is_a_method_with_its_settings():
    scenario = Scenario(
        objects=["I1"], methods={"mine": {"method": "of_a_user:Even", "friction": 0.3, "times": [1, 2]}}
    )
    mine = build_method("mine", scenario.methods["mine"])
    assert (mine.friction, mine.times) == (0.3, (1, 2))  # pyright: ignore[reportAttributeAccessIssue]
    asked = changed(scenario, Asked(methods=("mine", "of_a_user:Even", "random_search")))
    assert asked.methods == {**scenario.methods, "of_a_user:Even": {}, "random_search": {}}


@pytest.mark.usefixtures("here")
@pytest.mark.parametrize(
    ("path", "message"),
    [
        ("of_a_user", r"one of hidden_states.*package:Class"),
        ("of_a_user:", r'got \'of_a_user:\'; allowed: "package.module:Class"'),
        ("my user:Even", r'"package.module:Class"'),
        ("of_a_usr:Even", r"a module that is installed or lies in .*; there is no of_a_usr"),
        ("of_a_user.deeper:Even", r"there is no of_a_user\.deeper"),
        ("half_done:Even", r"half_done needs no_such_thing, which is not installed"),
        ("wrong_words:Even", r"wrong_words ends in SyntaxError"),
        ("of_a_user:Evne", r"a class of of_a_user: Even, Needy, Deaf, Mute \(nearest: Even\)"),
        ("of_a_user:Mute", r"a class with estimate\(.*; Mute has no estimate"),
        ("of_a_user:Deaf", r"Deaf has estimate\(self, data\)"),
        ("of_a_user:function", r"this is a function"),
        ("estimators.baselines.base:Baseline", r"Baseline is abstract"),
    ],
)
def test_what_is_no_estimator_is_refused_in_a_scenario_and_on_the_command_line(path, message, tmp_path):
    file = tmp_path / "s.toml"
    file.write_text(f'objects = ["I1"]\n[methods.mine]\nmethod = "{path}"\n', encoding="utf-8")
    with pytest.raises(InvalidFileError, match=message):
        load_scenario(str(file))
    if ":" in path:
        with pytest.raises(InvalidValueError, match=message):
            changed(Scenario(objects=["I1"]), Asked(methods=(path,)))


@pytest.mark.usefixtures("here")
@pytest.mark.parametrize(
    ("name", "settings", "message"),
    [
        (
            "Even",
            {"fricton": 0.3},
            r"mine: got 'fricton'; allowed: settings friction, times \(nearest: friction\)",
        ),
        ("Even", {"friction": 3.0}, r"friction is not from 0 to 2"),
        ("Even", {"friction": {}}, r"values of the settings' types"),
        ("Needy", {}, r"settings path as well"),
    ],
)
def test_a_wrong_setting_is_refused(name, settings, message):
    with pytest.raises(InvalidValueError, match=message):
        configured(load_class(f"of_a_user:{name}", ESTIMATOR, "mine"), settings, "mine")


@pytest.mark.usefixtures("here")
def test_an_entry_point_is_a_method_by_name(monkeypatch):
    points = EntryPoints([EntryPoint("even", "of_a_user:Even", ESTIMATOR.group)])
    monkeypatch.setattr(plugins, "entry_points", lambda *, group: points.select(group=group))
    assert type(build_method("even", {"friction": 0.2})).__name__ == "Even"
    assert changed(Scenario(objects=["I1"]), Asked(methods=("even",))).methods == {"even": {}}
    with pytest.raises(InvalidValueError, match=r", even \(nearest: even\)"):
        build_method("evn", {})


def test_an_answer_is_kept_under_the_source_that_gave_it(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(str(tmp_path))
    kinds = []
    for name, text in (("one_source", MODULE), ("other_source", MODULE), ("third_source", MODULE + "# more\n")):
        (tmp_path / f"{name}.py").write_text(text, encoding="utf-8")
        kinds.append(load_class(f"{name}:Even", ESTIMATOR, "x"))
    first, same, other = map(source_hash, kinds)
    assert first == same != other


def test_every_method_of_heft_is_what_others_must_be():
    for name, kind in METHODS.items():
        assert load_class(f"{kind.__module__}:{kind.__name__}", ESTIMATOR, name) is kind
        assert configured(kind, {}, name) == kind()


@pytest.mark.slow
def test_a_worker_process_finds_a_class_of_the_current_folder(here, capsys):
    (here / "s.toml").write_text(
        'objects = ["I1"]\n[policy]\npivots = 1\nduration = 2.0\naccelerated = 1\nheld_out = 0\n'
        '[methods.mine]\nmethod = "of_a_user:Even"\n',
        encoding="utf-8",
    )
    main(["run", "s.toml", "--out", "out", "--workers", "1", "--methods", "mine", "of_a_user:Even"])
    rows = load_results(here / "out").to_dict("records")
    assert [row["method"] for row in rows] == ["mine", "of_a_user:Even"]
    for row in rows:
        assert (row["status"], row["kind"]) == ("ok", "of_a_user:Even")
        assert row["nad"] < 1e-3
    assert "recording: out" in capsys.readouterr().out
