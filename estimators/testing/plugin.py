"""The pytest plugin: options that name an estimator, and known blocks as fixtures for other tests.

Every pytest run loads this plugin where heft is installed, so it imports heft only on demand.
"""

from __future__ import annotations

import argparse
import tomllib
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from estimators.base import Estimator
    from estimators.testing.recorded import KnownBlock
    from testbed.trajectory import Trajectory

BLOCKS = sorted(path.stem for path in (Path(__file__).parent / "blocks").glob("*.parquet"))
SENSORS = ("ideal", "ft300s", "low", "moderate", "high")
_ESTIMATOR = pytest.StashKey[Any]()

pytest.register_assert_rewrite("estimators.testing.conformance")


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the options that name an estimator and what is required of it."""
    group = parser.getgroup("heft", "an estimator held to heft's rules: pytest --pyargs estimators.testing")
    group.addoption("--estimator", metavar="PACKAGE:CLASS", help="the estimator; or its entry point, or heft's own")
    group.addoption("--estimator-settings", metavar="TOML", default="", help='as "iterations = 60, use_weight = true"')
    group.addoption(
        "--estimator-support",
        choices=("own_weight", "rigid", "both"),
        default="both",
        help="support of the blocks that the estimator claims to know (default: both)",
    )
    group.addoption(
        "--estimator-slack", metavar="X", type=_slack, default=1.0, help="factor on the allowed NAD, > 0 (default: 1)"
    )
    group.addoption("--estimator-small", action="store_true", help="small objects for the rules, for slow estimators")
    group.addoption(
        "--estimator-thorough", action="store_true", help="every block under every sensor, not under one or two of them"
    )


def _slack(text: str) -> float:
    """Factor on the allowed NAD, from the command line."""
    if not (number := float(text)) > 0:
        raise argparse.ArgumentTypeError(f"got {text!r}; allowed: a number > 0")
    return number


def pytest_configure(config: pytest.Config) -> None:
    """Build the estimator before the tests, so that an error is one line."""
    name = config.getoption("--estimator")
    if name is None:
        return
    import torch  # noqa: PLC0415

    from estimators.registry import class_of  # noqa: PLC0415
    from testbed.errors import InvalidValueError  # noqa: PLC0415
    from testbed.plugins import configured, find_code_here  # noqa: PLC0415

    torch.set_num_threads(1)
    find_code_here()  # named on the command line
    given = config.getoption("--estimator-settings")
    try:
        settings = tomllib.loads(f"of = {{ {given} }}")["of"]
    except tomllib.TOMLDecodeError:
        allowed = 'settings as TOML, such as "iterations = 60, use_weight = true"'
        raise pytest.UsageError(f"--estimator-settings: got {given!r}; allowed: {allowed}") from None
    try:
        config.stash[_ESTIMATOR] = configured(
            class_of(str(name), "--estimator", "or package:Class"), settings, "--estimator-settings"
        )
    except InvalidValueError as error:
        raise pytest.UsageError(str(error)) from None


@pytest.fixture(scope="session")
def estimator(pytestconfig: pytest.Config) -> Estimator:
    """The estimator that `--estimator` names."""
    if _ESTIMATOR not in pytestconfig.stash:
        pytest.exit("which estimator? --estimator package:Class", returncode=pytest.ExitCode.USAGE_ERROR)
    return pytestconfig.stash[_ESTIMATOR]


@pytest.fixture(scope="session", params=BLOCKS)
def known_block(request: pytest.FixtureRequest) -> KnownBlock:
    """A known block; each in turn, or those named with `parametrize("known_block", [...], indirect=True)`."""
    from estimators.testing.recorded import load_block  # noqa: PLC0415

    return load_block(request.param)


@pytest.fixture(scope="session", params=SENSORS)
def sensing(request: pytest.FixtureRequest) -> str:
    """A sensing preset; each in turn, or those named with `parametrize("sensing", [...], indirect=True)`."""
    return request.param


@pytest.fixture
def recorded_trials(known_block: KnownBlock, sensing: str) -> list[Trajectory]:
    """Trials of the known block with the errors of that sensor, as an estimator gets them."""
    return known_block.trials(sensing)
