"""Scenario files, studies of many trials and estimates, their results on disk, and the `heft` command.

The names below load their module on first use: `import scenarios` by itself costs nothing.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from scenarios.config import Scenario, load_scenario, scenario_names
    from scenarios.results.estimates import load_estimate, load_results, load_trajectories
    from scenarios.study.run import run_scenario

_MODULES = {
    "config": (
        "Scenario",
        "load_scenario",
        "scenario_names",
    ),
    "results.estimates": (
        "load_estimate",
        "load_results",
        "load_trajectories",
    ),
    "study.run": ("run_scenario",),
}
_MODULE_OF = {name: f"{__name__}.{module}" for module, names in _MODULES.items() for name in names}

__all__ = [
    "Scenario",
    "load_estimate",
    "load_results",
    "load_scenario",
    "load_trajectories",
    "run_scenario",
    "scenario_names",
]


def __getattr__(name: str) -> Any:
    if name not in _MODULE_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_MODULE_OF[name]), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
