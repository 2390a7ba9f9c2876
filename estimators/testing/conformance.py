"""Rules that every estimator keeps, heft's own and others', and the recovery of known blocks.

A rule raises an AssertionError where it is broken.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import lru_cache

import numpy as np
from numpy.testing import assert_allclose

from estimators.action_selection.rank import predicted_rank
from estimators.base import BatchEstimator, Estimate, Estimator, check_estimate
from estimators.evaluation.metrics import normalized_absolute_difference
from estimators.particles.misfit import UNEXPLAINED
from estimators.testing.analytic_world import accelerated, drawn_object, turns
from estimators.testing.recorded import KnownBlock
from testbed.actions.rotate import Rotate
from testbed.errors import InvalidValueError
from testbed.objects.blocks import block_object, parse_layout
from testbed.objects.model import GRAVITY, MassDistribution, ObjectModel, ObjectShape
from testbed.trajectory import Trajectory

Draw = Callable[[int], ObjectModel]
"""Object of each number."""
ALLOWED = {"ideal": 0.08, "low": 0.1, "moderate": 0.1, "ft300s": 0.1, "high": 0.2}
"""NAD that an answer of status ok may have under each preset, as a ratio."""
MOST_OFF, LEAST_OFF = 2.0, 0.2
"""Largest and least root mean square of errors over claimed errors, of answers with status ok. Ours."""
FEWEST = 3
"""Number of blocks from which errors may count as too large: those of one block are much alike. Ours."""
ANSWERED = ("ok", "unexplained")
"""Statuses of an answer to enough clean trials."""


@lru_cache(maxsize=8)
def small_object(seed: int) -> ObjectModel:
    """Three blocks of 2 x 2 particles, for slow methods.

    The blocks are light, so that a method's bound on the density has no effect.
    """
    rng = np.random.default_rng(seed)
    return block_object(
        "small",
        parse_layout([["10", "11"], ["11", "01"], ["11", "10"]][seed % 3]),
        size=0.05,
        height=0.03,
        mass=rng.uniform(0.002, 0.006, 3).tolist(),
        friction=[float(rng.uniform(0.3, 0.7))],
        friction_group=[0, 0, 0],
        grid=2,
    )


def data(obj: ObjectModel, scale: float = 1.0) -> list[Trajectory]:
    """Turns and accelerated turns about every grasp, with a little noise, `scale` times the usual."""
    noise = scale * 0.001 * obj.total_mass * GRAVITY
    return turns(obj, noise=noise) + accelerated(obj, noise=noise)


def answer_of(
    estimator: Estimator, shape: ObjectShape, weight: float, trajectories: Sequence[Trajectory], seed: int = 0
) -> Estimate:
    """The answer to trials.

    Raises:
        AssertionError: it is no Estimate with the shape's groups.
    """
    answer = estimator.estimate(shape, weight, trajectories, seed)
    try:
        return check_estimate("estimate()", answer, shape)
    except InvalidValueError as error:
        raise AssertionError(str(error)) from None


def masses_of(answer: Estimate) -> MassDistribution:
    """Masses and frictions of an answer that must have them.

    Raises:
        AssertionError: it has none.
    """
    assert answer.distribution is not None, f"no masses: status {answer.status} ({answer.message})"
    return answer.distribution


_CLEAN: list[tuple[Estimator, Draw, ObjectModel, Estimate]] = []
"""Last result of `clean_answer`."""


def clean_answer(estimator: Estimator, draw: Draw) -> tuple[ObjectModel, Estimate]:
    """First object, and the answer to enough clean trials of it; rules that only read the answer share it."""
    if not (_CLEAN and _CLEAN[0][0] is estimator and _CLEAN[0][1] is draw):
        obj = draw(0)
        _CLEAN[:] = [(estimator, draw, obj, answer_of(estimator, obj.shape, obj.total_mass, data(obj)))]
    return _CLEAN[0][2:]


def answers_in_the_shapes_groups(estimator: Estimator, draw: Draw = drawn_object) -> None:
    """Enough clean trials get one mass per mass group, one friction per friction group, and the time it took.

    The status is ok; of a search that ends early, unexplained.
    """
    _, answer = clean_answer(estimator, draw)
    assert answer.status in ANSWERED, f"status {answer.status} ({answer.message}) for enough clean trials"
    masses_of(answer)
    assert answer.seconds > 0, "Estimate.seconds is 0: set it to the wall time of the estimate"


def gives_the_same_answer_to_the_same_seed(estimator: Estimator, draw: Draw = drawn_object) -> None:
    """Equal trials and seeds give equal masses, frictions and covariances, to the last bit."""
    obj = draw(1)
    first, second = (answer_of(estimator, obj.shape, obj.total_mass, data(obj), 7) for _ in range(2))
    for name in ("mass", "friction"):
        _same(name, *(getattr(masses_of(answer), name) for answer in (first, second)))
    assert (first.covariance is None) == (second.covariance is None), "a covariance is there once, and once not"
    if first.covariance is not None and second.covariance is not None:
        _same("covariance", first.covariance, second.covariance)


def _same(name: str, first: np.ndarray, second: np.ndarray) -> None:
    """Check that two values are equal to the last bit."""
    with np.errstate(invalid="ignore"):  # infinite less infinite
        off = np.nanmax(np.abs(first - second), initial=0.0)
    assert np.array_equal(first, second), f"the same seed gave another {name} the second time, {off:.3g} off"


def leaves_what_it_is_given(estimator: Estimator, draw: Draw = drawn_object) -> None:
    """The shape, the list of trials and their arrays are unchanged afterwards: other methods get the same."""
    obj = draw(0)
    given = data(obj)
    kept: dict[str, ObjectShape | Trajectory] = {"shape": obj.shape}
    kept |= {f"trajectories[{index}]": trial for index, trial in enumerate(given)}
    before = {place: {n: a.copy() for n, a in _arrays(value).items()} for place, value in kept.items()}
    trials = list(given)
    try:
        answer_of(estimator, obj.shape, obj.total_mass, given)
        if isinstance(estimator, BatchEstimator):
            estimator.estimate_many(obj.shape, [obj.total_mass], [given], [0])
        assert len(given) == len(trials), f"the list of {len(trials)} trials has {len(given)} afterwards"
        assert all(a is b for a, b in zip(given, trials, strict=True)), "the list has other trials, or another order"
        for place, value in kept.items():
            changed = [n for n, old in before[place].items() if not np.array_equal(vars(value)[n], old, equal_nan=True)]
            assert not changed, f"{place} has another {', '.join(changed)} afterwards"
    finally:
        for place, value in kept.items():  # other rules are given the same
            for name, old in before[place].items():
                old.flags.writeable = False
                object.__setattr__(value, name, old)


def _arrays(value: ObjectShape | Trajectory) -> dict[str, np.ndarray]:
    """Arrays of numbers by name."""
    fields = {name: array for name, array in vars(value).items() if isinstance(array, np.ndarray)}
    return {name: array for name, array in fields.items() if array.dtype.kind in "biuf"}


def doubles_the_masses_when_all_wrenches_double(estimator: Estimator, draw: Draw = drawn_object) -> None:
    """Twice the weight and twice every wrench is twice every mass, at the same friction."""
    obj = draw(1)
    twice = [replace(t, wrench_on_object_world=2 * t.wrench_on_object_world) for t in data(obj)]
    once = masses_of(answer_of(estimator, obj.shape, obj.total_mass, data(obj)))
    double = masses_of(answer_of(estimator, obj.shape, 2 * obj.total_mass, twice))
    assert_allclose(double.mass, 2 * once.mass, rtol=0.02, atol=0.01 * once.mass.max())
    assert_allclose(double.friction, once.friction, rtol=0.02)


def does_not_care_for_the_order_of_particles(estimator: Estimator, draw: Draw = drawn_object) -> None:
    """Particles in another order are the same object."""
    _order_does_not_count(estimator, draw, lambda groups: groups)


def does_not_care_for_the_order_of_groups(estimator: Estimator, draw: Draw = drawn_object) -> None:
    """Groups in another order are the same object, for methods that draw no masses: a draw depends on the order."""
    _order_does_not_count(estimator, draw, lambda groups: np.roll(groups, 1)[::-1])


def _order_does_not_count(estimator: Estimator, draw: Draw, mix: Callable[[np.ndarray], np.ndarray]) -> None:
    obj, answer = clean_answer(estimator, draw)
    groups = mix(np.arange(obj.shape.n_m))
    particles = np.random.default_rng(0).permutation(len(obj.shape.particles))
    place = np.argsort(groups)
    shuffled = ObjectShape(
        particles=obj.shape.particles[particles],
        mass_group=place[obj.shape.mass_group[particles]],
        friction_group=obj.shape.friction_group[particles],
        cell=obj.shape.cell,
        height=obj.shape.height,
        grasps=obj.shape.grasps,
        fill=obj.shape.fill[particles],
    )
    mixed = answer_of(estimator, shuffled, obj.total_mass, data(obj))
    assert_allclose(masses_of(mixed).mass, masses_of(answer).mass[groups], rtol=1e-5, atol=1e-7)
    if answer.covariance is not None and mixed.covariance is not None:
        expected = answer.covariance[np.ix_(groups, groups)]
        known = np.abs(expected[np.isfinite(expected)]).max(initial=0.0)
        assert_allclose(mixed.covariance, expected, rtol=1e-3, atol=1e-3 * known, err_msg="covariance")


def takes_extra_trajectories(estimator: Estimator, draw: Draw = drawn_object) -> None:
    """Duplicate trials and a failed trial do not prevent an answer."""
    obj = draw(2)
    failed = replace(data(obj)[0], status="slipped", reason="it slipped")
    answer = answer_of(estimator, obj.shape, obj.total_mass, [*data(obj), failed, *data(obj)[::-1]])
    assert answer.status in ANSWERED, f"status {answer.status} ({answer.message}) for more trials than enough"


def says_so_when_there_is_too_little(estimator: Estimator, draw: Draw = drawn_object) -> None:
    """No trial, or a single turn, is no answer: a status other than ok, and why in words."""
    obj = draw(0)
    for too_little in ([], turns(obj)[:1]):
        answer = answer_of(estimator, obj.shape, obj.total_mass, too_little)
        assert answer.status != "ok", f"{len(too_little)} trial(s) got status ok"
        assert answer.message, f"{len(too_little)} trial(s) got status {answer.status} without a message"


def says_so_without_a_weight(estimator: Estimator, draw: Draw = drawn_object) -> None:
    """No weight gets an answer, a status with its message, or an InvalidValueError of `weight`."""
    obj = draw(0)
    try:
        answer = check_estimate("estimate()", estimator.estimate(obj.shape, None, data(obj), 0), obj.shape)
    except InvalidValueError as error:
        assert "weight" in str(error), f"no weight was given, and the error is: {error}"
    else:
        assert answer.status == "ok" or answer.message, f"status {answer.status} without a message"


def traces_its_way(estimator: Estimator, draw: Draw = drawn_object) -> None:
    """A trace has a loss and a time for every iteration, and masses where it has any."""
    obj, answer = clean_answer(estimator, draw)
    for trace in answer.traces:
        assert trace.method
        assert len(trace.loss) == len(trace.seconds) > 0
        assert np.isfinite(trace.loss).all()
        assert (np.diff(trace.seconds) >= 0).all()
        assert 0 <= trace.seconds[0] <= trace.seconds[-1] <= answer.seconds
        assert trace.robot_seconds > 0
        assert trace.mass.shape in ((0, 0), (len(trace.loss), obj.shape.n_m))


def answers_many_draws_as_one_by_one(estimator: Estimator, draw: Draw = drawn_object) -> None:
    """`estimate_many`, where there is one: every answer, status and trace as `estimate` gives it, to 1e-9."""
    if not isinstance(estimator, BatchEstimator):
        return
    obj, weight = draw(0), draw(0).total_mass
    noisy = [data(obj), data(obj, 3.0), [], data(obj)[1:], data(obj, 2.0)]  # no two alike; one unusable, one short
    weights = [weight * part for part in (1.0, 1.001, 1.0, 1.0, 0.999)]
    many = estimator.estimate_many(obj.shape, weights, noisy, range(len(noisy)))
    assert len(many) == len(noisy), f"{len(many)} answers to {len(noisy)} draws"
    for seed, (answer, trials) in enumerate(zip(many, noisy, strict=True)):
        alone = estimator.estimate(obj.shape, weights[seed], trials, seed)
        assert (answer.status, answer.message) == (alone.status, alone.message)
        assert [t.method for t in answer.traces] == [t.method for t in alone.traces]
        pairs = [(a.loss, b.loss) for a, b in zip(answer.traces, alone.traces, strict=True)]
        pairs += [(a.mass, b.mass) for a, b in zip(answer.traces, alone.traces, strict=True)]
        if alone.distribution is not None:
            assert answer.distribution is not None
            pairs += [(getattr(answer.distribution, n), getattr(alone.distribution, n)) for n in ("mass", "friction")]
        assert (answer.covariance is None) == (alone.covariance is None)
        if answer.covariance is not None and alone.covariance is not None:
            pairs.append((answer.covariance, alone.covariance))
        for together, by_itself in pairs:
            assert_allclose(together, by_itself, rtol=1e-9, atol=1e-9 * np.abs(by_itself).max(initial=0.0))
        assert answer.seconds > 0


def refuses_trials_of_another_shape(estimator: Estimator, draw: Draw = drawn_object) -> None:
    """A trial of a grasp that the shape does not have is refused by name."""
    obj = draw(0)
    good = data(obj)
    beyond = replace(good[0], action=Rotate(len(obj.shape.grasps), duration=2.5))
    try:
        estimator.estimate(obj.shape, obj.total_mass, [*good, beyond], 0)
    except InvalidValueError as error:
        given = str(error)
    else:
        given = "nothing was raised"
    wanted = r"trajectories\[\d+\]\.action\.grasp: .*grasps"
    assert re.search(wanted, given), (
        f"wanted: an InvalidValueError of trajectories[i].action.grasp, as observe() raises; got: {given}"
    )


def does_not_hide_that_trajectories_contradict_each_other(estimator: Estimator, draw: Draw = drawn_object) -> None:
    """Contradictory trials get a status other than ok, or a misfit above its limit, by which heft sets the status."""
    obj = draw(0)
    for trials in ([*data(obj), *opposed(obj)], [*data(obj), *of_another(obj)]):
        answer = answer_of(estimator, obj.shape, obj.total_mass, trials)
        misfit = answer.diagnostics.get("misfit", 0.0)
        assert answer.status != "ok" or misfit > UNEXPLAINED, f"status ok, diagnostics {answer.diagnostics}"


@lru_cache(maxsize=8)
def opposed(obj: ObjectModel) -> tuple[Trajectory, ...]:
    """Turns with reversed wrenches."""
    return tuple(replace(t, wrench_on_object_world=-t.wrench_on_object_world) for t in turns(obj))


@lru_cache(maxsize=8)
def of_another(obj: ObjectModel) -> tuple[Trajectory, ...]:
    """Turns of an object of the same shape and weight, its masses the other way round."""
    swapped = MassDistribution(obj.truth.mass[::-1] ** 2 / np.mean(obj.truth.mass), obj.truth.friction)
    return tuple(turns(replace(obj, truth=swapped)))


CONFORMANCE: tuple[Callable[..., None], ...] = (
    answers_in_the_shapes_groups,
    gives_the_same_answer_to_the_same_seed,
    leaves_what_it_is_given,
    doubles_the_masses_when_all_wrenches_double,
    does_not_care_for_the_order_of_particles,
    takes_extra_trajectories,
    says_so_when_there_is_too_little,
    says_so_without_a_weight,
    traces_its_way,
    answers_many_draws_as_one_by_one,
    refuses_trials_of_another_shape,
    does_not_hide_that_trajectories_contradict_each_other,
)
"""The rules: call each with an estimator."""
WITHOUT_DRAWS: tuple[Callable[..., None], ...] = (does_not_care_for_the_order_of_groups,)
"""For methods that draw no masses."""


def recovers(
    estimator: Estimator,
    block: KnownBlock,
    sensing: str,
    trials: Sequence[Trajectory],
    slack: float = 1.0,
    claims: str = "own_weight",
) -> None:
    """Check that masses and frictions of status ok are right, and that any other status has a message.

    A method that claims own weight alone must give right masses where a perfect sensor's trials show every mass, with
    any status. A method that claims more does not get the support, and the trials may not show it.

    Args:
        estimator: estimator under test.
        block: known block with its truth.
        sensing: preset of the trials.
        trials: trials for the estimator.
        slack: factor on `ALLOWED`.
        claims: supports that the estimator claims to know: own_weight, rigid or both.

    Raises:
        AssertionError: with a sentence on what was answered and what is allowed.
    """
    model, limit = block.model, slack * ALLOWED[sensing]
    answer = answer_of(estimator, model.shape, block.weighed(sensing), list(trials))
    where = f"{model.name}, {block.support}, sensing {sensing}"
    if answer.status != "ok":
        assert answer.message, f"{where}: status {answer.status} without a message"
        if not (sensing == "ideal" and claims == block.support == "own_weight" and shows_every_mass(block)):
            return
        silent = f"{where}: status {answer.status} ({answer.message}), where these trials show every mass"
        assert answer.distribution is not None, silent
    assert answer.distribution is not None, f"{where}: status ok without a mass distribution"
    nad = normalized_absolute_difference(model.shape, answer.distribution, model.truth)
    assert nad <= limit, _verdict(where, answer, block, nad, limit)
    if answer.status == "ok":
        off = float(np.abs(answer.distribution.friction / model.truth.friction - 1).max())
        assert off <= limit, f"{where}: a friction is off by {100 * off:.1f} %\n{_listed(answer.distribution, block)}"


def claims_errors_of_their_size(
    estimator: Estimator, blocks: Sequence[KnownBlock], sensing: str = "ft300s", slack: float = 1.0
) -> int:
    """Errors of masses, over known blocks, are between a fifth of those that covariances claim and twice them.

    Only answers with status ok and a covariance count; without any there is no check, and few may be right by chance.

    Args:
        estimator: estimator under test.
        blocks: known blocks that it claims to know.
        sensing: preset of the trials.
        slack: factor on the largest ratio.

    Returns:
        Number of answers that count.

    Raises:
        AssertionError: with the ratio, and what is likely wrong.
    """
    ratios: list[float] = []
    answered, most = 0, slack * MOST_OFF
    for block in blocks:
        shape = block.model.shape
        answer = answer_of(estimator, shape, block.weighed(sensing), block.trials(sensing))
        mass, error = answer.group_mass(shape), answer.group_error(shape)
        if answer.status == "ok" and mass is not None and error is not None:
            known = np.isfinite(error) & (error > 0)
            ratios += list((mass - block.model.group_mass)[known] / error[known])
            answered += bool(known.any())
    if not ratios:
        return 0
    size = float(np.sqrt(np.mean(np.square(ratios))))
    assert size < most, (
        f"the masses of known blocks are off by {size:.3g} times their claimed errors; allowed: {most:g}: is the "
        "covariance that of the particles' mean masses, in kg^2?"
    )
    assert size > LEAST_OFF or answered < FEWEST, (
        f"the masses of known blocks are off by {size:.2g} of their claimed errors; allowed: {LEAST_OFF:g} or more: is "
        "the covariance that of the particles' mean masses, not of the groups'?"
    )
    return answered


def shows_every_mass(block: KnownBlock) -> bool:
    """True if the turns have full rank and there is one friction, so that the masses follow from M."""
    turns = [trial.action for trial in block.clean if trial.action.turns and not trial.action.accelerated]
    return block.model.shape.n_mu == 1 and predicted_rank(block.model.shape, turns) == block.model.shape.n_m


def _verdict(where: str, answer: Estimate, block: KnownBlock, nad: float, limit: float) -> str:
    assert answer.distribution is not None
    hint = f"status ok claims no more than {100 * limit:.0f} %"
    found, true = answer.distribution.group_mass(block.model.shape), block.model.group_mass
    if block.support == "rigid":
        hint += "; friction under one rigid body shows M and its center alone: say so, or claim own_weight only"
    elif np.abs(np.sort(found) - np.sort(true)).sum() <= limit * block.model.total_mass:
        hint += "; in another order they are right: column k of `mass` is that of `shape.mass_group == k`"
    return f"{where}: NAD {100 * nad:.1f} %; {hint}\n{_listed(answer.distribution, block)}"


def _listed(found: MassDistribution, block: KnownBlock) -> str:
    """Masses and frictions with the true values."""
    shape, truth = block.model.shape, block.model.truth
    masses = ", ".join(
        f"{name} {mine:.3f} ({true:.3f})"
        for name, mine, true in zip(shape.group_names, found.group_mass(shape), block.model.group_mass, strict=True)
    )
    frictions, true_frictions = (", ".join(f"{mu:.2f}" for mu in each.friction) for each in (found, truth))
    return f"  masses, kg (truth): {masses}\n  friction (truth): {frictions} ({true_frictions})"
