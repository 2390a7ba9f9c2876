"""`heft plan` and `heft touch`: what they print, write and refuse."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from pydantic import ValidationError

from estimators import ActionPolicy, OnlinePolicy, RankDriven
from estimators.action_selection.design import Guess
from estimators.action_selection.greedy import PlannedPolicy, rank_driven_plan
from estimators.action_selection.plan import Goal
from estimators.identifiability.information import SUPPORTS
from scenarios.cli.main import main
from scenarios.cli.plan import plan_view
from scenarios.cli.terminal import percent, seconds
from scenarios.config import Policy, Scenario
from scenarios.policies import AfterWeighing
from scenarios.results.estimates import load_results
from scenarios.results.files import write_json
from scenarios.runners import FeasibilityCheck
from scenarios.study.run import ACTIVE_FIELDS, manifest
from testbed import Accelerate, InvalidValueError, Push, Rotate, SimulationSettings, Slide, load_object, preset
from tests.helpers.chunks import logged, read_chunks
from tests.helpers.commands import refusal
from viz.recordings.plan import plan_page
from viz.values import ActionArrow

L2 = load_object("L2")
GUESS = Guess(L2.total_mass, preset("ft300s"))
SLAB = 'name = "slab"\n[blocks]\nlayout = ["111", "111", "111"]\nmass_kg = [{}]\nfriction = 0.5\n'
COMMANDS = {
    "all of it": (
        "L2 --budget 60s --candidates 300",
        ("L2, own_weight, ft300s: greedy; weighed 1.800 kg", "the budget is spent",
         "all 7 masses and frictions are observed"),
        "plan/actions/scene/1/way",
    ),
    "lifts, where they are possible": (
        "L2 --assumed-support rigid --lifts --most 3 --candidates 300",
        ("lift", "held", "6 of 7 masses and frictions are observed"),
        "plan/actions/scene/3/lift",
    ),
    "too small a budget": (
        "L2 --budget 20s --until 1% --candidates 300",
        ("1 action(s)", "the target of 1 % is not reached", "open:"),
        None,
    ),
    "pushes of an object without a grasp": (
        "slab.toml --until 5% --most 2 --candidates 8",
        ("2 action(s)", "push at", "the target of 5 % is not reached"),
        "plan/actions/scene/1/way",
    ),
}  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize(("words", "parts", "drawn"), COMMANDS.values(), ids=COMMANDS)
def test_a_plan_is_printed_and_drawn(words, parts, drawn, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    Path("slab.toml").write_text(SLAB.format(", ".join(["0.1"] * 9)))
    files = () if drawn is None else ("plan.pdf", "plan.png", "plan.rrd")
    main(["plan", *words.split(), *(("--figure", "plan", "--record", "plan.rrd") if files else ())])
    said = " ".join(capsys.readouterr().out.split())
    assert [part for part in parts if part not in said] == []
    assert {path.name for path in tmp_path.iterdir()} == {"slab.toml", *files}
    assert drawn is None or drawn in read_chunks(tmp_path / "plan.rrd")


@pytest.mark.parametrize(
    ("words", "refused"),
    [
        ("plan L2 --lifts", "--assumed-support: got 'own_weight'; allowed: rigid or either with --lifts"),
        ("plan L2 --seed -1", "--seed: got -1; allowed: an integer >= 0"),
        ("plan L2 --candidates 0", "--candidates: got 0; allowed: an integer >= 1"),
        ("plan L2 --friction 5", "--friction: got 5.0; allowed: 0.01 to 2"),
        ("plan L2 --grasps Z9", "--grasps: got 'Z9'; allowed: grasps of L2: B1"),
        ("plan L2 --record plan.txt", "--record: got 'plan.txt'; allowed: a file that ends in .rrd"),
        (
            "plan L2 --policy reversed_pairs --pushes",
            "--policy: got 'reversed_pairs'; allowed: greedy, batch or random with --lifts or --pushes: it only turns",
        ),
        (
            "plan L2 --policy published --candidates 9",
            "--policy: got 'published'; allowed: greedy, batch or random with",
        ),
        ("plan L2 --policy random --criterion A", "--policy: got 'random'; allowed: greedy or batch with --criterion"),
        ("identify L2 --sensing nose", "sensing: got 'nose'; allowed: one of ideal, ft300s"),
        ("touch L2 --most 0", "--most: got 0; allowed: an integer >= 1"),
        ("identify L2 --pivots -1", "--pivots: got -1; allowed: an integer >= 0"),
        ("payload nothing_here drill", "DIR|FILE.toml: got 'nothing_here'; allowed: a folder with lifts, or a file"),
    ],
)
def test_a_wrong_option_is_refused_by_its_name(words, refused, capsys):
    with pytest.raises(SystemExit, match="2"):
        main(words.split())
    assert refused in capsys.readouterr().err


@pytest.mark.slow
def test_planning_takes_less_than_the_papers_choice_for_the_same():
    grasps, check = tuple(range(len(L2.shape.grasps))), FeasibilityCheck(L2.shape, GUESS)
    paper = rank_driven_plan(L2.shape, GUESS, Goal(most=30), "reversed_pairs", grasps, 0)
    nad = paper.after.expected_nad
    greedy = PlannedPolicy(GUESS, goal=Goal(until=nad, most=20), candidates=1000, feasible=check).plan(L2.shape)
    assert greedy.after.expected_nad <= nad * 1.001 and greedy.seconds < paper.seconds / 2


def test_an_infeasible_action_has_a_reason():
    assert FeasibilityCheck(L2.shape, GUESS)(Rotate(0, duration=4.0, back=True)) == ""
    assert "reach" in FeasibilityCheck(L2.shape, GUESS)(Rotate(0, pivot=(0.6, 0.0), duration=18.0))
    assert "grip" in FeasibilityCheck(L2.shape, replace(GUESS, weight=80.0))(Rotate(0, duration=4.0))


def test_amounts_are_read_as_typed():
    assert (percent("5%", "x"), percent(" 0.5 %", "x"), percent(None, "x")) == (0.05, 0.005, None)
    assert (seconds("60s", "x"), seconds("60", "x"), seconds("2min", "x"), seconds(None, "x")) == (60, 60, 120, None)
    wrong = [(percent, text) for text in ("0%", "150%", "much", "0.05", "5")]
    for read, text in (*wrong, *((seconds, text) for text in ("0s", "-3", "soon"))):
        with pytest.raises(InvalidValueError, match=r"^--option:"):
            read(text, "--option")


@pytest.mark.slow
def test_an_active_run_stops_by_itself_and_is_right(tmp_path, capsys):
    out = tmp_path / "run"
    touch = ["touch", "docs/objects/T.toml", "--until", "5%", "--candidates", "150", "--out", str(out)]
    main(touch)
    said = capsys.readouterr().out
    assert "stopped: the target is met" in said
    row = load_results(out).iloc[0]
    assert row["nad"] < 0.1 and row["object"] == "T" and len(row["trial_keys"]) >= 3
    assert len(list((out / "trials").glob("*/trial.json"))) == len(row["trial_keys"])
    assert (out / "recording.rrd").stat().st_size > 1000
    command = f"heft touch docs/objects/T.toml --candidates 150 --out {out}"  # 5% is the default
    assert command in (out / "report.html").read_text(encoding="utf-8")
    assert f"report: {out / 'report.html'}; results in {out}/" in said
    main(touch)
    assert np.isclose(load_results(out).iloc[0]["nad"], row["nad"])


@pytest.mark.slow
def test_touch_detects_a_rigid_body_and_prints_open_masses(tmp_path, capsys):
    main(["touch", "L2", "--support", "rigid", "--until", "2%", "--candidates", "150", "--out", str(tmp_path / "run")])
    said = " ".join(capsys.readouterr().out.split())
    assert "stopped: no action teaches more" in said
    assert "the target of 2 % is not reached" in said and "assumption_violated" in said


@pytest.mark.slow
def test_after_one_trial_masses_have_wide_errors_and_what_is_open_is_named(tmp_path, capsys):
    main(["touch", "F2", "--most", "1", "--candidates", "300", "--out", str(tmp_path / "run")])
    said = " ".join(capsys.readouterr().out.split())
    assert "stopped: the limit of trials (1) is reached the target of 5 % is not reached" in said
    weight = said.partition("weighed: ")[2].split(" kg")[0]
    assert abs(float(weight) - 1.8) < 0.005
    expected, true = (float(number) for number in re.findall(r"expected NAD ([\d.]+) %, .* truth ([\d.]+) %", said)[0])
    assert true < 2 * expected and expected > 20
    assert "±" in said and "not known: the combination" in said


@pytest.mark.parametrize(("obj", "secret", "other"), [("L2", "of a run", "secret"), ("F2", "touch/0", "objects")])
def test_touch_writes_over_no_other_results(tmp_path, capsys, obj, secret, other):
    (tmp_path / "results.parquet").touch()
    held = Scenario(objects=[obj], sensing=["ft300s"], seeds=1)
    facts = manifest(held, secret) | {"scenario": held.model_dump(include=ACTIVE_FIELDS)}
    write_json(tmp_path / "manifest.json", facts)
    said = refusal(capsys, "touch", "L2", "--out", str(tmp_path))
    assert said.startswith("heft: --out: ") and f"results of another run ({other})" in said


def weighed_policy(policy: Policy) -> ActionPolicy:
    """The policy that is built once the scale has been read; before that it can choose nothing."""
    weighed: list[float] = []
    waits = policy.build((2, 3, 4), L2.shape, SimulationSettings(), weighed)
    assert isinstance(waits, AfterWeighing)
    with pytest.raises(InvalidValueError, match="no weighing"):
        waits.next(L2.shape, [])
    weighed.append(1.801)
    return waits.policy


def test_a_scenario_builds_its_policy():
    ours, published, default = (
        policy.build((0, 1), L2.shape, SimulationSettings())
        for policy in (Policy(kind="reversed_pairs"), Policy(kind="published"), Policy())
    )
    assert ours == default == RankDriven(6, grasps=(0, 1))
    assert published == RankDriven(1, accelerated=3, grasps=(0, 1), back=False, beside=False)
    assert Policy(kind="published", accelerated=4, pivots=2).expected_trials() == 1 + 4 + 2 + 2
    batch = Policy(kind="batch", touches=2, until=0.05, candidates=200)
    chosen = weighed_policy(batch)
    assert isinstance(chosen, PlannedPolicy) and chosen.guess.weight == 1.801 and batch.expected_trials() == 1 + 2 + 2
    actions = chosen.plan(L2.shape).actions
    assert 1 <= len(actions) <= 2 and {a.grasp for a in actions if isinstance(a, Rotate)} <= {2, 3, 4}
    with pytest.raises(ValidationError, match="one of ideal"):
        Policy(kind="greedy", plan_for="nose")


@pytest.mark.slow
def test_a_policy_plans_for_the_assumed_support():
    def built(kind: str, support: str | None) -> PlannedPolicy | OnlinePolicy:
        made = Policy.model_validate({"kind": kind, "assumed_support": support, "candidates": 300, "touches": 4})
        policy = weighed_policy(made)
        assert isinstance(policy, PlannedPolicy | OnlinePolicy)
        return policy

    plan = {support: built("greedy", support) for support in (None, "own_weight", "rigid", "either")}
    assert [p.guess.supports for p in plan.values()] == [("own_weight",), ("own_weight",), ("rigid",), SUPPORTS]
    assert built("online", None).guess.supports == SUPPORTS
    # where one body may carry it all, nothing but an accelerated turn shows its second moment
    accelerated = {
        support: any(isinstance(action, Accelerate) for action in p.plan(L2.shape).actions)
        for support, p in plan.items()
        if isinstance(p, PlannedPolicy)
    }
    assert accelerated == {None: False, "own_weight": False, "rigid": True, "either": True}


def test_an_arrow_begins_at_the_grasp_and_goes_the_way_of_the_turn():
    shape, grasp = L2.shape, L2.shape.grasps[2].position
    for speed in (0.2, -0.2):
        touch = ActionArrow.of(shape, Rotate(2, speed=speed, pivot=(0.05, 0.02)))
        arms = touch.way - np.array([0.05, 0.02])
        np.testing.assert_allclose(touch.way[0], grasp, atol=1e-12)
        np.testing.assert_allclose(np.linalg.norm(arms, axis=1), np.linalg.norm(arms[0]))
        turned = arms[0, 0] * arms[1, 1] - arms[0, 1] * arms[1, 0]
        assert np.sign(turned) == np.sign(speed)
    for action in (Push((0.05, 0.0), np.pi / 2), Push((0.0, 0.0), 0.5)):  # the last one meets no face of this shape
        push = ActionArrow.of(shape, action)
        np.testing.assert_allclose(push.way[-1], action.point)
        np.testing.assert_allclose(np.arctan2(*(push.way[-1] - push.way[0])[::-1]), action.direction)
        assert push.pivot is None
    slide = ActionArrow.of(shape, Slide(2, direction=np.pi / 2))
    assert slide.pivot is None
    np.testing.assert_allclose(slide.way[1] - grasp, [0.0, 0.05], atol=1e-12)


def test_a_plan_is_recorded_step_by_step(tmp_path):
    made = PlannedPolicy(GUESS, goal=Goal(most=3), candidates=200).plan(L2.shape)
    shown = plan_view(L2, made, "a plan")
    assert shown.errors.shape == (4, 6) and (np.diff(shown.errors.sum(axis=1)) < 0).all()
    entities = logged(plan_page(shown), tmp_path / "plan.rrd")
    assert {f"plan/actions/scene/{n}/way" for n in (1, 2, 3)} <= set(entities)
    colors = entities["plan/error/map/cells"].times["iteration"]
    assert all(times.tolist() == [0, 1, 2, 3] for times in colors.values())
