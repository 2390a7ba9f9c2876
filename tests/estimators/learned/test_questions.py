"""Questions to the learned posterior: their symmetries and files; and its settings."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
from numpy.testing import assert_allclose

from estimators import Learned, observe
from estimators.learned.checkpoint import load_examples, save_examples
from estimators.learned.examples import RATES, Examples, fixed_axes
from estimators.learned.question import Question, ask
from estimators.registry import check_installed, code_of
from estimators.testing.analytic_lab import LAB, Draw, contacts, drawn, flawed_trial
from estimators.testing.analytic_world import drawn_object
from testbed import Accelerate, InvalidValueError, Rotate, SetupErrors
from tests.helpers.lab import SEED, lab_trials, renamed


def test_windows_of_a_slower_record_are_the_same():
    """Examples are sampled slowly: without noise a window's mean changes by the sampling of its ends alone."""
    obj, quiet = drawn(0, SEED, "grid"), SetupErrors()
    rng = np.random.default_rng(0)
    feet, draw = contacts(obj, "grid", quiet, rng), Draw.of(quiet, rng)
    action = Rotate(0, duration=4.0, back=True)
    usual, slow = (
        observe(obj.shape, [flawed_trial(obj, action, feet, draw, np.random.default_rng(1), rate)])
        for rate in (100.0, RATES[0])
    )
    assert usual is not None and slow is not None
    noise = (usual.covariance + slow.covariance).diagonal(dim1=1, dim2=2).sqrt()  # the bias is the same draw
    assert ((usual.wrench - slow.wrench).abs() < 5 * noise).all()
    assert_allclose(slow.twist, usual.twist, rtol=2e-3, atol=2e-4)
    size = slow.covariance.diagonal(dim1=1, dim2=2).sum() / usual.covariance.diagonal(dim1=1, dim2=2).sum()
    assert 0.4 < size < 2.5  # variances of few means


def test_a_dead_sensor_is_the_reason_for_no_question():
    obj = drawn(1, SEED, "corners", (4, 4))
    dead = [replace(t, wrench_on_object_world=0 * t.wrench_on_object_world) for t in lab_trials(obj, 1)]
    reason = ask(obj.shape, obj.total_mass, dead)
    assert isinstance(reason, str) and "dead sensor" in reason


@pytest.mark.slow
def test_names_of_groups_do_not_count_in_a_question():
    obj = drawn(1, SEED, "corners", (4, 4))
    trials, order = lab_trials(obj, 2), np.array([2, 0, 3, 1])
    one, other = (ask(shape, obj.total_mass, trials) for shape in (obj.shape, renamed(obj.shape, order)))
    assert isinstance(one, Question) and isinstance(other, Question)
    assert_allclose(other.first.mean, one.first.mean[order], rtol=1e-6)
    assert_allclose(other.edges, one.edges[:, order], rtol=1e-5, atol=1e-7)
    axes = fixed_axes(1)
    first, second = (Examples.of([question]).turned(*axes) for question in (one, other))
    assert_allclose(second.mean, first.mean, rtol=1e-6)
    assert_allclose(second.covariance, first.covariance, rtol=1e-5, atol=1e-9)


@pytest.mark.slow
def test_the_first_answer_weighs_inertia_by_its_true_error():
    """The inertia of the true masses is what accelerated turns show, within the errors; that of others is not."""
    obj, rng = drawn(1, SEED, "corners", (4, 4)), np.random.default_rng(0)
    feet, draw = contacts(obj, "corners", LAB, rng), Draw.of(LAB, rng)
    actions = [Rotate(0, duration=4.0, back=True), *(Accelerate(grasp) for grasp in range(3))]
    question = ask(obj.shape, obj.total_mass, [flawed_trial(obj, a, feet, draw, rng) for a in actions])
    assert isinstance(question, Question)
    first, share = question.first, obj.group_mass / obj.total_mass
    off, other = ((first.inertia.numpy() - first.spins.numpy() @ x) ** 2 for x in (share, share[::-1]))
    assert len(off) == 3 and off.mean() < 4 < other.mean()


@pytest.mark.slow
def test_examples_are_padded_and_joined_without_loss(tmp_path):
    small, large = (drawn(k, SEED, "corners", (k, k), least_grasps=1) for k in (2, 4))
    questions = [ask(obj.shape, obj.total_mass, lab_trials(obj, k)) for k, obj in ((1, small), (3, large))]
    alone = [Examples.of([question]) for question in questions if isinstance(question, Question)]
    joined = Examples.joined(alone)
    assert joined.groups.sum(1).tolist() == [2, 4] and joined.windows.sum(1).tolist() == [2, 6]
    assert_allclose(joined.mean[0, :2], alone[0].mean[0])
    assert_allclose(torch.linalg.cholesky(joined.covariance)[0, 2:, 2:], np.eye(2))
    save_examples(tmp_path / "part.pt", joined, 1.5)
    back, seconds = load_examples(tmp_path / "part.pt")
    assert seconds == 1.5 and all(torch.equal(getattr(back, name), value) for name, value in vars(joined).items())


def test_without_a_checkpoint_the_error_names_the_command(tmp_path):
    pytest.importorskip("zuko", reason="needs the extra learned")
    missing: dict[str, Any] = {"checkpoint": str(tmp_path / "none.pt")}
    for call in (
        lambda: check_installed("learned", missing),
        lambda: Learned(**missing).estimate(drawn_object(0).shape, 1.0, [], 0),
    ):
        with pytest.raises(InvalidValueError, match=r"Learned\.checkpoint.*none\.pt.*heft learn"):
            call()
    assert code_of("learned", missing) == {"file": ""}
