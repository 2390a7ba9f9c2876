"""heft: public names of testbed, estimators, viz and scenarios in one package.

A name loads its module on first use: `import heft` alone loads nothing but the standard library.
"""

from typing import TYPE_CHECKING, Any

import estimators
import scenarios
import testbed
import viz

if TYPE_CHECKING:
    from estimators import *
    from scenarios import *
    from testbed import *
    from viz import *

__all__: list[str] = []
__all__ += testbed.__all__
__all__ += estimators.__all__
__all__ += viz.__all__
__all__ += scenarios.__all__


def __getattr__(name: str) -> Any:
    for package in (testbed, estimators, viz, scenarios):
        if name in package.__all__:
            return getattr(package, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
