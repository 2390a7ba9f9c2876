"""Classes from outside the house: found by "package:Class" or by entry point, with nothing to register, and set up.

A file may name such a class, but reading it imports nothing: `check_name` looks at the name alone. `find_class` imports
from where this Python finds its modules; the current folder is one of these places only after `find_code_here`.
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
from contextlib import contextmanager, redirect_stdout
from dataclasses import dataclass
from functools import lru_cache
from importlib.metadata import entry_points
from pathlib import Path
from traceback import extract_tb
from types import NoneType, UnionType
from typing import Any, Generic, Literal, TypeVar, Union, get_args, get_origin

from pydantic import TypeAdapter, ValidationError

from testbed.errors import HeftError, InvalidValueError, nearest, one_line
from testbed.trial import TrialRunner
from testbed.validation import arguments_of

T = TypeVar("T")
_PLAIN = (bool, int, float, str, NoneType)
_PATH = re.compile(r"[^\W\d]\w*(\.[^\W\d]\w*)*:[^\W\d]\w*")


@dataclass(frozen=True)
class Role(Generic[T]):
    """A kind of class that others can bring: its protocol, and the entry points that name such classes."""

    protocol: str
    """Import path of the protocol that it fulfils."""
    calls: tuple[str, ...]
    """Methods of the protocol, as they are called."""
    group: str
    """Entry-point group of such classes."""
    example: str
    """A path for error messages, "package:Class"."""


RUNNER: Role[TrialRunner] = Role(
    "testbed.trial.TrialRunner",
    ("__enter__(self)", "__exit__(self, kind, error, trace)", "run(self, trial)"),
    "heft.runners",
    "my_bench:DragBench",
)


def installed(role: Role[Any]) -> dict[str, str]:
    """ "package:Class" of every installed class of a role, by its entry point's name."""
    return {point.name: point.value for point in sorted(entry_points(group=role.group), key=lambda point: point.name)}


def find_code_here() -> None:
    """Let this Python, and the workers that it starts, find modules of the current folder: after all others."""
    if not {"", os.getcwd()} & {*sys.path}:
        sys.path.append(os.getcwd())


def check_name(
    name: str, role: Role[Any], field: str, known: Collection[str] = (), also: str = "or package:Class"
) -> None:
    """Check that a class may have this name; nothing is imported.

    Args:
        name: of an entry point, or "package.module:Class", as the user gave it.
        role: what it is to be.
        field: what to call it in an error.
        known: names beside those of entry points, for the error.
        also: what else is allowed, for the error.

    Raises:
        InvalidValueError: neither.
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
    """The class that a name or a path stands for; arguments as `check_name`.

    Raises:
        InvalidValueError: what `check_name` or `load_class` says.
    """
    check_name(name, role, field, known, also)
    if ":" in name:
        return load_class(name, role, field)
    return load_class(installed(role)[name], role, f"{field} ({name})")


def load_class(path: str, role: Role[T], field: str) -> type[T]:
    """The class behind "package.module:Class", of a module that Python finds.

    Args:
        path: as the user gave it.
        role: what it is to be.
        field: what to call it in an error.

    Raises:
        InvalidValueError: no such module, no such class, or not of the role's protocol.
    """
    check_name(path, role, field)
    name, _, attribute = path.partition(":")
    module = _imported(name, path, field)
    kind = getattr(module, attribute, None)
    if kind is None:
        own = [key for key, value in vars(module).items() if inspect.isclass(value) and value.__module__ == name]
        known = f"a class of {name}: {', '.join(own) or 'it defines none'}{nearest(attribute, own)}"
        raise InvalidValueError(field, path, known)
    if wrong := _breach(kind, role):
        raise InvalidValueError(field, path, f"a class with {' and '.join(role.calls)}, as {role.protocol}; {wrong}")
    return kind


def configured(
    kind: Callable[..., T],
    settings: Mapping[str, Any],
    field: str,
    beside: tuple[str, ...] = (),
    given: Mapping[str, Any] | None = None,
) -> T:
    """An object with its settings, which are the arguments of its class.

    Args:
        kind: the class.
        settings: as a file or a command line has them; a list becomes a tuple.
        field: what to call them in an error.
        beside: what may stand beside them where they are written, for the error.
        given: arguments that heft fills in, where the class takes them; they are no settings.

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
    """Check a setting whose annotation is a number, a text, a bool or one of some words, or None beside them."""
    parts = get_args(annotation) if get_origin(annotation) in (Union, UnionType) else (annotation,)
    if all(part in _PLAIN or get_origin(part) is Literal for part in parts):
        try:
            TypeAdapter(annotation).validate_python(value, strict=True)
        except ValidationError as error:
            types = "; ".join(each["msg"].removeprefix("Input should be ") for each in error.errors())
            raise InvalidValueError(field, {name: value}, f"values of the settings' types ({name}: {types})") from None


def settings_of(kind: Callable[..., Any]) -> list[str]:
    """The settings of a class as a scenario has them: `name = default`, or the name alone where there is no default."""
    named = [a for a in inspect.signature(kind).parameters.values() if a.kind not in (a.VAR_POSITIONAL, a.VAR_KEYWORD)]
    return [a.name if a.default is a.empty else f"{a.name} = {json.dumps(a.default, default=str)}" for a in named]


@lru_cache
def source_hash(kind: type[Any]) -> str:
    """Hash of the source that a class is made of: of every module of its package, or of its one module.

    What it answers is kept under it, so that a changed class is asked again.
    """
    return hashlib.sha256(b"\0".join(file.read_bytes() for file in _files_of(kind))).hexdigest()[:20]


def _files_of(kind: type[Any]) -> list[Path]:
    """Source files of a class's package, or its one module."""
    top = sys.modules[kind.__module__.partition(".")[0]]
    folders = [Path(folder) for folder in getattr(top, "__path__", ())]
    if not folders and getattr(top, "__file__", None):
        return [Path(str(top.__file__))]
    return [file for folder in folders for file in sorted(folder.rglob("*.py"))]


@contextmanager
def placed_errors(kind: type[Any], call: str = "", *, unless: tuple[type[Exception], ...] = ()) -> Iterator[None]:
    """Turn an error inside another's class into one line that names the file and the line of their code.

    Args:
        kind: the class.
        call: what was called, to begin the line with.
        unless: errors that are passed on as they are.

    Raises:
        HeftError: the line; its cause is the error.
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
        begin = f"{call} ends in " if call else ""
        raise HeftError(f"{begin}{type(error).__name__}: {one_line(str(error))} ({place})") from error


def _imported(name: str, path: str, field: str) -> Any:
    if name not in sys.modules:
        importlib.invalidate_caches()
    try:
        with redirect_stdout(sys.stderr):  # what it prints is no table of heft's
            return importlib.import_module(name)
    except ModuleNotFoundError as error:
        missing = error.name or name
        if f"{name}.".startswith(f"{missing}."):
            why = f"a module that this Python finds; there is no {missing}"
            top = missing.partition(".")[0]
            if Path(f"{top}.py").is_file() or Path(top).is_dir():
                why += ", only one in the current folder: --allow-code (heft run, estimate) or PYTHONPATH=. lets it in"
        else:
            why = f"a module that can be imported; {name} needs {missing}, which is not installed"
        raise InvalidValueError(field, path, why) from None
    except HeftError:  # a missing driver says what to install
        raise
    except Exception as error:
        why = f"a module that can be imported; {name} ends in {type(error).__name__}: {error}"
        raise InvalidValueError(field, path, why) from error


def _breach(kind: Any, role: Role[Any]) -> str:
    """The reason that something is no class of a role, else empty."""
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
