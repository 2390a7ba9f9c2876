"""Plugins: classes of other packages, found by "package:Class" or by entry point, and constructed from settings.

A file may name such a class, but reading the file imports nothing: `check_name` checks the name alone. `find_class`
imports from Python's search path, which contains the current folder only after `find_code_here`.
"""

from __future__ import annotations

import hashlib
import importlib
import inspect
import json
import os
import re
import sys
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import contextmanager, redirect_stdout, suppress
from dataclasses import dataclass
from functools import lru_cache
from importlib.metadata import entry_points
from pathlib import Path
from traceback import extract_tb
from types import ModuleType, NoneType, UnionType
from typing import Any, Generic, Literal, TypeVar, Union, get_args, get_origin

from pydantic import TypeAdapter, ValidationError

from testbed.errors import HeftError, InvalidValueError, listed, nearest, one_line
from testbed.trial import TrialRunner
from testbed.validation import arguments_of

T = TypeVar("T")
_MOST_LISTED = 12
_PLAIN = (bool, int, float, str, NoneType)
_PATH = re.compile(r"[^\W\d]\w*(\.[^\W\d]\w*)*:[^\W\d]\w*")


@dataclass(frozen=True)
class Role(Generic[T]):
    """Kind of plugin: its protocol, and its group of entry points."""

    protocol: str
    """Import path of the protocol."""
    calls: tuple[str, ...]
    """Methods of the protocol with their arguments."""
    group: str
    """Entry-point group of the classes."""
    example: str
    """Example of "package:Class" for error messages."""


RUNNER: Role[TrialRunner] = Role(
    "testbed.trial.TrialRunner",
    ("__enter__(self)", "__exit__(self, kind, error, trace)", "run(self, trial)"),
    "heft.runners",
    "my_bench:DragBench",
)


def installed(role: Role[Any]) -> dict[str, str]:
    """Paths "package:Class" of the installed classes of a role, by the names of their entry points."""
    return {point.name: point.value for point in sorted(entry_points(group=role.group), key=lambda point: point.name)}


def find_code_here() -> None:
    """Append the current folder to the search path of this Python and of the workers that it starts."""
    if not {"", os.getcwd()} & {*sys.path}:
        sys.path.append(os.getcwd())


def check_name(
    name: str, role: Role[Any], field: str, known: Collection[str] = (), also: str = "or package:Class"
) -> None:
    """Check that a class may have this name; nothing is imported.

    Args:
        name: name of an entry point, or "package.module:Class", as the user gave it.
        role: role of the class.
        field: field of the name in an error.
        known: names other than those of entry points, for the error.
        also: other allowed values, for the error.

    Raises:
        InvalidValueError: neither a name of an entry point nor a path of a class.
    """
    if ":" in name:
        if not _PATH.fullmatch(name):
            raise InvalidValueError(field, name, f'"package.module:Class", such as {role.example}')
        return
    others = installed(role)
    if name not in others:
        names = [*known, *others]
        listed = f"one of {', '.join(names)}{nearest(name, names)}, " if names else ""
        raise InvalidValueError(field, name, listed + (also if names else also.removeprefix("or ")))


def find_class(
    name: str, role: Role[T], field: str, known: Collection[str] = (), also: str = "or package:Class"
) -> type[T]:
    """Import the class of a name or a path; arguments as for `check_name`.

    Raises:
        InvalidValueError: as `check_name` and `load_class`.
    """
    check_name(name, role, field, known, also)
    if ":" in name:
        return load_class(name, role, field)
    return load_class(installed(role)[name], role, f"{field} ({name})")


def load_class(path: str, role: Role[T], field: str) -> type[T]:
    """Import the class of a path "package.module:Class".

    Args:
        path: path as the user gave it.
        role: role of the class.
        field: field of the path in an error.

    Raises:
        InvalidValueError: no such module or class, or a class without the role's protocol.
    """
    check_name(path, role, field)
    name, _, attribute = path.partition(":")
    module = _imported(name, path, field)
    kind = getattr(module, attribute, None)
    if kind is None:
        own = _classes_of(module)
        known = f"a class of {name}: {listed(own, _MOST_LISTED) or 'it defines none'}{nearest(attribute, own)}"
        raise InvalidValueError(field, path, known)
    if wrong := _breach(kind, role):
        raise InvalidValueError(field, path, f"a class with {' and '.join(role.calls)}, as {role.protocol}; {wrong}")
    return kind


def _classes_of(module: ModuleType) -> list[str]:
    """Public classes that a package defines, those of lazy names too."""
    own = []
    for key in (key for key in dir(module) if not key.startswith("_")):
        with suppress(Exception), redirect_stdout(sys.stderr):  # a lazy name imports a module, which may raise anything
            value = getattr(module, key)
            if isinstance(value, type) and f"{value.__module__}.".startswith(f"{module.__name__}."):
                own.append(key)
    return own


def configured(
    kind: Callable[..., T],
    settings: Mapping[str, Any],
    field: str,
    beside: tuple[str, ...] = (),
    given: Mapping[str, Any] | None = None,
) -> T:
    """Construct an object from its settings, which are the arguments of its class.

    Args:
        kind: the class.
        settings: settings from a file or a command line; a list becomes a tuple.
        field: field of the settings in an error.
        beside: other names that are allowed in the same table, for the error.
        given: arguments that heft itself passes if the class takes them; they are not settings.

    Raises:
        InvalidValueError: an unknown or missing setting, or a value that the class refuses.
    """
    arguments = inspect.signature(kind).parameters.values()
    named = [a.name for a in arguments if a.kind in (a.POSITIONAL_OR_KEYWORD, a.KEYWORD_ONLY)]
    filled = {name: value for name, value in (given or {}).items() if name in named}
    known = [name for name in named if name not in filled]
    any_name = any(a.kind is a.VAR_KEYWORD for a in arguments)
    if (unknown := sorted(set(settings) - set(known))) and not any_name:
        allowed = f"settings {', '.join([*beside, *known]) or '(it has none)'}{nearest(unknown[0], known)}"
        if filled:
            allowed += f"; heft itself gives {', '.join(filled)}"
        raise InvalidValueError(field, ", ".join(unknown), allowed)
    if missing := [a.name for a in arguments if a.name in known and a.default is a.empty and a.name not in settings]:
        raise InvalidValueError(field, dict(settings), f"settings {', '.join(missing)} as well: they have no default")
    annotations = arguments_of(kind)[0]
    for name, value in settings.items():
        if name in annotations:
            _check_type(field, name, annotations[name][0], value)
    try:
        return kind(**{key: tuple(v) if isinstance(v, list) else v for key, v in settings.items()}, **filled)
    except InvalidValueError:
        raise
    except (TypeError, ValueError) as error:  # a table where a number belongs
        raise InvalidValueError(field, dict(settings), f"values of the settings' types ({error})") from None


def _check_type(field: str, name: str, annotation: Any, value: object) -> None:
    """Check a setting whose annotation is a number, a text, a bool, None, a Literal, or a union of these."""
    parts = get_args(annotation) if get_origin(annotation) in (Union, UnionType) else (annotation,)
    if all(part in _PLAIN or get_origin(part) is Literal for part in parts):
        try:
            TypeAdapter(annotation).validate_python(value, strict=True)
        except ValidationError as error:
            types = "; ".join(each["msg"].removeprefix("Input should be ") for each in error.errors())
            raise InvalidValueError(field, {name: value}, f"values of the settings' types ({name}: {types})") from None


def settings_of(kind: Callable[..., Any]) -> list[str]:
    """Settings of a class in the form of a scenario: `name = default`, or the name alone without a default."""
    named = [a for a in inspect.signature(kind).parameters.values() if a.kind not in (a.VAR_POSITIONAL, a.VAR_KEYWORD)]
    return [a.name if a.default is a.empty else f"{a.name} = {json.dumps(a.default, default=str)}" for a in named]


@lru_cache
def source_hash(kind: type[Any]) -> str:
    """Hash of the source of a class: of all modules of its package, or of its single module.

    It is part of the key of stored answers, so that a changed class is run again.
    """
    return hashlib.sha256(b"\0".join(file.read_bytes() for file in _files_of(kind))).hexdigest()[:20]


def _files_of(kind: type[Any]) -> list[Path]:
    """Source files of a class's package, or of its single module."""
    top = sys.modules[kind.__module__.partition(".")[0]]
    folders = [Path(folder) for folder in getattr(top, "__path__", ())]
    if not folders and getattr(top, "__file__", None):
        return [Path(str(top.__file__))]
    return [file for folder in folders for file in sorted(folder.rglob("*.py"))]


@contextmanager
def placed_errors(kind: type[Any], call: str = "", *, unless: tuple[type[Exception], ...] = ()) -> Iterator[None]:
    """Turn an error inside a plugin's class into a message in one line, with the file and line of its code.

    Args:
        kind: the class.
        call: name of the call, as the beginning of the message.
        unless: errors that are raised unchanged.

    Raises:
        HeftError: the message; its cause is the error.
    """
    try:
        yield
    except unless:
        raise
    except (Exception, SystemExit) as error:
        frames, own = extract_tb(error.__traceback__), {str(file) for file in _files_of(kind)}
        frame = next((frame for frame in reversed(frames) if frame.filename in own), frames[-1])
        path = Path(frame.filename)
        place = f"{path.relative_to(Path.cwd()) if path.is_relative_to(Path.cwd()) else path}, line {frame.lineno}"
        prefix = f"{call} ends in " if call else ""
        raise HeftError(f"{prefix}{type(error).__name__}: {one_line(str(error))} ({place})") from error


def _imported(name: str, path: str, field: str) -> Any:
    if name not in sys.modules:
        importlib.invalidate_caches()
    try:
        with redirect_stdout(sys.stderr):  # keep its output out of heft's tables
            return importlib.import_module(name)
    except ModuleNotFoundError as error:
        missing = error.name or name
        if f"{name}.".startswith(f"{missing}."):
            allowed = f"a module that this Python finds; there is no {missing}"
            top = missing.partition(".")[0]
            if Path(f"{top}.py").is_file() or Path(top).is_dir():
                allowed += (
                    ", only one in the current folder: --allow-code (heft run, estimate) or PYTHONPATH=. lets it in"
                )
        else:
            allowed = f"a module that can be imported; {name} needs {missing}, which is not installed"
        raise InvalidValueError(field, path, allowed) from None
    except HeftError:  # the error of a missing driver names the package to install
        raise
    except Exception as error:
        allowed = f"a module that can be imported; {name} ends in {type(error).__name__}: {error}"
        raise InvalidValueError(field, path, allowed) from error


def _breach(kind: Any, role: Role[Any]) -> str:
    """Reason why an object is not a class of a role; empty if it is one."""
    if not inspect.isclass(kind):
        return f"this is a {type(kind).__name__}"
    if inspect.isabstract(kind):
        return f"{kind.__name__} is abstract"
    for call in role.calls:
        name = call.partition("(")[0]
        method = getattr(kind, name, None)
        if not callable(method):
            return f"{kind.__name__} has no {name}"
        if inspect.iscoroutinefunction(method):
            return f"{kind.__name__} has an async {name}, for which nothing waits"
        try:
            inspect.signature(method).bind(*[None] * (call.count(",") + 1))
        except TypeError:
            return f"{kind.__name__} has {name}{inspect.signature(method)}"
    return ""
