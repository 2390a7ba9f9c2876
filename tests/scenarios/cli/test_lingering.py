"""The command ends though a plug-in's thread does not."""

import subprocess
import sys

import pytest

ENDLESS = """
import sys, threading
from scenarios.cli.main import command
threading.Thread(target=threading.Event().wait, name="endless").start()
sys.argv = ["heft", WORDS]
command()
"""


@pytest.mark.parametrize(("words", "code"), [("--version", 0), ("no_such_command", 2)])
def test_a_thread_that_never_ends_is_named_and_left(words: str, code: int):
    program = ENDLESS.replace("WORDS", repr(words))
    ended = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=60, check=False)
    assert ended.returncode == code
    assert "threads of a plug-in still running: endless" in ended.stderr
