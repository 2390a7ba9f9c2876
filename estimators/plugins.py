"""Estimators of other packages: found by "package:Class" or by entry point, with nothing to register, and set up."""

from __future__ import annotations

import difflib
import hashlib
import importlib
import inspect
import os
import re
import sys
from collections.abc import Iterable, Mapping
from functools import lru_cache
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any

from estimators.protocol import Estimator
from testbed.errors import InvalidValueError

GROUP = "heft.estimators"
"""Entry points of this group are methods by name."""
_PATH = re.compile(r"[^\W\d]\w*(\.[^\W\d]\w*)*:[^\W\d]\w*")
_CALL = "estimate(self, shape, weight, trajectories, seed)"


def installed() -> dict[str, str]:
    """ "package:Class" of every installed estimator, by its entry point's name."""
    return {point.name: point.value for point in sorted(entry_points(group=GROUP), key=lambda point: point.name)}


def load_estimator(path: str, field: str) -> type[Estimator]:
    """The class behind "package.module:Class"; modules of the current folder are found too.

    Args:
        path: as the user gave it.
        field: what to call it in an error.

    Raises:
        InvalidValueError: no such module, no such class, or not an `Estimator`.
    """
    if not _PATH.fullmatch(path):
        raise InvalidValueError(field, path, '"package.module:Class", such as my_estimator:LeastSquares')
    name, _, attribute = path.partition(":")
    module = _imported(name, path, field)
    kind = getattr(module, attribute, None)
    if kind is None:
        own = [key for key, value in vars(module).items() if inspect.isclass(value) and value.__module__ == name]
        known = f"a class of {name}: {', '.join(own) or 'it defines none'}{nearest(attribute, own)}"
        raise InvalidValueError(field, path, known)
    if wrong := _breach(kind):
        raise InvalidValueError(field, path, f"a class with {_CALL}, as estimators.protocol.Estimator; {wrong}")
    return kind


def configured(
    kind: type[Estimator], settings: Mapping[str, Any], field: str, beside: tuple[str, ...] = ()
) -> Estimator:
    """An estimator with its settings, which are the arguments of its class.

    Args:
        kind: the class.
        settings: as a file or a command line has them; a list becomes a tuple.
        field: what to call them in an error.
        beside: what may stand beside them where they are written, for the error.

    Raises:
        InvalidValueError: an unknown or missing setting, or a value that the class refuses.
    """
    arguments = inspect.signature(kind).parameters.values()
    known = [a.name for a in arguments if a.kind in (a.POSITIONAL_OR_KEYWORD, a.KEYWORD_ONLY)]
    any_name = any(a.kind is a.VAR_KEYWORD for a in arguments)
    if (unknown := sorted(set(settings) - set(known))) and not any_name:
        allowed = f"settings {', '.join([*beside, *known])}{nearest(unknown[0], known)}"
        raise InvalidValueError(field, ", ".join(unknown), allowed)
    if missing := [a.name for a in arguments if a.name in known and a.default is a.empty and a.name not in settings]:
        raise InvalidValueError(field, dict(settings), f"settings {', '.join(missing)} as well: they have no default")
    try:
        return kind(**{key: tuple(v) if isinstance(v, list) else v for key, v in settings.items()})
    except InvalidValueError:
        raise
    except (TypeError, ValueError) as error:  # a table where a number belongs
        raise InvalidValueError(field, dict(settings), f"values of the settings' types ({error})") from None


@lru_cache
def source_hash(kind: type[Estimator]) -> str:
    """Hash of the source that a class is made of: of every module of its package, or of its one module.

    An answer is kept under it, so that a changed estimator is asked again.
    """
    top = sys.modules[kind.__module__.partition(".")[0]]
    folders = [Path(folder) for folder in getattr(top, "__path__", ())]
    files = [file for folder in folders for file in sorted(folder.rglob("*.py"))]
    if not folders and top.__file__:
        files = [Path(top.__file__)]
    return hashlib.sha256(b"\0".join(file.read_bytes() for file in files)).hexdigest()[:20]


def nearest(name: str, names: Iterable[str]) -> str:
    """ " (nearest: ...)" for a name that is nearly one of `names`, else nothing."""
    folded = {known.casefold(): known for known in names}
    close = difflib.get_close_matches(name.casefold(), folded, n=1, cutoff=0.5)
    return f" (nearest: {folded[close[0]]})" if close else ""


def _imported(name: str, path: str, field: str) -> Any:
    here = os.getcwd()
    if not {"", here} & {*sys.path}:
        sys.path.append(here)  # the `heft` command does not look where it was called, as `python` does
    importlib.invalidate_caches()
    try:
        return importlib.import_module(name)
    except ModuleNotFoundError as error:
        missing = error.name or name
        if f"{name}.".startswith(f"{missing}."):
            why = f"a module that is installed or lies in {here}; there is no {missing}"
        else:
            why = f"a module that can be imported; {name} needs {missing}, which is not installed"
        raise InvalidValueError(field, path, why) from None
    except Exception as error:
        why = f"a module that can be imported; {name} ends in {type(error).__name__}: {error}"
        raise InvalidValueError(field, path, why) from error


def _breach(kind: Any) -> str:
    """What keeps something from being an estimator's class; empty where nothing does."""
    if not inspect.isclass(kind):
        return f"this is a {type(kind).__name__}"
    if inspect.isabstract(kind):
        return f"{kind.__name__} is abstract"
    estimate = getattr(kind, "estimate", None)
    if not callable(estimate):
        return f"{kind.__name__} has no estimate"
    try:
        inspect.signature(estimate).bind(*[None] * 5)
    except TypeError:
        return f"{kind.__name__} has estimate{inspect.signature(estimate)}"
    return ""
