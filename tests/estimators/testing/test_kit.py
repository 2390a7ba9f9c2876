"""The conformance kit: its known blocks and rules, what it says of a wrong answer, and heft's own estimators in it."""

import subprocess
import sys
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from numpy.testing import assert_allclose

from estimators import Bayes, Estimate, Estimator, HiddenStates, SupportAware, Trace, normalized_absolute_difference
from estimators.testing import conformance as rules
from estimators.testing import plugin, recorded
from estimators.testing.conformance import (
    ALLOWED,
    CONFORMANCE,
    WITHOUT_DRAWS,
    claims_errors_of_their_size,
    recovers,
    shows_every_mass,
)
from estimators.testing.recorded import KnownBlock, block_names, load_block, save_block
from estimators.testing.test_estimator import CLAIMED, cases
from testbed import InvalidValueError, Rotate, Trajectory, steady_windows
from testbed.objects.files import Blocks, ObjectFile
from testbed.objects.model import GRAVITY, MassDistribution, ObjectModel, ObjectShape
from testbed.sensing.presets import PRESETS

OWN_WEIGHT = [name for name in block_names() if name.endswith("own_weight")]
FEW = ("L2-own_weight", "drawn_a-own_weight", "two_frictions-own_weight")
"""Blocks, one of each kind; the whole kit recovers the others too."""


def estimator(estimate: Callable[..., Estimate], **more: Callable[..., Any]) -> Estimator:
    """An estimator of these methods."""
    return cast(Estimator, SimpleNamespace(estimate=estimate, **more))


def answering(say: Callable[[KnownBlock], Estimate], block: KnownBlock) -> Estimator:
    return estimator(lambda *_: say(block))


def right(block: KnownBlock) -> Estimate:
    return Estimate(block.model.truth, "ok")


def even(block: KnownBlock) -> Estimate:
    mass = np.full(block.model.shape.n_m, block.model.total_mass / len(block.model.shape.particles))
    return Estimate(replace(block.model.truth, mass=mass), "ok")


def turned_round(block: KnownBlock) -> Estimate:
    return Estimate(replace(block.model.truth, mass=block.model.truth.mass[::-1]), "ok")


def slippery(block: KnownBlock) -> Estimate:
    return Estimate(replace(block.model.truth, friction=block.model.truth.friction / 2), "ok")


def test_the_plugin_knows_what_there_is_without_importing_it():
    assert plugin.BLOCKS == block_names()
    assert {*plugin.SENSORS} == {*PRESETS} == {*ALLOWED}
    assert len(OWN_WEIGHT) * 2 == len(block_names())
    assert sum(path.stat().st_size for path in recorded.FOLDER.iterdir()) < 5e6


def test_every_block_and_every_sensor_is_met_on_both_supports():
    few, all_ = (cases(thorough=thorough) for thorough in (False, True))
    assert len({*all_}) == len(all_) == len(plugin.BLOCKS) * len(plugin.SENSORS)
    assert {*few} < {*all_}
    assert {block for block, _ in few} == {*plugin.BLOCKS}
    assert {block for block, sensing in few if sensing == "ideal"} > {*OWN_WEIGHT}
    met = {(block.partition("-")[2], sensing) for block, sensing in few}
    assert len(met) == 2 * len(plugin.SENSORS)


def test_a_known_block_comes_back_from_its_file(tmp_path):
    block = load_block("two_frictions-own_weight")
    straight = load_block("L2-own_weight")
    assert shows_every_mass(straight) and not shows_every_mass(replace(straight, clean=straight.clean[:4]))
    assert not shows_every_mass(block)
    blocks = Blocks(
        layout=["10", "10", "111"], mass_kg=block.model.group_mass.tolist(), friction=[0.3, 0.6],
        friction_group=[0, 0, 1, 1, 1],
    )  # fmt: skip
    path = save_block(ObjectFile(name="two_frictions", blocks=blocks), "own_weight", block.clean, {}, tmp_path)
    assert path.read_bytes()[:4] == b"PAR1"
    before = recorded.pq.read_table(recorded.FOLDER / path.name)
    after = recorded.pq.read_table(path)
    assert after.equals(before)
    with pytest.raises(InvalidValueError, match="one of F1-own_weight"):
        load_block("I3-rigid")


@pytest.mark.parametrize("name", block_names())
def test_the_wrenches_of_a_known_block_are_its_friction(name):
    """No force beyond mu times what the table carries, and at the farthest pivot much of it."""
    block = load_block(name)
    turns = [trial for trial in block.clean if isinstance(trial.action, Rotate)]
    windows = [window for turn in turns for window in steady_windows(turn)]
    carried = [block.model.total_mass * GRAVITY - window.wrench[2] for window in windows]
    dragged = [np.linalg.norm(window.wrench[:2]) for window in windows]
    share = np.array(dragged) / carried / max(block.model.truth.friction)
    assert 0.4 < share.max() < 1.02
    assert all(trial.provenance["bench"] == "simulated" for trial in block.clean)


def test_every_draw_has_errors_of_its_own_and_the_same_ones_again():
    block = load_block("L2-own_weight")
    drawn = [[t.wrench_on_object_world for t in block.trials("ft300s", seed)] for seed in (0, 0, 1)]
    for first, again, other in zip(*drawn, strict=True):
        assert_allclose(first, again)
        assert 0.05 < np.std((first - other)[:, 0]) < 0.2
    assert block.weighed("ideal") == block.model.total_mass != block.weighed("ft300s")


OTHER = MassDistribution(np.array([0.1, 0.2]), np.array([0.5]))
SILENT = Estimate(None, "underdetermined", "too few turns")
LATE: dict[str, Any] = {"status": "not_converged", "message": "no"}
VERDICTS = [
    ("L2-own_weight", "ideal", right, None),
    ("L2-rigid", "ideal", right, None),
    ("L2-own_weight", "ideal", even, r"NAD 44\.4 %; .*no more than 8 %\n.*A1 0\.300"),
    ("L2-rigid", "ideal", even, "claim own_weight only"),
    ("two_frictions-own_weight", "ideal", lambda _: SILENT, None),  # these trials do not show every mass
    ("L2-rigid", "ideal", lambda _: SILENT, None),
    ("L2-own_weight", "high", lambda _: SILENT, None),
    ("L2-own_weight", "ideal", lambda _: SILENT, r"\(too few turns\), where these trials show every mass"),
    ("L2-own_weight", "ideal", lambda block: replace(even(block), **LATE), r"NAD 44\.4 %"),
    ("L2-own_weight", "ideal", turned_round, "in another order they are right"),
    ("L2-own_weight", "ideal", slippery, r"a friction is off by 50\.0 %"),
    ("L2-own_weight", "ideal", lambda block: replace(right(block), **LATE), None),
    ("L2-rigid", "ideal", lambda _: replace(SILENT, message=""), "without a message"),
    ("L2-own_weight", "ideal", lambda _: cast(Estimate, None), r"estimate\(\): got None; allowed: an Estimate"),
    ("L2-own_weight", "ideal", lambda _: Estimate(OTHER, "ok"), "got '2 masses, 1 frictions'; allowed: 6 and 1"),
]


def breach(message: str | None) -> AbstractContextManager[object]:
    """Context that expects an AssertionError with this message, or none."""
    return nullcontext() if message is None else pytest.raises(AssertionError, match=message)


JUDGED = [*((*each, 1.0) for each in VERDICTS), ("L2-own_weight", "ideal", even, None, 6.0)]


@pytest.mark.parametrize(("name", "sensing", "answer", "message", "slack"), JUDGED)
def test_an_answer_is_judged_by_the_truth(name, sensing, answer, message, slack):
    block = load_block(name)
    with breach(message):
        recovers(answering(answer, block), block, sensing, [], slack)


@pytest.mark.parametrize("name", FEW)
def test_algorithm_1_recovers_blocks_on_their_own_weight(name):
    block = load_block(name)
    for sensing in ("ideal", "ft300s"):
        recovers(HiddenStates(), block, sensing, block.trials(sensing))


def test_frictions_that_inertia_alone_tells_apart_are_found_along_the_valley():
    """Masses that change with the inverse of their friction leave every friction load as it is."""
    block = load_block("two_frictions-own_weight")
    for seed in range(3):
        weight, trials = block.weighed("ft300s", seed), block.trials("ft300s", seed)
        found, other = (
            method.estimate(block.model.shape, weight, trials, seed) for method in (Bayes(), HiddenStates())
        )
        assert found.status == "ok" and found.diagnostics["misfit"] < 1.1 * other.diagnostics["misfit"]
        assert found.distribution is not None
        assert normalized_absolute_difference(block.model.shape, found.distribution, block.model.truth) < 0.1


def doubted(change: Callable[[Any, ObjectShape], np.ndarray]) -> Estimator:
    """The real estimator with another covariance."""
    return changed(lambda answer, shape: replace(answer, covariance=change(answer, shape)))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        (lambda answer, _: answer.covariance, None),
        (lambda answer, _: answer.covariance / 9, "off by .* times their claimed errors"),
        (lambda answer, shape: answer.covariance * shape.particles_per_group[0] ** 2, "not of the groups"),
    ],
)
def test_errors_are_compared_with_the_claimed_ones(wrong, message):
    blocks = [load_block(name) for name in CLAIMED]
    with breach(message):
        assert claims_errors_of_their_size(doubted(wrong), blocks) == len(blocks)


def test_without_an_answer_no_claim_is_checked():
    assert claims_errors_of_their_size(estimator(lambda *_: SILENT), [load_block(CLAIMED[0])]) == 0


def test_a_covariance_in_another_order_than_the_masses_is_caught():
    with pytest.raises(AssertionError, match="covariance"):
        rules.does_not_care_for_the_order_of_groups(doubted(lambda answer, _: answer.covariance[::-1, ::-1]))


@pytest.mark.parametrize("flawed", ["wrench_on_object_world", "tcp_velocity"])
def test_an_array_that_was_written_to_is_named_and_restored(flawed):
    def estimate(shape: ObjectShape, weight: float, trajectories: list[Trajectory], seed: int) -> Estimate:
        answer = REAL.estimate(shape, weight, trajectories, seed)
        array = getattr(trajectories[1], flawed)
        array.flags.writeable = True
        array *= 2.0
        return answer

    before = [getattr(trial, flawed).copy() for trial in rules.data(rules.drawn_object(0))]
    with pytest.raises(AssertionError, match=rf"trajectories\[1\] has another {flawed} afterwards"):
        rules.leaves_what_it_is_given(estimator(estimate))
    after = [getattr(trial, flawed) for trial in rules.data(rules.drawn_object(0))]
    assert all(np.array_equal(a, b) for a, b in zip(before, after, strict=True))


@pytest.mark.slow
@pytest.mark.parametrize("name", ["L2-rigid", "drawn_a-rigid"])
def test_a_rigid_body_is_what_support_aware_knows_and_algorithm_1_does_not(name):
    block = load_block(name)
    trials = list(block.trials("ideal"))
    recovers(SupportAware(), block, "ideal", trials)
    answer = HiddenStates().estimate(block.model.shape, block.model.total_mass, trials, 0)
    assert answer.status == "unexplained" and "own weight" in answer.message
    with pytest.raises(AssertionError, match="claim own_weight only"):
        recovers(answering(lambda _: replace(answer, status="ok"), block), block, "ideal", [])


OWN = ("--pyargs", "estimators.testing")
"""Tests that the kit brings."""


def kit(tmp_path, *arguments: str, tests: tuple[str, ...] = OWN) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "pytest", "-p", "estimators.testing.plugin", *tests, *arguments]
    return subprocess.run(command, check=False, capture_output=True, text=True, cwd=tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("path", "options"),
    [
        ("estimators:HiddenStates", ("--estimator-support", "own_weight", "--estimator-thorough")),
        ("estimators:SupportAware", ("--estimator-support", "both", "-k", "not rule")),  # rules: `test_methods`
    ],
)
def test_the_whole_kit_passes(tmp_path, path, options):
    done = kit(tmp_path, "--estimator", path, *options)
    assert done.returncode == 0 and " passed" in done.stdout, done.stdout


@pytest.mark.slow
def test_the_kit_reports_each_breach(tmp_path):
    (tmp_path / "lazy.py").write_text(
        "class Lazy:\n    def estimate(self, shape, weight, trajectories, seed):\n        return None\n",
        encoding="utf-8",
    )
    done = kit(tmp_path, "--estimator", "lazy:Lazy", "-k", "shapes_groups or L2-own_weight-ideal")
    assert done.returncode == 1
    failures = done.stdout.split("short test summary")[0]  # which repeats messages where CI is set
    assert failures.count("estimate(): got None; allowed: an Estimate of estimators.base") == 2


@pytest.mark.slow
def test_fixtures_serve_other_tests_and_rules_ask_for_an_estimator(tmp_path):
    (tmp_path / "test_mine.py").write_text(
        "import pytest\n"
        '@pytest.mark.parametrize("known_block", ["L2-rigid"], indirect=True)\n'
        '@pytest.mark.parametrize("sensing", ["high"], indirect=True)\n'
        "def test_mine(known_block, sensing, recorded_trials):\n"
        '    assert (known_block.name, sensing, len(recorded_trials)) == ("L2-rigid", "high", 7)\n',
        encoding="utf-8",
    )
    done = kit(tmp_path, "-k", "mine or shapes_groups", tests=("test_mine.py", *OWN))
    assert done.returncode == pytest.ExitCode.USAGE_ERROR and "1 passed" in done.stdout, done.stdout
    assert "which estimator? --estimator package:Class" in done.stdout


@pytest.mark.parametrize(
    ("name", "settings", "message"),
    [
        ("estimators.hidden_states.estimator:HiddenState", "", r"\(nearest: HiddenStates\)"),
        ("estimators:HiddenStates", "steps", r"^--estimator-settings: got 'steps'; allowed: settings as TOML"),
        ("estimators:HiddenStates", "steps = 0", r"steps: got 0; allowed: an integer >= 1"),
    ],
)
def test_a_wrong_option_of_the_kit_is_refused(name, settings, message):
    options = {"--estimator": name, "--estimator-settings": settings}
    with pytest.raises(pytest.UsageError, match=message):
        plugin.pytest_configure(cast(pytest.Config, SimpleNamespace(getoption=options.get)))


REAL = HiddenStates()
BAD_LUCK = np.random.default_rng(0)


def changed(change: Callable[[Estimate, ObjectShape], Estimate], *, forgiving: bool = False) -> Estimator:
    """The real estimator with its answer changed; a forgiving one leaves out trials of another object."""

    def estimate(shape: ObjectShape, weight: float, trajectories: Sequence[Trajectory], seed: int) -> Estimate:
        if forgiving:
            trajectories = [t for t in trajectories if getattr(t.action, "grasp", 0) < len(shape.grasps)]
        return change(REAL.estimate(shape, weight, trajectories, seed), shape)

    return estimator(estimate)


def fragile(shape: ObjectShape, weight: float, trajectories: Sequence[Trajectory], seed: int) -> Estimate:
    """An estimate that takes only trials that went well."""
    if not all(t.ok for t in trajectories):
        raise RuntimeError("a trial did not end well")
    return REAL.estimate(shape, weight, trajectories, seed)


def emptying(shape: ObjectShape, weight: float, trajectories: list[Trajectory], seed: int) -> Estimate:
    """An estimate that takes the trials out of its list."""
    given = [trajectories.pop() for _ in range(len(trajectories))][::-1]
    return REAL.estimate(shape, weight, given, seed)


def weightless(shape: ObjectShape, weight: float | None, trajectories: Sequence[Trajectory], seed: int) -> Estimate:
    """An estimate that takes a weight for granted."""
    return REAL.estimate(shape, 1.0 * cast(float, weight), trajectories, seed)


def careless(shape: ObjectShape, weights: Any, draws: Any, seeds: Any) -> list[Estimate]:
    """A batch that gives every draw the answer of the first."""
    return [REAL.estimate(shape, weights[0], draws[0], seeds[0])] * len(draws)


def with_masses(of: Callable[[np.ndarray, ObjectShape], np.ndarray]) -> Estimator:
    """The real estimator with its masses changed."""

    def change(answer: Estimate, shape: ObjectShape) -> Estimate:
        if answer.distribution is None:
            return answer
        changed = MassDistribution(of(answer.distribution.mass, shape), answer.distribution.friction)
        return replace(answer, distribution=changed, covariance=None)

    return changed(change)


def guessing(answer: Estimate, shape: ObjectShape) -> Estimate:
    if answer.distribution is not None:
        return answer
    return replace(answer, status="ok", distribution=MassDistribution(np.ones(shape.n_m), np.ones(shape.n_mu)))


RAGGED = (Trace("steps", (2.0, 1.0), (0.0,), 1.0, np.empty((0, 0))),)
BREACHES: dict[Callable[..., None], Estimator] = {
    rules.answers_in_the_shapes_groups: with_masses(lambda mass, _: mass[:-1]),
    rules.gives_the_same_answer_to_the_same_seed: with_masses(lambda mass, _: mass * BAD_LUCK.uniform(0.9, 1.1)),
    rules.leaves_what_it_is_given: estimator(emptying),
    rules.doubles_the_masses_when_all_wrenches_double: with_masses(lambda _, shape: np.full(shape.n_m, 0.1)),
    rules.does_not_care_for_the_order_of_particles: with_masses(
        lambda mass, shape: np.where(np.arange(shape.n_m) == shape.mass_group[0], 2, 1) * mass
    ),
    rules.does_not_care_for_the_order_of_groups: with_masses(
        lambda mass, _: mass * np.append(2, np.ones(len(mass) - 1))
    ),
    rules.takes_extra_trajectories: estimator(fragile),
    rules.says_so_when_there_is_too_little: changed(guessing),
    rules.says_so_without_a_weight: estimator(weightless),
    rules.traces_its_way: changed(lambda answer, _: replace(answer, traces=RAGGED)),
    rules.answers_many_draws_as_one_by_one: estimator(REAL.estimate, estimate_many=careless),
    rules.refuses_trials_of_another_shape: changed(lambda answer, _: answer, forgiving=True),
    rules.does_not_hide_that_trajectories_contradict_each_other: changed(
        lambda answer, shape: replace(guessing(answer, shape), status="ok", diagnostics={"loss": 1.0})
    ),
}


@pytest.mark.parametrize("rule", BREACHES, ids=lambda rule: rule.__name__)
def test_a_breach_is_caught(rule):
    assert isinstance(BREACHES[rule], Estimator)
    with pytest.raises((AssertionError, RuntimeError, TypeError, pytest.fail.Exception)):
        rule(BREACHES[rule])


def test_every_rule_has_a_breach():
    assert {*BREACHES} == {*CONFORMANCE, *WITHOUT_DRAWS}


@pytest.mark.slow
def test_an_estimator_is_given_no_truth():
    given: list[Any] = []

    def estimate(shape: Any, weight: Any, trajectories: Any, seed: Any) -> Estimate:
        given.extend([shape, weight, seed, *trajectories])
        return REAL.estimate(shape, weight, trajectories, seed)

    for rule in (*CONFORMANCE, *WITHOUT_DRAWS):
        rule(estimator(estimate))
    assert {type(value) for value in given} <= {ObjectShape, float, int, Trajectory, type(None)}
    inside = [part for value in given if isinstance(value, Trajectory) for part in vars(value).values()]
    assert not any(isinstance(part, ObjectModel | MassDistribution) for part in inside)
