"""Scenario files, studies of many trials and estimates, their results on disk, and the `heft` command.

The names below load their module on first use: `import scenarios` by itself costs nothing.
"""

from typing import TYPE_CHECKING

from testbed.packages import lazy_names

if TYPE_CHECKING:
    from scenarios.catalog import scenario_names
    from scenarios.config import Scenario, load_scenario
    from scenarios.results.estimates import load_estimate, load_results, load_trajectories
    from scenarios.study.run import run_scenario
    from scenarios.views.show import show


__all__ = [
    "Scenario",
    "load_estimate",
    "load_results",
    "load_scenario",
    "load_trajectories",
    "run_scenario",
    "scenario_names",
    "show",
]

__getattr__, __dir__ = lazy_names(__name__)
