"""What every estimator must do: run on each of them, our own and others'."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from analytic_world import accelerated, drawn_object, turns
from numpy.testing import assert_allclose

from estimators.protocol import Estimator
from testbed.objects import ObjectModel, ObjectShape
from testbed.trajectory import Trajectory


def data(obj: ObjectModel) -> list[Trajectory]:
    """Turns and accelerated turns about every grasp, with a little noise."""
    return turns(obj, noise=0.02) + accelerated(obj, noise=0.02)


def answers_in_the_shapes_groups(estimator: Estimator) -> None:
    obj = drawn_object(0)
    answer = estimator.estimate(obj.shape, obj.total_mass, data(obj), 0)
    assert answer.status == "ok"
    assert answer.distribution is not None
    assert answer.distribution.mass.shape == (obj.shape.n_m,)
    assert answer.distribution.friction.shape == (obj.shape.n_mu,)
    assert answer.covariance is None or answer.covariance.shape == (obj.shape.n_m, obj.shape.n_m)
    assert answer.seconds > 0


def gives_the_same_answer_to_the_same_seed(estimator: Estimator) -> None:
    obj = drawn_object(1)
    first, second = (estimator.estimate(obj.shape, obj.total_mass, data(obj), 7).distribution for _ in range(2))
    assert first is not None
    assert second is not None
    assert np.array_equal(first.mass, second.mass)
    assert np.array_equal(first.friction, second.friction)


def doubles_the_masses_when_all_wrenches_double(estimator: Estimator) -> None:
    obj = drawn_object(1)
    twice = [replace(t, wrench_on_object_world=2 * t.wrench_on_object_world) for t in data(obj)]
    once = estimator.estimate(obj.shape, obj.total_mass, data(obj), 0).distribution
    double = estimator.estimate(obj.shape, 2 * obj.total_mass, twice, 0).distribution
    assert once is not None
    assert double is not None
    assert_allclose(double.mass, 2 * once.mass, rtol=0.02, atol=0.01 * once.mass.max())
    assert_allclose(double.friction, once.friction, rtol=0.02)


def does_not_care_for_the_order_of_particles_and_groups(estimator: Estimator) -> None:
    obj = drawn_object(0)
    rng = np.random.default_rng(0)
    particles, groups = rng.permutation(len(obj.shape.particles)), rng.permutation(obj.shape.n_m)
    place = np.argsort(groups)
    shuffled = ObjectShape(
        particles=obj.shape.particles[particles],
        mass_group=place[obj.shape.mass_group[particles]],
        friction_group=obj.shape.friction_group[particles],
        cell=obj.shape.cell,
        height=obj.shape.height,
        grasps=obj.shape.grasps,
    )
    straight = estimator.estimate(obj.shape, obj.total_mass, data(obj), 0).distribution
    mixed = estimator.estimate(shuffled, obj.total_mass, data(obj), 0).distribution
    assert straight is not None
    assert mixed is not None
    assert_allclose(mixed.mass, straight.mass[groups], rtol=1e-5, atol=1e-7)


def takes_extra_trajectories(estimator: Estimator) -> None:
    obj = drawn_object(2)
    failed = replace(data(obj)[0], status="slipped", reason="it slipped")
    answer = estimator.estimate(obj.shape, obj.total_mass, [*data(obj), failed, *data(obj)[::-1]], 0)
    assert answer.status == "ok"


def says_so_when_there_is_too_little(estimator: Estimator) -> None:
    obj = drawn_object(0)
    for too_little in ([], turns(obj)[:1]):
        answer = estimator.estimate(obj.shape, obj.total_mass, too_little, 0)
        assert answer.status != "ok"
        assert answer.message


CONFORMANCE: tuple[Callable[[Estimator], None], ...] = (
    answers_in_the_shapes_groups,
    gives_the_same_answer_to_the_same_seed,
    doubles_the_masses_when_all_wrenches_double,
    does_not_care_for_the_order_of_particles_and_groups,
    takes_extra_trajectories,
    says_so_when_there_is_too_little,
)
