"""heft's packages: lazy public names, and a check for other packages with the same names.

Standard library only, compatible with Python 3.8.
"""

from __future__ import annotations

import ast
import sys
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Callable, Dict, List, Tuple  # noqa: UP035  (Python 3.8 reads this package too)

PACKAGES = ("testbed", "estimators", "viz", "scenarios")
"""Import names of heft."""


def hidden_package() -> str | None:
    """Message for the first of heft's packages that another package of its name hides; None if there is none."""
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


def lazy_names(package: str) -> Tuple[Callable[[str], Any], Callable[[], List[str]]]:  # noqa: UP006
    """`__getattr__` and `__dir__` of a package whose public names are the imports of its `if TYPE_CHECKING` block."""
    modules: Dict[str, str] = {}  # noqa: UP006

    def listed() -> Dict[str, str]:  # noqa: UP006
        if not modules:
            source = Path(str(sys.modules[package].__file__)).read_text(encoding="utf-8")
            for node in ast.walk(ast.parse(source)):
                if isinstance(node, ast.ImportFrom) and str(node.module).startswith(f"{package}."):
                    modules.update({alias.name: str(node.module) for alias in node.names})
        return modules

    def get(name: str) -> Any:
        if name.startswith("__") or name not in listed():
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        return getattr(import_module(listed()[name]), name)

    def names() -> List[str]:  # noqa: UP006
        return sorted({*vars(sys.modules[package]), *listed()})

    return get, names
