"""heft's packages have common names: a check for another package of the same name that Python finds first."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path

PACKAGES = ("testbed", "estimators", "viz", "scenarios")
"""Import names of heft."""


def hidden_package() -> str | None:
    """The first package of heft that another of its name hides, as a line for the user; None if all four are heft's."""
    root = Path(__file__).resolve().parent.parent
    for name in PACKAGES:
        spec = find_spec(name)
        found = Path(spec.origin).resolve() if spec and spec.origin and spec.origin != "namespace" else None
        if found is not None and found.parent != root / name:
            return (
                f"{found if found.stem != '__init__' else found.parent} hides heft's package {name}: "
                "rename it, or run from a folder without it"
            )
    return None
