"""heft import and heft estimate: another bench's logs become trials, and every method answers from them."""

import json
import re
import shutil
import tomllib
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose

from estimators.hidden_states.estimator import HiddenStates
from estimators.particles.misfit import UNEXPLAINED
from scenarios.results.estimates import load_estimate, load_results, load_trajectories
from scenarios.results.store import Store
from scenarios.study.run import EstimateRequest
from scenarios.views.answers import answers_of
from scenarios.views.next_step import next_step
from scenarios.views.values import estimate_view, trial_view
from testbed import ReplayRunner, Rotate, SimulationRunner, Slide, Trajectory, Trial, load_object
from testbed.importers.importer import import_trajectory
from testbed.sensing.compensation import compensate
from testbed.simulation.settings import GripSettings, SimulationSettings
from tests.fakes.lab_bench import mapping_of, tared_again, write_csv, write_toml
from tests.helpers.commands import ended, refusal
from tests.helpers.simulated import put_trial

pytestmark = pytest.mark.slow

PIVOTS = {0: (0.008, -0.07), 2: (-0.033, 0.025), 4: (-0.05, 0.07), 3: (-0.02, 0.0)}
TURNS = [Rotate(grasp, duration=2.0, pivot=pivot, back=True) for grasp, pivot in PIVOTS.items()]
NAMED = [{"file": f"{i}.csv", "action": turn.to_dict()} for i, turn in enumerate(TURNS)]
L2 = load_object("L2")


@pytest.fixture(scope="module")
def records() -> list[Trajectory]:
    bench = SimulationRunner(SimulationSettings(timestep=0.002, grip=GripSettings(mode="weld")))
    return [compensate(bench.run_clean(Trial(L2, turn))) for turn in TURNS]


@pytest.fixture(scope="module")
def made(records: list[Trajectory], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folders with a log of each turn and lab.toml, which names them; in two of these they are imported into `lab`."""
    root = tmp_path_factory.mktemp("made")
    (logs := root / "logs").mkdir()
    for i, record in enumerate(records):
        write_csv(logs / f"{i}.csv", replace(record, time_s=record.time_s + 100 * i))
    write_toml(logs / "lab.toml", mapping_of(records[0], action=None, logs=NAMED))
    for name, more in (("unweighed", ()), ("weighed", ("--weight", "1.8"))):
        shutil.copytree(logs, root / name)
        with pytest.MonkeyPatch.context() as patch:
            patch.chdir(root / name)
            assert ended("import", "lab.toml", "--out", "lab", *more) == 0
    return root


def copied(name: str) -> Any:
    """Fixture that makes a copy of one of those folders the current folder."""

    @pytest.fixture
    def folder(made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
        monkeypatch.chdir(tmp_path)
        return shutil.copytree(made / name, tmp_path, dirs_exist_ok=True)

    return folder


lab, unweighed, weighed = copied("logs"), copied("unweighed"), copied("weighed")


def test_logs_become_trials_that_play_again(lab: Path, capsys: pytest.CaptureFixture[str]):
    assert ended("import", "lab.toml", "--out", "lab", "--weight", "1.8") == 0
    said = capsys.readouterr().out
    assert "ok      1.csv: L2: rotate (grasp 2, " in said
    assert "drift: assumed, for want of a second tare" in said
    assert "4 trials of L2 in lab, all usable; next: heft estimate lab" in said
    for i, turn in enumerate(TURNS):
        with ReplayRunner(lab / "lab") as bench:
            played = bench.run(Trial(L2, turn))
        asked = import_trajectory(lab / f"{i}.csv", lab / "lab.toml")
        assert_allclose(played.wrench_on_object_world, asked.wrench_on_object_world)
        assert played.provenance == asked.provenance | {"imported": played.provenance["imported"]}
    before = sorted(key for key, _ in load_trajectories(lab / "lab"))
    assert len(before) == 5
    assert ended("import", "lab.toml", "--out", "lab", "--weight", "1.8") == 0
    assert sorted(key for key, _ in load_trajectories(lab / "lab")) == before


def test_trials_that_turn_elsewhere_than_stated_are_an_exit_code(
    lab: Path, records: list[Trajectory], capsys: pytest.CaptureFixture[str]
):
    """Positions in another unit: every center is far off, or the whole hand."""
    for part, code in ((30, 1), (1000, 2)):
        for i, record in enumerate(records):
            write_csv(lab / f"{i}.csv", replace(record, tcp_position=part * record.tcp_position))
        assert ended("import", "lab.toml", "--out", "lab") == code
        said = capsys.readouterr()
        assert (said.out.count("wrong   ") >= 2) == (code == 1) and "usable" not in said.out
        assert "next: correct lab.toml, its units and signs too, and import again" in said.out or code == 2
        assert "is position_unit another?" in said.err or code == 1


def test_pose_and_wrench_may_be_files_of_their_own(
    lab: Path, records: list[Trajectory], capsys: pytest.CaptureFixture[str]
):
    whole, wrench = pd.read_csv("0.csv", dtype=str), ["stamp", *(f"{a}{b}" for a in "ft" for b in "xyz")]
    whole[wrench].to_csv("ft.csv", index=False)
    whole.drop(columns=wrench[1:]).to_csv("pose.csv", index=False)
    named = [{"file": "pose.csv", "sensor_file": "ft.csv"}]
    write_toml(lab / "apart.toml", mapping_of(records[0], logs=named))
    assert ended("import", "apart.toml", "pose.csv", "--out", "lab") == 0
    assert "delay of the wrench: not estimated, for want of an accelerated turn" in capsys.readouterr().out
    ((_, apart),) = load_trajectories("lab")
    together = import_trajectory(Path("0.csv"), Path("lab.toml"))
    assert_allclose(apart.wrench_on_object_world, together.wrench_on_object_world, atol=1e-12)
    whole[wrench].assign(fx="1" + whole["fx"].str.lstrip("-")).to_csv("ft.csv", index=False)
    assert ended("import", "apart.toml", "pose.csv", "--out", "lab") == 1  # the force has another sign
    assert len(list(load_trajectories("lab"))) == 2  # another record of the sensor is another log


def test_errors_of_all_logs_are_reported_at_once_and_nothing_is_written(lab: Path, capsys: pytest.CaptureFixture[str]):
    table = (lab / "0.csv").read_text(encoding="utf-8")
    (lab / "0.csv").write_text(table.replace("fx,fy", "fx,f_y", 1), encoding="utf-8")
    (lab / "2.csv").write_text("\n".join(table.splitlines()[:40]), encoding="utf-8")
    assert ended("import", "lab.toml", "--out", "lab") == 2
    lines = capsys.readouterr().err.removeprefix("heft: ").splitlines()
    assert len(lines) == 2
    assert lines[0].startswith("0.csv: sensor.force, sensor.torque: got 'fy'; allowed: one of stamp, fx, f_y")
    assert lines[1].startswith("2.csv: log: its columns have 0.38 s in common; allowed: 0.5 s or more")
    assert not (lab / "lab").exists()


def test_a_recording_that_is_copied_is_no_second_trial(lab: Path, capsys: pytest.CaptureFixture[str]):
    shutil.copy(lab / "0.csv", lab / "copy.csv")
    twice = [*NAMED, {"file": "copy.csv", "action": NAMED[0]["action"]}]
    write_toml(lab / "twice.toml", tomllib.loads((lab / "lab.toml").read_text(encoding="utf-8")) | {"logs": twice})
    assert "LOG: got 'copy.csv'; allowed: each recording once: 0.csv is the same" in refusal(
        capsys, "import", "twice.toml", "--out", "other"
    )
    assert not (lab / "other").exists()


def test_an_estimate_is_not_advised_where_no_trial_is_data(
    lab: Path, records: list[Trajectory], capsys: pytest.CaptureFixture[str]
):
    for i, record in enumerate(records):
        write_csv(lab / f"{i}.csv", tared_again(record, 0.5))
    assert ended("import", "lab.toml", "--out", "drifted", "--weight", "1.8") == 1
    assert "4 of them not usable; next: see the messages about the trials above" in capsys.readouterr().out


def test_doctor_names_a_wrong_axis_before_any_cause(
    lab: Path, records: list[Trajectory], capsys: pytest.CaptureFixture[str]
):
    for i in range(len(records)):
        table = pd.read_csv(lab / f"{i}.csv")
        table["tz"] *= -1
        table.to_csv(lab / f"{i}.csv", index=False)
    assert ended("import", "lab.toml", "--out", "axes", "--weight", "1.8") == 1
    assert ended("estimate", "axes", "--methods", "hidden_states", "--workers", "0") == 0
    capsys.readouterr()
    assert ended("doctor", "axes") == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "the trials are not what their actions say; " in said and "friction would have to push" in said
    assert "odds of being larger" not in said


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("import", "none.toml", "0.csv"), "none.toml: cannot be read: No such file"),
        (("import", "lab.toml", "--grasps", "A3"), "--grasps: got ['A3']; allowed: only with --find"),
        (("import", "lab.toml", "9.csv"), "log: got '9.csv'; allowed: an existing file (.csv, "),
        (("import", "lab.toml", "--weight", "-1"), "--weight: got -1.0; allowed: "),
        (("import", "lab.toml", "--weight", "1800"), "--weight: got 1800.0; allowed: a number > 0 and < 100, kg"),
        (("import", "lab.toml", "--support", "soft"), 'support: got \'soft\'; allowed: "own_weight", "rigid"'),
        (("estimate", "none"), "DIR: got 'none'; allowed: a results folder, with trials in it"),
        (("estimate", "lab"), "a folder in which L2 was weighed: heft robot trial --action weigh --weight KG, or heft"),
        (("estimate", "lab", "--objects", "F2"), "--objects: got 'F2'; allowed: objects of lab: L2"),
        (("estimate", "lab", "--methods", "hiden"), "--methods: got 'hiden'; allowed: some of the scenario's hidden_s"),
        (("estimate", "lab", "--scenario", "fine.toml"), "grid.particles: got 5; allowed: 3: measured trials hold"),
        (("estimate", "lab", "--held-out", "-1"), "--held-out: got -1; allowed: an integer >= 0"),
    ],
)
def test_bad_input_is_one_clear_line(
    unweighed: Path, capsys: pytest.CaptureFixture[str], words: tuple[str, ...], said: str
):
    (unweighed / "fine.toml").write_text('objects = ["L2"]\ngrid = { particles = 5 }\n[methods.hidden_states]\n')
    assert said in refusal(capsys, *words)


def test_every_method_answers_from_what_was_measured(
    weighed: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    """Equal to a direct call: nothing is drawn, and the truth is only compared."""
    asked = ("estimate", "lab", "--methods", "hidden_states", "random_search_M", "--held-out", "1", "--workers", "0")
    assert ended(*asked) == 0
    said = capsys.readouterr().out
    assert "own weight, as measured" in " ".join(said.split())
    (written, _), printed = json.loads(Path("lab/masses.json").read_text(encoding="utf-8")), said.splitlines()
    rows = load_results("lab").to_dict("records")
    assert [row["method"] for row in rows] == ["hidden_states", "random_search_M"]
    trials = [import_trajectory(weighed / f"{i}.csv", weighed / "lab.toml") for i in (0, 1, 2)]
    answer = HiddenStates().estimate(L2.shape, 1.8, trials, seed=0)
    assert answer.distribution is not None
    assert_allclose(rows[0]["mass_kg"], answer.distribution.mass * L2.shape.particles_per_group, rtol=1e-9)
    blocks = [written["quantities"][name] for name in L2.shape.group_names]
    assert_allclose([block["value"] for block in blocks], rows[0]["mass_kg"], rtol=1e-9)
    half = [(block["high"] - block["low"]) / 2 for block in blocks]
    assert_allclose(half, 1.645 * np.array(rows[0]["mass_error_kg"]), rtol=1e-9)
    a1 = written["quantities"]["A1"]
    assert f"A1 {a1['value']:.3f} [{a1['low']:.3f} {a1['high']:.3f}]" in " ".join(" ".join(printed).split())
    assert_allclose([written["quantities"]["total"][end] for end in ("value", "low")], 1.8, atol=0.01)
    assert written["support_verdict"] == "assumed"
    assert re.search(rf"^██A4██ *\n{written['quantities']['A4']['value']:.3f}█", said, re.MULTILINE)  # the map
    (group,) = answers_of(Path("lab"), rows)
    bad = replace(load_estimate("lab", rows[0]["key"]), diagnostics={"misfit": 9.0})
    monkeypatch.setattr("scenarios.views.next_step.load_estimate", lambda *_: bad)
    assert "next: the masses do not explain the trials: heft doctor lab" in next_step(Path("lab"), rows, group[0])
    monkeypatch.setattr("scenarios.views.next_step.wrong_motion", lambda *_: ["the pads close 90 deg off"])
    assert next_step(Path("lab"), rows, group[0]).endswith("not what their actions say: the pads close 90 deg off")
    assert re.search(
        r"^next: ((nothing more is needed|turn|accelerate).*)?the expected error of the masses, taken together, is",
        said,
        re.MULTILINE,
    )
    assert len(pd.read_csv("lab/masses.csv")) == 2 * (6 + 3)
    assert rows[0]["nad"] < 0.1
    assert rows[0]["mpd_turn_m"] < 0.01
    assert len(rows[0]["trial_keys"]) == 4 and len(rows[0]["held_out_keys"]) == 1
    assert ended("status", "lab") == 0
    assert re.search(r"estimates: 2 done( \([^)]*\))?, 0 failed", capsys.readouterr().out)
    assert "heft estimate lab --methods hidden_states random_search_M --held-out 1" in (
        weighed / "lab/report.html"
    ).read_text(encoding="utf-8")


def test_no_method_is_ok_with_masses_that_do_not_explain_the_trials(weighed: Path, capsys: pytest.CaptureFixture[str]):
    """A method of another package that always answers ok, with uniform mass and no misfit, among them."""
    (weighed / "uniform_mass.py").write_text(
        "import numpy as np\nfrom estimators import Estimate\nfrom testbed import MassDistribution\n\n\n"
        "class Uniform:\n    def estimate(self, shape, weight, trajectories, seed):\n"
        "        mass = np.full(shape.n_m, weight / len(shape.particles))\n"
        '        return Estimate(MassDistribution(mass, np.full(shape.n_mu, 0.5)), "ok")\n',
        encoding="utf-8",
    )
    asked = ("hidden_states", "random_search_M", "explicit_state_M", "uniform_mass:Uniform")
    assert ended("estimate", "lab", "--methods", *asked, "--workers", "0") == 0
    said = capsys.readouterr().out
    rows = {row["method"]: row for row in load_results("lab").to_dict("records")}
    assert [rows[method]["status"] for method in asked] == ["ok", *["unexplained"] * 3]
    assert [rows[method]["misfit"] > UNEXPLAINED for method in asked] == [False, True, True, True]
    assert all(np.isfinite(rows[method]["nad"]) for method in asked)
    for method in asked[1:]:
        assert f"L2, own_weight, {method}: unexplained: the masses do not explain the trials: misfit" in said
    written = json.loads(Path("lab/masses.json").read_text(encoding="utf-8"))
    assert [entry["status"] for entry in written] == ["ok", *["unexplained"] * 3]


def test_a_method_that_fails_leaves_the_others_their_answers(weighed: Path, capsys: pytest.CaptureFixture[str]):
    (weighed / "broken.py").write_text(
        "class Broken:\n    def estimate(self, *asked):\n        raise RuntimeError('boom')\n", encoding="utf-8"
    )
    assert ended("estimate", "lab", "--methods", "broken:Broken", "hidden_states", "--workers", "0") == 1
    said = capsys.readouterr().out
    assert "L2 by hidden_states: mass of each block" in said
    assert "L2, own_weight, broken:Broken: failed: RuntimeError: boom (broken.py, line 3)" in said
    assert {entry["method"] for entry in json.loads(Path("lab/masses.json").read_text(encoding="utf-8"))} == {
        "hidden_states"
    }


def test_measured_trials_and_their_estimates_are_shown_as_simulated_ones_are(lab: Path, records: list[Trajectory]):
    """For an object of one's own, of a log without joints too."""
    blocks = 'layout = ["1", "1", "1", "111"]\nmass_kg = [0.4, 0.1, 0.1, 0.4, 0.4, 0.4]'
    (lab / "mine.toml").write_text(f'name = "mine"\n[blocks]\n{blocks}\n', encoding="utf-8")
    write_toml(lab / "lab.toml", mapping_of(records[0], object="mine.toml", action=None, logs=NAMED, joints=None))
    assert ended("import", "lab.toml", "--out", "lab", "--weight", "1.8") == 0
    assert ended("estimate", "lab", "--methods", "hidden_states", "--workers", "2") == 0
    row = load_results("lab").iloc[0]
    assert (lab / "lab/report.html").read_text(encoding="utf-8").count("<svg") == 6  # with three maps
    assert "its joints were not logged" in trial_view(lab / "lab", row["trial_keys"][1]).facts["arm"]
    for what in ("mine", row["key"], row["trial_keys"][1]):
        assert ended("view", "lab", what, "--record") == 0
    assert ended("view", "lab", row["key"], "--figures") == 0
    assert len(list((lab / "lab/recordings").glob("*.rrd"))) == 3


def test_an_unusable_trial_is_reported_and_left_out(
    weighed: Path, records: list[Trajectory], capsys: pytest.CaptureFixture[str]
):
    store, bad = Store(weighed / "lab"), replace(records[2], status="slipped", reason="it slid", provenance={})
    path = next(p for p in store.root.glob("trials/*/trial.json") if '"2.csv"' in p.read_text(encoding="utf-8"))
    store.put_trial(path.parent.name, Trial(L2, TURNS[2]), json.loads(path.read_text("utf-8"))["asked"], bad)
    assert ended("estimate", "lab", "--methods", "hidden_states", "--workers", "0") == 0
    assert f"trial {path.parent.name[:8]} of L2 is left out: slipped: it slid" in capsys.readouterr().out
    assert path.parent.name not in load_results("lab")["trial_keys"][0]


def test_masses_need_not_be_invented(lab: Path, records: list[Trajectory], capsys: pytest.CaptureFixture[str]):
    """No NAD and no truth then, and the same masses."""
    (lab / "mine.toml").write_text('name = "mine"\n[blocks]\nlayout = ["1", "1", "1", "111"]\n', encoding="utf-8")
    write_toml(lab / "lab.toml", mapping_of(records[0], object="mine.toml", action=None, logs=NAMED))
    assert ended("import", "lab.toml", "--out", "lab", "--weight", "1.8") == 0
    assert ended("estimate", "lab", "--methods", "hidden_states", "--held-out", "1", "--workers", "0") == 0
    said = capsys.readouterr().out
    assert "mine, own weight: masses in kg" in said
    assert "NAD" not in said
    (row,) = load_results("lab").to_dict("records")
    assert pd.isna(row["nad"]) and row["true_mass_kg"] is None and row["mpd_turn_m"] < 0.01
    trials = [import_trajectory(lab / f"{i}.csv", lab / "lab.toml") for i in (0, 1, 2)]
    answer = HiddenStates().estimate(L2.shape, 1.8, trials, seed=0)
    assert answer.distribution is not None
    assert_allclose(row["mass_kg"], answer.distribution.mass * L2.shape.particles_per_group, rtol=1e-9)
    view = estimate_view(lab / "lab", row)
    assert view.truth is None and view.nad is None
    page = (lab / "lab/report.html").read_text(encoding="utf-8")
    assert page.index("masses in kg, center in mm") < page.index("half of each 90 % interval")
    assert 'id="tables"' not in page and "NAD" not in page
    assert ended("view", "lab", "--figures") == 0
    assert not list((lab / "lab").glob("figures/*"))  # NAD and differences have no truth
    assert ended("show", "mine.toml") == 0
    assert "masses not given" in capsys.readouterr().out
    for command in (("run", "blocks", "--objects", "mine.toml"), ("plan", "mine.toml")):
        assert "mass_kg: got None; allowed: masses: only what a real robot measures" in refusal(capsys, *command)


def test_the_support_is_tested_by_default():
    assert list(EstimateRequest().chosen().methods)[:2] == ["support_aware", "hidden_states"]
    assert "support_aware" not in EstimateRequest(scenario="noise").chosen().methods
    assert list(EstimateRequest(methods=("random_search",)).chosen().methods) == ["random_search"]


def test_simulated_trials_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    put_trial(tmp_path, "L2", Slide(1, duration=1.5))
    assert "is simulated: heft run asks about these" in refusal(capsys, "estimate", str(tmp_path))


def test_trials_of_two_shapes_are_not_put_together(
    weighed: Path, records: list[Trajectory], capsys: pytest.CaptureFixture[str]
):
    text = 'name = "L2"\n[blocks]\nlayout = ["1", "1", "1", "111"]\nmass_kg = 0.3\nheight_m = {}\nsize_m = {}\n'
    # other masses are another truth; another size is another object, whose grasps lie elsewhere
    for size, wrong, code in ((0.05, 0, 0), (0.06, 1, 2)):
        (weighed / "mine.toml").write_text(text.format(0.03, size), encoding="utf-8")
        write_toml(weighed / "second.toml", mapping_of(records[0], action=TURNS[3].to_dict(), object="mine.toml"))
        assert ended("import", "second.toml", "3.csv", "--out", "lab") == wrong
        assert ended("estimate", "lab", "--methods", "hidden_states", "--workers", "0") == code
    assert "allowed: trials of one shape; " in capsys.readouterr().err
    assert_allclose(load_results("lab")["true_mass_kg"][0], 0.3)
