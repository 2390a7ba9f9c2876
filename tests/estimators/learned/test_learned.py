"""The learned posterior after a small training: its loss, draws, symmetries, and what it refuses."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from numpy.testing import assert_allclose

from estimators.learned.checkpoint import FALSE_ALARM, LEAST_FREEDOM, Checkpoint, Origin
from estimators.learned.estimator import Learned
from estimators.learned.examples import fixed_axes, make_examples
from estimators.learned.question import MISFIT, MISFIT_OF_INERTIA, SUMMARY
from estimators.registry import code_of
from estimators.testing.analytic_lab import LAB, drawn
from estimators.testing.analytic_world import accelerated, analytic_trial, drawn_object, turns
from estimators.testing.conformance import CONFORMANCE
from testbed.actions.slide import Slide
from testbed.files import DamagedFileError
from tests.fakes.analytic_links import drawn_chain
from tests.helpers.lab import SEED, lab_trials, renamed

pytest.importorskip("zuko", reason="needs the extra learned")

from estimators.learned.network import Network, Sizes, departures
from estimators.learned.training import first_loss, loss, train

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    """A network of few examples, and its examples."""
    examples = make_examples(SEED, range(10))
    learned = train(examples, examples, Origin(10, SEED), epochs=25)  # the best on the same: few others say nothing
    path = tmp_path_factory.mktemp("learned") / "learned.pt"
    learned.save(path)
    return Learned(str(path)), learned, examples


def network_of(learned):
    network = Network(Sizes(**learned.sizes))
    network.load_state_dict(learned.weights)
    return network.eval()


def test_training_lowers_the_loss(trained):
    _, learned, examples = trained
    with torch.no_grad():
        assert (
            float(loss(network_of(learned), examples.turned(*fixed_axes(len(examples))))) < first_loss(examples) - 0.05
        )


def test_limits_are_quantiles_of_the_examples_misfits(trained):
    _, learned, examples = trained
    misfit = examples.summary[:, SUMMARY.index(MISFIT)].exp()
    assert set(learned.limits) == {MISFIT, MISFIT_OF_INERTIA} and min(learned.limits.values()) >= 1
    few = 3 * examples.windows.sum(1) - examples.groups.sum(1) < LEAST_FREEDOM
    above = misfit[~few] > learned.limits[MISFIT]
    assert 0 < (~few).sum() and above.sum() <= max(1, FALSE_ALARM * len(above))


def test_draws_and_density_are_of_one_distribution(trained):
    """Draws of the flow map back to their noise, and its density integrates to one over a group's load."""
    _, learned, examples = trained
    network, two = network_of(learned), examples[examples.groups.sum(1) == examples.groups.sum(1).min()][:1]
    noise = torch.randn(5, 1, two.mean.shape[1], dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    with torch.no_grad():
        drawn_loads = network.draw(two, noise)
        for load, made in zip(drawn_loads, noise, strict=True):
            known = replace(two, truth=torch.where(two.groups, load, 0.0))
            context = network._contexts(network.encode(known), departures(known).float())
            back = network.flow(context).transform(departures(known).float()[..., None])[..., 0]
            assert_allclose(back[two.groups], made[two.groups], atol=2e-3)


def test_answers_keep_the_protocol_and_permute_with_the_groups(trained):
    estimator, _, _ = trained
    obj = drawn(0, SEED, "corners", (4, 4))
    trials, order = lab_trials(obj), np.array([2, 0, 3, 1])
    answer = estimator.estimate(obj.shape, obj.total_mass, trials, 0)
    mixed = estimator.estimate(renamed(obj.shape, order), obj.total_mass, trials, 0)
    assert answer.distribution is not None and mixed.distribution is not None
    assert_allclose(answer.group_mass(obj.shape).sum(), obj.total_mass, rtol=1e-3)
    assert_allclose(mixed.distribution.mass, answer.distribution.mass[order], rtol=1e-4)
    assert_allclose(mixed.covariance, answer.covariance[np.ix_(order, order)], rtol=1e-3, atol=1e-9)
    again = estimator.estimate(obj.shape, obj.total_mass, trials, 0)
    assert np.array_equal(again.distribution.mass, answer.distribution.mass)


@pytest.mark.parametrize(
    "holds",
    [
        rule
        for rule in CONFORMANCE
        if rule.__name__
        in (
            "says_so_when_there_is_too_little",
            "refuses_trials_of_another_shape",
            "does_not_hide_that_trajectories_contradict_each_other",
            "gives_the_same_answer_to_the_same_seed",
        )
    ],
)
def test_conformance(trained, holds):
    """Rules on status; `ok` on clean trials is not asked: a world without errors is outside its lab."""
    holds(trained[0])


def test_what_was_not_learned_is_refused(trained):
    estimator, _, _ = trained
    lab = drawn(0, SEED, "corners", (4, 4))
    large = drawn(0, SEED, "corners", (9, 9))
    two = drawn_object(0, friction_groups=2)
    chain = drawn_chain(0)
    rough = [replace(trial, setup=replace(LAB, gain=0.05)) for trial in lab_trials(lab, 1)]
    heavy = [replace(t, wrench_on_object_world=20 * t.wrench_on_object_world) for t in lab_trials(lab)]
    for obj, trials, words in (
        (chain, [], "hinges"),
        (two, turns(two), "2 frictions"),
        (large, lab_trials(large, 1), "9 groups"),
        (lab, rough, "gain"),
        (lab, [*lab_trials(lab, 1), *turns_and_slide(lab)], "slide"),
        (lab, heavy, "friction"),
        (drawn_object(0), turns(drawn_object(0)) + accelerated(drawn_object(0)), ""),
    ):
        answer = estimator.estimate(obj.shape, obj.total_mass, trials, 0)
        assert answer.status == "assumption_violated" and words in answer.message


def turns_and_slide(obj):
    return [replace(analytic_trial(obj, Slide(0)), setup=LAB)]


def test_a_damaged_checkpoint_and_another_format_are_refused(trained, tmp_path, monkeypatch):
    estimator, learned, _ = trained
    data, broken = bytearray(estimator.path.read_bytes()), tmp_path / "broken.pt"
    data[len(data) // 2] ^= 1
    broken.write_bytes(data)
    with pytest.raises(DamagedFileError, match="checksum"):
        Learned(str(broken)).check_installed()
    before = code_of("learned", {"checkpoint": str(broken)})
    monkeypatch.setattr("estimators.learned.checkpoint.FORMAT", 0)
    learned.save(broken)
    monkeypatch.undo()
    with pytest.raises(DamagedFileError, match="heft learn"):
        Checkpoint.load(broken)
    assert code_of("learned", {"checkpoint": str(broken)}) != before
