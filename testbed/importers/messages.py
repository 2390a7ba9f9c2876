"""Logs as messages by topic: MCAP files, and ROS 2 bags without ROS."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from testbed.errors import short
from testbed.importers.columns import Cell, TimeMap
from testbed.importers.logs import SECOND, LogError, Series, columns_of, factor, ordered, parsed_log, read_all, unknown

JOINT_STATE = "sensor_msgs/JointState"
_STAMP = "header.stamp"
_NANOSECONDS = ("nanosec", "nsec")
_LARGEST = sys.float_info.max
_LOOKUP_ERRORS = (KeyError, IndexError, ValueError, TypeError)


class Message(NamedTuple):
    """Message as text: the parsed contents of a minute at 8 kHz would take a gigabyte."""

    log_time: int
    """Time at which it was logged [ns]."""
    publish_time: int
    """Time at which it was sent [ns]; `log_time` in a bag, which does not hold it."""
    text: bytes
    """Content as JSON."""

    @property
    def content(self) -> Any:
        """Nested dicts and lists."""
        return json.loads(self.text)


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
        """Whole second since 1970 from which the stamps count; 0 if they count from a zero of the log's own."""
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
            found = self._read(topic)
            self._topics[topic] = [m._replace(text=self._by_name(topic, m.content)) for m in found] if joints else found
        return self._topics[topic]

    def series(self, field: str, names: Sequence[Cell], topic: str | None, time: TimeMap) -> Series:
        """Fields by dotted path, list items by number and joints by name; see `TableLog.series`."""
        sought = columns_of(field, names, self.path)
        kind, messages = self.type_of(field, topic), self.messages(str(topic))
        if kind == JOINT_STATE:  # several publishers may each know some of the joints
            messages = [m for m in messages if _has(m.content, *sought)] or messages
        values, stamps = read_all(
            partial(self.values, field, sought, str(topic), messages), partial(self.stamps, str(topic), messages, time)
        )
        return ordered(self.path, field, stamps, values, names)

    def values(self, field: str, names: Sequence[str], topic: str, messages: Sequence[Message]) -> np.ndarray:
        """Fields of messages, shape (N, K), see `series`."""
        values = np.empty((len(messages), len(names)))
        for i, content in enumerate(message.content for message in messages):
            values[i] = read_all(*(partial(self._number, field, name, content, topic, i) for name in names))
        return values

    def _number(self, field: str, name: str, content: Any, topic: str, index: int) -> float:
        value = self.part(field, name, content)
        if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) <= _LARGEST:
            given = f"topic {topic}, message {index}: {name}: got {short(value)}"
            raise LogError(f"{self.path}: {given}; allowed: a number")
        return value

    def _by_name(self, topic: str, content: Any) -> bytes:
        """Joint state as JSON, values by the names of the joints, whose order may change."""
        of = partial(self.part, f"topic {topic}", content=content)
        names, kinds = [str(name) for name in of("name")], ("position", "velocity", "effort")
        by_name = {kind: dict(zip(names, of(kind), strict=False)) for kind in kinds}
        return json.dumps({"header": of("header"), **by_name}).encode()

    def part(self, field: str, name: str, content: Any) -> Any:
        """A part of a message's content by dotted path.

        Raises:
            InvalidValueError: no such part; the message names the nearest.
        """
        try:
            return _at(content, name)
        except _LOOKUP_ERRORS:
            raise unknown(field, name, sorted(dict(_leaves(content))), self.path) from None

    def stamps(self, topic: str, messages: Sequence[Message], time: TimeMap) -> np.ndarray:
        """Times of messages [s], from the log's epoch, exact to the nanosecond, or by a field of numbers."""
        first = messages[0].content if messages else None
        column = time.column or (_STAMP if _has(first, f"{_STAMP}.sec") else "log_time")
        fraction = next((name for name in _NANOSECONDS if _has(first, f"{column}.{name}")), None)
        if column in ("log_time", "publish_time"):
            stamps = np.array([getattr(m, column) for m in messages], dtype=np.int64)
        elif fraction:
            names = [f"{column}.sec", f"{column}.{fraction}"]
            stamps = self.values("time.column", names, topic, messages).astype(np.int64) @ np.array([SECOND, 1])
        else:
            return self.values("time.column", [column], topic, messages)[:, 0] * factor("time", time.unit)
        if self._epoch is None and len(stamps):
            self._epoch = int(stamps[0]) // SECOND
        return (stamps - self.epoch_s * SECOND) / SECOND


def open_messages(path: Path) -> MessageLog:
    """MCAP file with JSON or ROS 2 messages, its checksums compared; or a ROS 2 bag: its folder or a .db3 file.

    Raises:
        LogError: a damaged file, one with content that no recorder writes, or a package that is not installed.
    """
    what = "an MCAP file" if path.suffix.lower() == ".mcap" else "a ROS 2 bag"
    result = partial(parsed_log, "testbed.parsing.logs", path, what)
    with result() as found:
        topics = json.loads(found.read_bytes())

    def read(topic: str) -> list[Message]:
        if (given := topics[topic][1]) not in ("json", "cdr"):
            raise LogError(f"{path}: topic {topic} is encoded as {given}; allowed: json, or cdr of ROS 2; convert it")
        with result(topic) as found, found.open("rb") as lines:
            each = (line.split(b"\t", 2) for line in lines)
            return [Message(int(logged), int(sent), text) for logged, sent, text in each]

    return MessageLog(path, {topic: kind for topic, (kind, _) in topics.items()}, read)


def _at(content: Any, path: str) -> Any:
    for part in path.split("."):
        content = content[part] if isinstance(content, dict) else content[int(part)]
    return content


def _has(content: Any, *paths: str) -> bool:
    try:
        for path in paths:
            _at(content, path)
    except _LOOKUP_ERRORS:
        return False
    return True


def _leaves(data: Any, path: str = "") -> Iterable[tuple[str, Any]]:
    """Values within a message by dotted path; list items by number."""
    if isinstance(data, dict):
        inner = data.items()
    elif isinstance(data, list):
        inner = enumerate(data)
    else:
        yield path, data
        return
    for key, value in inner:
        yield from _leaves(value, f"{path}.{key}" if path else str(key))
