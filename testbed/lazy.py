"""Public names of a package that load their module on first use. Standard library only, and fit for Python 3.8."""

import ast
import sys
from importlib import import_module
from pathlib import Path
from typing import Any, Callable, Dict, List, Tuple  # noqa: UP035  (Python 3.8 reads this package too)


def lazy_names(package: str) -> Tuple[Callable[[str], Any], Callable[[], List[str]]]:  # noqa: UP006
    """`__getattr__` and `__dir__` of a package that lists its public names once, in its `if TYPE_CHECKING` block."""
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
