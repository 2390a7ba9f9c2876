"""MCAP files of given messages."""

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import pytest


def write_messages(
    path: Path,
    messages: Iterable[tuple[str, str, int, bytes]],
    encoding: str = "json",
    schema: tuple[str, bytes] = ("jsonschema", b"{}"),
    **options: Any,
) -> Path:
    """File of messages (topic, type, time [ns], content), of one encoding, whose types have one definition."""
    mcap = pytest.importorskip("mcap.writer")
    with path.open("wb") as file:
        writer, channels = mcap.Writer(file, **options), {}
        writer.start("ros2" if encoding == "cdr" else "")
        for topic, kind, stamp, content in messages:
            if topic not in channels:
                channels[topic] = writer.register_channel(topic, encoding, writer.register_schema(kind, *schema))
            writer.add_message(channels[topic], stamp, content, stamp)
        writer.finish()
    return path
