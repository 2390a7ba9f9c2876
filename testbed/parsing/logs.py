"""Parser of MCAP files and ROS 2 bags: python -m testbed.parsing.logs PATH [TOPIC] RESULT.

Without a topic the result is JSON: type and encoding of each topic. With one it has a line for each message, with tabs
between the time at which it was logged, that at which it was sent [ns], and its content as JSON.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import is_dataclass
from pathlib import Path
from typing import Any

import numpy as np

from testbed.parsing.process import run_parser

MOST_LETTERS, MOST_BRACKETS, MOST_ITEMS = 2**18, 8, 100_000
"""Largest definition of a message [letters], depth of its brackets, and number of items of a fixed array."""
MOST_BYTES = 2**20
"""Largest message that is read [B]: wrenches, poses and transforms are far smaller, images are not needed."""
_TYPE = re.compile(r"[A-Za-z]\w*(/[A-Za-z]\w*){1,3}", re.ASCII)


def main(path: str, *rest: str) -> None:
    """Write the topics of a log, or the messages of one of them."""
    *topic, result = rest
    with Path(result).open("w", encoding="utf-8") as file:
        if not topic:
            json.dump(topics(Path(path)), file)
            return
        for logged, sent, content in messages(Path(path), *topic):
            file.write(f"{logged}\t{sent}\t{content}\n")


def topics(path: Path) -> dict[str, tuple[str, str]]:
    """Type and encoding of the messages of each topic; every checksum of the file is compared."""
    found: dict[str, tuple[str, str]] = {}
    if path.suffix.lower() == ".mcap":
        with _whole("an MCAP file"):
            for schema, channel, _ in _mcap(path):
                found[channel.topic] = (schema.name if schema else "", channel.message_encoding)
        if all(encoding != "cdr" for _, encoding in found.values()):
            return found
    with _whole("a ROS 2 bag"), _bag(path) as bag:
        return found | {c.topic: (c.msgtype, "cdr") for c in bag.connections}


def messages(path: Path, topic: str) -> Iterator[tuple[int, int, str]]:
    """Times at which messages were logged and sent [ns], equal in a bag, and their content as a line of JSON."""
    number = 0
    if path.suffix.lower() == ".mcap":
        with _whole("an MCAP file"):
            for _, channel, message in _mcap(path):
                if channel.topic != topic:
                    continue
                if channel.message_encoding != "json":
                    break
                _check_bytes(topic, number, message.data)
                content, text = json.loads(message.data), message.data.decode(json.detect_encoding(message.data))
                yield message.log_time, message.publish_time, json.dumps(content) if "\n" in text else text
                number += 1
    if number:
        return
    with _whole("a ROS 2 bag"), _bag(path) as bag:
        wanted = [connection for connection in bag.connections if connection.topic == topic]
        for connection, logged, data in bag.messages(connections=wanted):
            _check_bytes(topic, number, data)
            yield logged, logged, json.dumps(_plain(bag.deserialize(data, connection.msgtype)))
            number += 1


@contextmanager
def _whole(what: str) -> Iterator[None]:
    """Name the expected kind of file in errors: damaged bytes raise many types, also in decompressors."""
    try:
        yield
    except (ImportError, MemoryError):
        raise
    except Exception as error:
        raise ValueError(f"not {what} as a whole: {str(error) or type(error).__name__}") from error


def _mcap(path: Path) -> Iterator[tuple[Any, Any, Any]]:
    """Schema, channel and message of all messages of an MCAP file."""
    from mcap.reader import NonSeekingReader  # noqa: PLC0415  an extra, needed by such files alone

    with path.open("rb") as file:
        # from front to back: only then is every checksum compared, the data section's too
        yield from NonSeekingReader(file, validate_crcs=True).iter_messages()


def _bag(path: Path) -> Any:
    """Bag whose definitions of messages are such as ROS writes: the reader makes Python of them."""
    from rosbags.highlevel import AnyReader  # noqa: PLC0415  an extra
    from rosbags.typesys import Stores, get_typestore  # noqa: PLC0415

    # bags of Humble and before hold no definitions of their messages
    bag = AnyReader([path], default_typestore=get_typestore(Stores.LATEST))
    for reader in bag.readers:
        with reader:
            for connection in reader.connections:
                _check_definition(connection.msgtype, connection.msgdef.data)
    return bag


def _check_bytes(topic: str, number: int, data: bytes | memoryview) -> None:
    if len(data) > MOST_BYTES:
        size = f"{len(data) / 2**20:.3g} MiB"
        raise ValueError(f"topic {topic}, message {number}: got {size}; allowed: at most {MOST_BYTES >> 20} MiB")


def _check_definition(name: str, text: str) -> None:
    """Raise ValueError for a definition that no program of ROS has written."""
    if not _TYPE.fullmatch(name):
        raise ValueError(f"type of a message: got {name[:80]!r}; allowed: names with slashes, as a/msg/B")
    if len(text) > MOST_LETTERS:
        raise ValueError(f"definition of {name}: got {len(text)} letters; allowed: at most {MOST_LETTERS}")
    bare = re.sub(r"#.*|//.*", "", text)
    deepest = max(_depth(statement) for statement in bare.split(";"))
    if deepest > MOST_BRACKETS:
        raise ValueError(f"definition of {name}: brackets nested {deepest} deep; allowed: at most {MOST_BRACKETS}")
    items = [int(number[:12]) for number in re.findall(r"\[\s*(?:<=)?\s*(\d+)", bare)]
    if items and max(items) > MOST_ITEMS:
        raise ValueError(f"definition of {name}: an array of {max(items)} items; allowed: at most {MOST_ITEMS}")


def _depth(statement: str) -> int:
    """Depth of the brackets of a statement, whose comments are gone."""
    depth = deepest = 0
    for letter in statement:
        depth = max(0, depth + (letter in "([") - (letter in ")]"))
        deepest = max(deepest, depth)
    return deepest


def _plain(value: Any) -> Any:
    """A message as dicts, lists and numbers."""
    if isinstance(value, int | float | str):
        return value
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, dict) or is_dataclass(value):
        inner = value if isinstance(value, dict) else vars(value)
        return {name: _plain(each) for name, each in inner.items()}
    if isinstance(value, list | tuple):
        return [_plain(inner) for inner in value]
    return value.item() if isinstance(value, np.generic) else value


if __name__ == "__main__":
    run_parser(main)
