"""Parsers of strangers' files end within their limits, and say why in a line."""

from pathlib import Path

import pytest

from testbed.parsing import process
from testbed.parsing.process import ParserError, parsed

PARSER = """
import sys
from testbed.parsing.process import run_parser

def main(path, result):
    with open(result, "wb") as file:
        exec(open(path).read())

run_parser(main)
"""


@pytest.fixture(name="run")
def _run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    (tmp_path / "some_parser.py").write_text(PARSER)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))

    def run(does: str) -> bytes:
        path = tmp_path / "file"
        path.write_text(does)
        with parsed("some_parser", path) as result:
            return result.read_bytes()

    return run


def test_a_result_comes_back_and_is_deleted(run, tmp_path: Path):
    assert run("file.write(b'17')") == b"17"
    path = tmp_path / "file"
    with parsed("some_parser", path) as result:
        assert result.is_file()
    assert not result.parent.exists()


@pytest.mark.parametrize(
    ("does", "reason"),
    [
        ("held = bytearray(2**30)", "reading it takes more than 1 GiB of memory"),
        ("raise ValueError('cut\\nshort')", "cut short"),
        ("raise KeyError", "KeyError"),
        ("raise OSError('no picture')", "no picture"),
        ("sys.exit(0)", "0"),
        ("import os; os.abort()", "the parser ended with code -6"),
        ("import json; json.loads('[' * 10**5)", "maximum recursion depth exceeded"),
    ],
)
def test_a_file_that_asks_for_too_much_is_refused(does: str, reason: str, run):
    with pytest.raises(ParserError, match=f"^{reason}"):
        run(does)


def test_time_and_output_end(run, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(process, "SECONDS", 1)
    monkeypatch.setattr(process, "SLOWER", 3)
    with pytest.raises(ParserError, match=r"reading it takes more than 1 s"):
        run("while True: pass")
    with pytest.raises(ParserError, match=r"reading it takes more than 1 s"):
        run("import time; time.sleep(60)")
    with pytest.raises(ParserError, match=r"more than 512 MiB"):
        run("file.truncate(2**29 + 1)")


def test_a_package_that_is_missing_is_named(run):
    with pytest.raises(ImportError, match=r"^no_such_package$"):
        run("import no_such_package.inner")
