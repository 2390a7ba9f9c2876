"""Logs as messages by topic: MCAP files with JSON messages, and ROS 2 bags without ROS."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import fields, is_dataclass
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from testbed.importers.columns import TimeMap
from testbed.importers.logs import LogError, Series, factor, in_order, read_all, unknown

JOINT_STATE = "sensor_msgs/JointState"
_STAMP = "header.stamp"
_SECOND = 1_000_000_000
_NANOSECONDS = ("nanosec", "nsec")
_NOT_THERE = (KeyError, IndexError, ValueError, AttributeError)


class Message(NamedTuple):
    """One message."""

    log_time: int
    """Time at which it was logged [ns]."""
    publish_time: int
    """Time at which it was sent [ns]; of a bag that does not say, when it was logged."""
    content: Any
    """Nested dicts, lists, arrays or objects with attributes."""


class MessageLog:
    """Topics of a file, each with one type of message."""

    def __init__(self, path: Path, types: dict[str, str], read: Callable[[str], list[Message]]):
        """
        Args:
            path: the file or folder, for errors.
            types: message type of every topic, as "geometry_msgs/msg/Pose"; empty if it has none.
            read: messages of a topic.
        """
        self.path, self._read = path, read
        self.types = {topic: name.replace("/msg/", "/") for topic, name in types.items()}
        self._topics: dict[str, list[Message]] = {}
        self._epoch: int | None = None

    @property
    def epoch_s(self) -> int:
        """Whole second since 1970 from which its stamps count; 0 where they count from where the log says."""
        return self._epoch or 0

    def type_of(self, field: str, topic: str | None) -> str:
        """Type of the messages of a topic, as "geometry_msgs/Pose".

        Raises:
            InvalidValueError: no such topic; the message names the nearest.
        """
        if topic is None or topic not in self.types:
            raise unknown(f"{field}.topic", topic, sorted(self.types), self.path)
        return self.types[topic]

    def messages(self, topic: str) -> list[Message]:
        """Messages of a topic, in the order of the log."""
        if topic not in self._topics:
            joints = self.types[topic] == JOINT_STATE
            self._topics[topic] = [m._replace(content=_by_name(m.content)) if joints else m for m in self._read(topic)]
        return self._topics[topic]

    def series(self, field: str, names: Sequence[str], topic: str | None, time: TimeMap) -> Series:
        """Fields by dotted path, list items by number and joints by name; see `CsvLog.series`."""
        kind, messages = self.type_of(field, topic), self.messages(str(topic))
        if kind == JOINT_STATE:  # several publishers may each know some of the joints
            messages = [m for m in messages if all(_has(m.content, name) for name in names)] or messages
        values, stamps = read_all(
            partial(self.values, field, names, str(topic), messages), partial(self.stamps, str(topic), messages, time)
        )
        return in_order(self.path, field, stamps, values)

    def values(self, field: str, names: Sequence[str], topic: str, messages: Sequence[Message]) -> np.ndarray:
        """Fields of messages, shape (N, K), see `series`."""
        return np.column_stack(read_all(*(partial(self._column, field, name, topic, messages) for name in names)))

    def stamps(self, topic: str, messages: Sequence[Message], time: TimeMap) -> np.ndarray:
        """Times of messages [s], from the log's epoch, exact to the nanosecond, or by a field of numbers."""
        first = messages[0].content if messages else None
        column = time.column or (_STAMP if _has(first, f"{_STAMP}.sec") else "log_time")
        fraction = next((name for name in _NANOSECONDS if _has(first, f"{column}.{name}")), None)
        if column in ("log_time", "publish_time"):
            stamps = np.array([getattr(m, column) for m in messages], dtype=np.int64)
        elif fraction:
            whole, part = (self._column("time.column", f"{column}.{n}", topic, messages) for n in ("sec", fraction))
            stamps = whole.astype(np.int64) * _SECOND + part.astype(np.int64)
        else:
            return self._column("time.column", column, topic, messages) * factor("time", time.unit)
        if self._epoch is None and len(stamps):
            self._epoch = int(stamps[0]) // _SECOND
        return (stamps - self.epoch_s * _SECOND) / _SECOND

    def _column(self, field: str, name: str, topic: str, messages: Sequence[Message]) -> np.ndarray:
        values = np.empty(len(messages))
        for i, message in enumerate(messages):
            try:
                value = _at(message.content, name)
            except _NOT_THERE:
                raise unknown(field, name, sorted(dict(_leaves(message.content))), self.path) from None
            if isinstance(value, bool) or not isinstance(value, int | float | np.number) or not np.isfinite(value):
                raise LogError(f"{self.path}: topic {topic}, message {i}: {name}: got {value!r}; allowed: a number")
            values[i] = value
        return values


def open_mcap(path: Path) -> MessageLog:
    """MCAP file with JSON or ROS 2 messages, its checksums compared.

    Raises:
        LogError: no whole MCAP file, or `mcap` or `rosbags` is not installed.
    """
    types: dict[str, str] = {}
    encodings: dict[str, str] = {}
    messages: dict[str, list[Message]] = {}
    with _parser(path, "an MCAP file", "mcap"):
        from mcap.reader import NonSeekingReader  # noqa: PLC0415  an extra, needed by such files alone

        with path.open("rb") as file:
            # from front to back: only then is every checksum compared, the data section's too
            for schema, channel, message in NonSeekingReader(file, validate_crcs=True).iter_messages():
                types[channel.topic] = schema.name if schema else ""
                encodings[channel.topic] = channel.message_encoding
                if channel.message_encoding == "json":
                    content = Message(message.log_time, message.publish_time, json.loads(message.data))
                    messages.setdefault(channel.topic, []).append(content)
    if "cdr" in encodings.values():
        return open_bag(path)

    def read(topic: str) -> list[Message]:
        if topic not in messages:
            given = encodings[topic]
            raise LogError(f"{path}: topic {topic} is encoded as {given}; allowed: json, or cdr of ROS 2; convert it")
        return messages[topic]

    return MessageLog(path, types, read)


def open_bag(path: Path) -> MessageLog:
    """ROS 2 bag: its folder, a .db3 file, or an MCAP file with CDR messages.

    Raises:
        LogError: no whole bag, or `rosbags` is not installed.
    """

    def reader() -> Any:
        from rosbags.highlevel import AnyReader  # noqa: PLC0415  an extra
        from rosbags.typesys import Stores, get_typestore  # noqa: PLC0415

        # bags of Humble and before hold no definitions of their messages
        return AnyReader([path], default_typestore=get_typestore(Stores.LATEST))

    def read(topic: str) -> list[Message]:
        with _parser(path, "a ROS 2 bag", "rosbags"), reader() as bag:
            wanted = [c for c in bag.connections if c.topic == topic]
            raw = bag.messages(connections=wanted)
            return [Message(at, at, bag.deserialize(data, c.msgtype)) for c, at, data in raw]

    with _parser(path, "a ROS 2 bag", "rosbags"), reader() as bag:
        return MessageLog(path, {c.topic: c.msgtype for c in bag.connections}, read)


@contextmanager
def _parser(path: Path, what: str, package: str) -> Iterator[None]:
    """Turn what a reader of another package raises into a LogError."""
    try:
        yield
    except ImportError:
        raise LogError(
            f"{path}: reading {what} needs {package}: not installed; pip install 'heft-testbed[robot]'"
        ) from None
    except Exception as error:  # damaged bytes raise anything, from the decompressors too
        raise LogError(f"{path}: not {what} as a whole: {str(error) or type(error).__name__}") from None


def _by_name(content: Any) -> dict[str, Any]:
    """Joint states by the joints' names, whose order may change."""
    names = [str(name) for name in inside(content, "name")]
    return {
        "header": inside(content, "header"),
        **{kind: dict(zip(names, inside(content, kind), strict=False)) for kind in ("position", "velocity", "effort")},
    }


def inside(value: Any, part: str) -> Any:
    """A field of a message by name, or an item by number."""
    if isinstance(value, dict):
        return value[part]
    return value[int(part)] if isinstance(value, list | tuple | np.ndarray) else getattr(value, part)


def _at(content: Any, path: str) -> Any:
    for part in path.split("."):
        content = inside(content, part)
    return content


def _has(content: Any, path: str) -> bool:
    try:
        _at(content, path)
    except _NOT_THERE:
        return False
    return True


def _leaves(data: Any, path: str = "") -> Iterable[tuple[str, Any]]:
    """Values within a message by dotted path; list items by number."""
    if isinstance(data, dict):
        inner = data.items()
    elif isinstance(data, list | tuple | np.ndarray):
        inner = enumerate(data)
    elif is_dataclass(data):
        inner = ((f.name, getattr(data, f.name)) for f in fields(data))
    else:
        yield path, data
        return
    for key, value in inner:
        yield from _leaves(value, f"{path}.{key}" if path else str(key))
