"""The conformance kit on the estimator that `--estimator` names."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import pytest

from estimators.protocol import Estimator
from estimators.testing.analytic_world import drawn_object
from estimators.testing.conformance import CONFORMANCE, WITHOUT_DRAWS, Draw, data, small_object
from estimators.testing.plugin import BLOCKS, SENSORS
from estimators.testing.recorded import KnownBlock
from estimators.testing.recovery import recovers
from testbed.trajectory import Trajectory


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """Which blocks are met under which sensors."""
    if metafunc.function is test_known_block:
        met = cases(thorough=bool(metafunc.config.getoption("--estimator-thorough")))
        mark = pytest.mark.parametrize(("known_block", "sensing"), met, indirect=True, scope="session")
        metafunc.definition.add_marker(mark)  # in place of what the fixtures would give: every block, every sensor


def cases(*, thorough: bool) -> list[tuple[str, str]]:
    """Every block under a perfect sensor and under one of the others, in turn: each is met on both supports; or all."""
    perfect, *others = SENSORS
    if thorough:
        return [(block, sensing) for block in BLOCKS for sensing in SENSORS]
    turn = [others[(i // 2 + i % 2) % len(others)] for i in range(len(BLOCKS))]  # a block has a place for each support
    return [(block, sensing) for block, other in zip(BLOCKS, turn, strict=True) for sensing in (perfect, other)]


def told(check: Callable[[], None], what: str = "") -> None:
    """Run a check; a breach ends in words, anything else with its traceback."""
    breach = None
    try:
        check()
    except AssertionError as error:
        breach = str(error).partition("\nassert ")[0]  # the sentence; what pytest makes of the line is left out
    if breach is not None:
        pytest.fail(f"{what}{breach}", pytrace=False)


@pytest.fixture(scope="session")
def draw(pytestconfig: pytest.Config) -> Draw:
    """The objects that rules are held against."""
    return small_object if pytestconfig.getoption("--estimator-small") else drawn_object


@pytest.mark.parametrize("rule", CONFORMANCE, ids=lambda rule: rule.__name__)
def test_rule(estimator: Estimator, rule: Callable[..., None], draw: Draw) -> None:
    told(partial(rule, estimator, draw), f"{rule.__doc__}\n")


@pytest.mark.parametrize("rule", WITHOUT_DRAWS, ids=lambda rule: rule.__name__)
def test_rule_for_methods_that_draw_nothing(estimator: Estimator, rule: Callable[..., None], draw: Draw) -> None:
    obj = draw(0)
    first, second = (estimator.estimate(obj.shape, obj.total_mass, data(obj), seed).distribution for seed in (0, 1))
    if first is None or second is None or not np.array_equal(first.mass, second.mass):
        pytest.skip("another seed gives another answer: it draws, and to what draws, a group is its place in the draw")
    told(partial(rule, estimator, draw), f"{rule.__doc__}\n")


def test_known_block(
    estimator: Estimator,
    known_block: KnownBlock,
    sensing: str,
    recorded_trials: list[Trajectory],
    pytestconfig: pytest.Config,
) -> None:
    claims = str(pytestconfig.getoption("--estimator-support"))
    if claims not in (known_block.support, "both"):
        pytest.skip(f"not claimed: {known_block.support}")
    slack: Any = pytestconfig.getoption("--estimator-slack")
    told(partial(recovers, estimator, known_block, sensing, recorded_trials, slack, claims))
