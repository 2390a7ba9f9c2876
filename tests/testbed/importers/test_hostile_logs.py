"""Logs that no recorder writes are refused in a line, and take neither memory nor time."""

from pathlib import Path

import pytest

from testbed.importers.columns import Columns, TimeMap
from testbed.importers.logs import LogError
from testbed.importers.messages import open_messages
from testbed.importers.tables import TableLog
from tests.fakes.lab_bench import write_messages

pytest.importorskip("mcap.writer")


def written(path: Path, kind: str, encoding: str, definition: str) -> Path:
    """MCAP file of ROS 2 messages of this definition."""
    messages = (("/wrench", kind, 10**18 + i, b"\0\1\0\0" + b"\0" * 64) for i in range(3))
    return write_messages(path, messages, "cdr", (encoding, definition.encode()))


@pytest.mark.parametrize(
    ("kind", "encoding", "definition", "reason"),
    [
        pytest.param(
            "a/msg/A",
            "ros2idl",
            f"module a {{ module msg {{ const long N = {'(' * 24}1{')' * 24}; struct A {{ double x; }}; }}; }};",
            "brackets nested 24 deep",
            marks=pytest.mark.own_process,
        ),
        ("a/msg/A", "ros2msg", f"a/B[1000000000] x\n{'=' * 80}\nMSG: a/B\n", "an array of 1000000000 items"),
        ("a/msg/A", "ros2idl", "module a { module msg { struct A { double x[3][1000000]; }; }; };", "of 1000000 items"),
        ("a/msg/A:\n    pass\nimport os\nclass B", "ros2msg", "float64 x", "allowed: names with slashes"),
        ('a/msg/A"""', "ros2msg", "float64 x", "allowed: names with slashes"),
        ("a/msg/A", "ros2msg", "float64 x\n" * 40_000, "400000 letters"),
        ("a/msg/A", "ros2msg", f"a/A x\n{'=' * 80}\nMSG: a/A\na/A y\n", "not a ROS 2 bag as a whole"),
    ],
)
def test_a_definition_that_no_program_writes_is_refused(kind, encoding, definition, reason, tmp_path: Path):
    with pytest.raises(LogError) as error:
        open_messages(written(tmp_path / "log.mcap", kind, encoding, definition)).messages("/wrench")
    assert reason in str(error.value) and "\n" not in str(error.value)


def test_comments_and_bounds_of_a_definition_are_no_brackets(tmp_path: Path):
    text = "".join(f"# of [0, {10**9}), x < {i} :(\nstring<=20 s{i}\nfloat64[<=3] x{i}\n" for i in range(20))
    assert open_messages(written(tmp_path / "log.mcap", "a/msg/A", "ros2msg", text)).types == {"/wrench": "a/A"}


def test_a_small_file_of_large_messages_is_refused(tmp_path: Path):
    path = write_messages(tmp_path / "log.mcap", [("/all", "x", 1, b'{"a":"' + b"a" * 2**21 + b'"}')])
    assert path.stat().st_size < 10_000
    with pytest.raises(LogError, match=r"topic /all, message 0: got 2 MiB; allowed: at most 1 MiB"):
        open_messages(path).messages("/all")


def test_json_of_any_encoding_and_layout_is_read(tmp_path: Path):
    texts = '{"a": "\u00e9"}', '{\n\t"a":\t"\u00e9"\n}'
    contents = [text.encode(encoding) for encoding in ("utf-8", "utf-8-sig", "utf-16") for text in texts]
    path = write_messages(tmp_path / "log.mcap", (("/all", "x", 1, content) for content in contents))
    assert [message.content for message in open_messages(path).messages("/all")] == [{"a": "\u00e9"}] * 6


@pytest.mark.slow
def test_a_small_file_that_unpacks_to_gigabytes_is_refused(tmp_path: Path):
    messages = (("/all", "x", i, b'{"a":"' + b"a" * (100 << 20) + b'"}') for i in range(10))
    path = write_messages(tmp_path / "log.mcap", messages, chunk_size=3 << 30)
    with pytest.raises(LogError, match="more than 1 GiB of memory"):
        open_messages(path)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        pytest.param("t,a\n1," + "9" * 2**18 + "\n", r"line 2: 262146 letters; allowed: at most 131072", id="long"),
        pytest.param("t" + ",a" * 2**17 + "\n", r"line 1: 262145 letters; allowed", id="wide"),
        pytest.param("t,a\n1,2\n\0\0\n", r"line 3: a zero byte; allowed: text", id="zeros"),
    ],
)
def test_a_line_that_is_no_row_of_a_table_is_refused(text: str, reason: str, tmp_path: Path):
    (path := tmp_path / "log.csv").write_text(text, encoding="utf-8")
    with pytest.raises(LogError, match=reason):
        TableLog(path, Columns.model_construct())


def test_a_long_cell_is_cut_in_the_message(tmp_path: Path):
    (path := tmp_path / "log.csv").write_text(f"t,a\n1,2\n2,{'x' * 9999}\n", encoding="utf-8")
    log = TableLog(path, Columns.model_construct())
    with pytest.raises(LogError, match=r"line 3: a: got 'xx.*\.\.\.; allowed: a number") as error:
        log.series("sensor", ["a"], None, TimeMap(column="t"))
    assert len(str(error.value)) < 400
