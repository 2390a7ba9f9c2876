"""Parsing of untrusted files in a limited process, TOML, pickled errors, and hidden packages."""

import os
import pickle
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from estimators.baselines.dry_friction import LcpError
from testbed.errors import InvalidValueError
from testbed.packages import hidden_package
from testbed.parsing import process
from testbed.parsing.process import ParserError, parsed
from testbed.toml import toml_text

pytestmark = pytest.mark.own_process
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


@pytest.mark.slow
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


@pytest.mark.parametrize("kind", [InvalidValueError, LcpError])
@pytest.mark.parametrize("file", [None, Path("a.toml")])
def test_an_error_is_the_same_in_another_process(kind, file):
    error = kind("mass_kg", [-1.0], "numbers > 0", file)
    again = pickle.loads(pickle.dumps(error))
    assert type(again) is kind
    assert str(again) == str(error)
    assert (again.field, again.given, again.allowed, again.file) == ("mass_kg", [-1.0], "numbers > 0", file)


def test_ascii_and_unicode_text_comes_back_from_toml():
    text = "".join(map(chr, range(0x80))) + "é😀"
    table = {text: text, "list": [text]}
    assert tomllib.loads(toml_text(table)) == table


ROOT = Path(__file__).parent.parent.parent


def test_nothing_hides_heft_here():
    assert hidden_package() is None


@pytest.mark.parametrize(
    ("command", "code", "said"),
    [
        (["scenarios", "objects"], 2, "heft: {folder} hides heft's package estimators: rename it"),
        (["pytest", "-p", "testbed.pytest_plugin", "test_mine.py"], 0, "1 passed"),
        (["pytest", "-p", "testbed.pytest_plugin", "--estimator", "a:B"], 4, "--estimator: {folder} hides"),
    ],
    ids=["command", "own tests", "kit"],
)
def test_a_folder_that_hides_a_package_is_named(tmp_path: Path, command: list[str], code: int, said: str):
    folder = tmp_path / "estimators"
    folder.mkdir()
    (folder / "__init__.py").touch()
    (tmp_path / "test_mine.py").write_text("import estimators\n\n\ndef test_mine():\n    assert estimators\n")
    environment = os.environ | {"PYTHONPATH": str(ROOT), "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1"}
    done = subprocess.run(
        [sys.executable, "-m", *command], cwd=tmp_path, env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == code, done.stderr
    assert said.format(folder=folder) in done.stdout + done.stderr
