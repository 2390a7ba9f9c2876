"""The conformance kit on the estimator that `--estimator` names."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from itertools import cycle, product
from traceback import extract_tb
from typing import Any

import numpy as np
import pytest

from estimators.base import Estimator
from estimators.testing.analytic_world import drawn_object
from estimators.testing.conformance import (
    CONFORMANCE,
    WITHOUT_DRAWS,
    Draw,
    claims_errors_of_their_size,
    clean_answer,
    data,
    recovers,
    small_object,
)
from estimators.testing.plugin import BLOCKS, SENSORS
from estimators.testing.recorded import KnownBlock, load_block
from estimators.testing.truth import truth_within_reach
from testbed.trajectory import Trajectory

CLAIMED = ("I2-own_weight", "L2-own_weight", "F1-own_weight", "drawn_b-own_weight")
"""Known blocks on which claimed errors are checked."""


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """Parametrize the known blocks with sensors."""
    if metafunc.function is test_known_block:
        met = cases(thorough=bool(metafunc.config.getoption("--estimator-thorough")))
        mark = pytest.mark.parametrize(("known_block", "sensing"), met, indirect=True, scope="session")
        metafunc.definition.add_marker(mark)  # replaces the fixtures' own parameters, all blocks times all sensors


def cases(*, thorough: bool) -> list[tuple[str, str]]:
    """Pairs of block and sensor: own weight under a perfect sensor, and each block under one more in turn."""
    if thorough:
        return [(block, sensing) for block in BLOCKS for sensing in SENSORS]
    own, rigid = ([block for block in BLOCKS if block.endswith(support)] for support in ("own_weight", "rigid"))
    perfect, *others = SENSORS
    return [*product(own, [perfect]), *zip(own, cycle(others), strict=False), *zip(rigid, cycle(SENSORS), strict=False)]


_RAISED: set[tuple[str, int | None]] = set()
"""Files and lines of errors whose traceback was shown."""


def checked(check: Callable[[], Any], what: str = "") -> Any:
    """Result of a check; a breach fails with its sentence, any other error with its traceback, once for each place."""
    try:
        return check()
    except AssertionError as error:
        breach = str(error).partition("\nassert ")[0]  # without pytest's introspection
    except Exception as error:
        last = extract_tb(error.__traceback__)[-1]
        if (last.filename, last.lineno) not in _RAISED:
            _RAISED.add((last.filename, last.lineno))
            raise
        breach = f"{type(error).__name__}: {error} (traceback above)"
    pytest.fail(f"{what}{breach}", pytrace=False)


@pytest.fixture(scope="session")
def draw(pytestconfig: pytest.Config) -> Draw:
    """Objects for the rules."""
    return small_object if pytestconfig.getoption("--estimator-small") else drawn_object


@pytest.mark.parametrize("rule", CONFORMANCE, ids=lambda rule: rule.__name__)
def test_rule(estimator: Estimator, rule: Callable[..., None], draw: Draw) -> None:
    checked(partial(rule, estimator, draw), f"{rule.__doc__}\n")


@pytest.mark.parametrize("rule", WITHOUT_DRAWS, ids=lambda rule: rule.__name__)
def test_rule_for_methods_that_draw_nothing(estimator: Estimator, rule: Callable[..., None], draw: Draw) -> None:
    obj, answer = clean_answer(estimator, draw)
    first, second = answer.distribution, estimator.estimate(obj.shape, obj.total_mass, data(obj), 1).distribution
    if first is None or second is None or not np.array_equal(first.mass, second.mass):
        pytest.skip("another seed gives another answer: a draw depends on the order of the groups")
    checked(partial(rule, estimator, draw), f"{rule.__doc__}\n")


def test_no_truth_is_within_reach() -> None:
    """Trials of a known block, as `estimate` is given them, contain neither the true masses nor the clean wrench."""
    block = load_block(BLOCKS[0])
    given = {"shape": block.model.shape, "weight": block.weighed("ft300s"), "trajectories": block.trials("ft300s")}
    assert truth_within_reach(given | {"seed": 0}, block.model, block.clean) == []


def test_errors_are_of_the_size_that_is_claimed(estimator: Estimator, pytestconfig: pytest.Config) -> None:
    if pytestconfig.getoption("--estimator-support") == "rigid":
        pytest.skip("not claimed: own_weight")
    slack: Any = pytestconfig.getoption("--estimator-slack")
    blocks = [load_block(name) for name in CLAIMED]
    if not checked(partial(claims_errors_of_their_size, estimator, blocks, slack=slack)):
        pytest.skip(f"none of {len(blocks)} answers has status ok and a covariance")


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
    checked(partial(recovers, estimator, known_block, sensing, recorded_trials, slack, claims))
