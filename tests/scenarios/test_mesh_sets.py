"""Scenarios on a folder of meshes, and on objects that are pushed."""

from pathlib import Path

import numpy as np
import pytest
import trimesh
from numpy.testing import assert_allclose
from rich.console import Console

from estimators.action_selection.greedy import PlannedPolicy
from scenarios.catalog import LIBRARY
from scenarios.cli.main import main
from scenarios.config import Meshes, Scenario, load_scenario
from scenarios.policies import AfterWeighing, Policy
from scenarios.results.estimates import load_results
from scenarios.results.store import Store
from scenarios.study.dry_run import show_dry_run
from scenarios.study.experiment import experiments_of
from scenarios.study.meshes import stated_inertia, with_meshes
from scenarios.study.run import _includes
from testbed import HeftError, InfeasibleTrialError, Push, load_object
from tests.helpers.commands import ended, refusal
from tests.helpers.meshes import box, together
from tests.helpers.runs import quiet

PARTS = ((0.04, 0.10, 0.03), (0.0, 0.0, 0.0), 0.45), ((0.22, 0.03, 0.03), (0.13, 0.0, 0.0), 0.08)
"""Sides and middle of a mallet's head and handle [m], and their masses [kg]."""
SCENARIO = """
support = ["rigid"]
[meshes]
mass_kg = 0.1                  # of a mesh without notes
[policy]
pivots = 2
duration = 4.0
accelerated = 1
held_out = 0
[methods.support_aware]
"""


@pytest.fixture
def data(tmp_path: Path) -> Path:
    """A set of one mallet, in millimeters as the public one, beside what its notes say."""
    boxes, sums, about = [], np.zeros(4), np.zeros((3, 3))
    for place, (size, middle, mass) in enumerate(PARTS):
        boxes.append(box(size, middle, [[200, 30, 30, 255], [90, 90, 90, 255]][place]))
        sides, at = np.array(size), np.array(middle)
        sums += mass * np.array([1, *at])
        about += mass * (np.diag((sides**2).sum() - sides**2) / 12 + at @ at * np.eye(3) - np.outer(at, at))
    total, center = sums[0], sums[1:] / sums[0]
    about -= total * (center @ center * np.eye(3) - np.outer(center, center))
    folder = tmp_path / "set" / "Mallet"
    folder.mkdir(parents=True)
    together(*boxes).apply_scale(1e3).export(folder / "mesh.ply")
    notes = f"OBJECT:\n  MASS: {total}\n  COM_WRT_MESH: {center.tolist()}\n  INERTIA_WRT_COM: {about.tolist()}\n"
    (folder / "Inertia.yaml").write_text(notes, encoding="utf-8")
    return tmp_path / "set"


def test_parts_have_the_masses_that_make_the_whole(data: Path, tmp_path: Path):
    scenario = Scenario(meshes=Meshes(sha256={"Mallet": "00"}))
    made, (line,) = with_meshes(scenario, data, tmp_path / "out", quiet)
    assert "another file than" in line
    (path,) = made.objects
    model = load_object(path)
    assert model.name == "Mallet"
    assert_allclose(sorted(model.group_mass), sorted(mass for *_, mass in PARTS), rtol=1e-6)
    before = Path(path).stat().st_mtime_ns
    again, _ = with_meshes(scenario, data, tmp_path / "out", quiet)
    assert again.objects == [path] and Path(path).stat().st_mtime_ns == before


@pytest.mark.parametrize("written", ["0.5", ".5", "+5.E-1"])
def test_a_stated_number_needs_no_leading_zero(written: str):
    notes = f"MASS: {written}\nCOM_WRT_MESH: [0, -.1, 0.]\nINERTIA_WRT_COM: [[1, 0, 0], [0, 1, 0], [0, 0, 1]]"
    found = stated_inertia(notes, Path("Inertia.yaml"))
    assert found.mass == 0.5 and found.center_of_mass.tolist() == [0.0, -0.1, 0.0]


def test_a_dry_run_on_meshes_writes_nothing(data: Path, monkeypatch: pytest.MonkeyPatch, capsys):
    monkeypatch.chdir(data.parent)
    before = sorted(Path().rglob("*"))
    main(["run", "tools", "--data", "set", "--out", "out", "--workers", "0", "--dry-run"])
    said = " ".join(capsys.readouterr().out.split())
    assert "Mallet: out/objects/" in said and "1 object(s)" in said
    assert sorted(Path().rglob("*")) == before


@pytest.mark.parametrize(
    ("words", "told"),
    [
        ((), "--data: got None; allowed: a folder with files */mesh.ply: a copy of github.com/utiasSTARS"),
        (("--data", "nowhere"), "--data: got 'nowhere'; allowed: a folder with files */mesh.ply"),
        (("--data", "set", "--objects", "Malet"), "objects: got ['Malet']; allowed: some of Mallet (nearest: Mallet)"),
    ],
)
def test_what_is_not_such_a_folder_is_refused(data, monkeypatch, capsys, words, told):
    monkeypatch.chdir(data.parent)
    assert told in refusal(capsys, "run", "tools", *words)
    assert not Path("results").exists()


def test_data_are_refused_where_a_scenario_has_no_meshes(data: Path, tmp_path: Path):
    with pytest.raises(HeftError, match="the objects of this scenario need no data"):
        with_meshes(load_scenario("blocks")[1], data, tmp_path, quiet)
    (data / "Mallet" / "Inertia.yaml").write_text("MASS: 0.5\n", encoding="utf-8")
    with pytest.raises(HeftError, match="INERTIA_WRT_COM: got '0 numbers'"):
        with_meshes(load_scenario("tools")[1], data, tmp_path, quiet)
    (data / "Mallet" / "Inertia.yaml").unlink()
    with pytest.raises(HeftError, match=r"a mass in \[meshes\], or a file Inertia.yaml beside"):
        with_meshes(load_scenario("tools")[1], data, tmp_path, quiet)


@pytest.mark.slow
def test_a_set_is_estimated_and_what_no_hand_can_grip_is_pushed_where_the_scenario_says_so(
    data: Path, monkeypatch, capsys
):
    """A mallet is turned with and without pushes; a plate of 3 mm beside it is pushed at its edge."""
    monkeypatch.chdir(data.parent)
    (data / "Plate").mkdir()
    trimesh.creation.box((160, 50, 3)).export(data / "Plate" / "mesh.ply")
    for name, pushes in (("gripped", ""), ("pushed", "pushes = 3\n")):
        Path(f"{name}.toml").write_text(SCENARIO.replace("[methods", f"{pushes}[methods"), encoding="utf-8")
        done = ended("run", f"{name}.toml", "--data", "set", "--workers", "0", "--out", name) == 0
        assert done == bool(pushes)  # without pushes not all of it was done
        assert "2 parts by colours" in capsys.readouterr().out
    before, after = (load_results(name).set_index("object") for name in ("gripped", "pushed"))
    assert before.com_error_m["Mallet"] < 1e-3 and abs(before.inertia_error["Mallet"]) < 0.05
    assert before.status["Plate"] == "infeasible"
    assert after.status["Plate"] in ("ok", "underdetermined"), after.message["Plate"]
    assert after.com_error_m["Plate"] < 5e-3 and after.com_error_m["Mallet"] == before.com_error_m["Mallet"]


def test_objects_without_a_grasp_are_pushed(tmp_path):
    _, scenario = load_scenario("push")
    found, left_out = experiments_of(scenario.model_copy(update={"random": []}), Store(tmp_path), quiet)
    assert not left_out and {e.model.name for e in found} == {"rectangle_2x3", "rectangle_3x3"}
    assert {e.world is None for e in found} == {True, False}
    for experiment in found:
        action = experiment.next_action()
        assert not experiment.model.shape.grasps and not experiment.turns and isinstance(action, Push)


@pytest.mark.slow
def test_pushes_are_planned_where_the_policy_plans(tmp_path):
    _, scenario = load_scenario("push")
    policy = Policy(kind="greedy", touches=5, pushes=2, candidates=20)
    planned = scenario.model_copy(update={"random": [], "objects": [*scenario.objects[:1], "L2"], "policy": policy})
    found, _ = experiments_of(planned, Store(tmp_path), quiet)
    by_name = {experiment.model.name: experiment for experiment in found}
    for name, most in (("rectangle_2x3", 2), ("L2", 5)):
        experiment = by_name[name]
        experiment.weighed.append(experiment.model.total_mass)
        assert isinstance(experiment.policy, AfterWeighing) and isinstance(experiment.policy.policy, PlannedPolicy)
        made = experiment.policy.policy
        assert made.family.pushes and made.goal.most == most and bool(experiment.turns) == bool(made.grasps)
    assert isinstance(by_name["rectangle_2x3"].next_action(), Push)


@pytest.mark.parametrize(
    ("name", "changes", "message"),
    [
        ("fold_2", {"policy": Policy(kind="push")}, "an object with hinges is not pushed"),
        ("fold_2", {"policy": Policy(kind="drag"), "support": ["rigid"]}, "links rest on their own weight"),
        ("fold_2", {"policy": Policy()}, 'is for one rigid body.*kind = "drag" or a plan'),
        ("rectangle_2x3", {"policy": Policy()}, 'it can be pushed: kind = "push"'),
    ],
    ids=["links", "rigid links", "turns of links", "no grasp"],
)
def test_what_cannot_be_done_is_said_before_any_trial(tmp_path, name, changes, message):
    _, scenario = load_scenario("push")
    paths = [str(LIBRARY / f"objects/{name}.toml")]
    asked = scenario.model_copy(update={"random": [], "sweep": type(scenario.sweep)(), "objects": paths, **changes})
    with pytest.raises(InfeasibleTrialError, match=message):
        experiments_of(asked, Store(tmp_path), quiet)


def test_a_dry_run_names_what_is_left_out_and_fails_where_all_is(tmp_path, capsys):
    _, blocks = load_scenario("blocks")
    linked = str(LIBRARY / "objects/fold_2.toml")
    console = Console(width=200)
    show_dry_run(console, blocks.replaced(objects=["L2", linked]), tmp_path, 1)
    assert "left out: fold_2: reversed_pairs is for one rigid body" in capsys.readouterr().out
    with pytest.raises(InfeasibleTrialError, match="is for one rigid body"):
        show_dry_run(console, blocks.replaced(objects=[linked]), tmp_path, 1)


def test_results_of_drawn_objects_are_those_of_a_scenario_with_a_newer_field():
    held = [{"name": "drawn", "count": 3, "seed": 1}]
    asked = [held[0] | {"feet_m": None}]
    assert _includes("random", held, asked)
    assert not _includes("random", held, [asked[0] | {"feet_m": [[0.0, 0.0]]}])
