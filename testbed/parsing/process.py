"""Process of a parser: bounded memory, time and output.

A parser is a module whose `main` takes words and writes its result to a file. `parsed` runs it.
"""

from __future__ import annotations

import errno
import os
import resource
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

from testbed.errors import HeftError

MEMORY = 2**30
"""Memory of a parser [B]."""
SECONDS, SECONDS_PER_MB = 10, 1
"""CPU time of a parser [s], and its increment for each megabyte of the file [s]."""
OUTPUT = 2**29
"""Largest result [B]."""
SLOWER = 6
"""Ratio of the limits of wall time and CPU time: other processes may take the rest."""
MOST_LETTERS = 400
"""Letters of a reason."""
_LIMITS = "HEFT_PARSER_SECONDS"


class ParserError(HeftError, ValueError):
    """File that a parser refuses, or that exceeds a parser's limits. The message is the reason alone."""


@contextmanager
def parsed(module: str, path: Path, *words: str) -> Iterator[Path]:
    """Result of a parser, a file that is deleted on exit.

    Args:
        module: module to run, with the path, the words and the path of the result as arguments.
        path: the untrusted file or folder.
        words: further arguments.

    Raises:
        ParserError: the parser refuses the file, or needs too much memory or time.
        ImportError: a package is not installed; the message is its name.
    """
    size = sum(file.stat().st_size for file in (path.iterdir() if path.is_dir() else (path,)))
    seconds = SECONDS + SECONDS_PER_MB * size // 10**6
    with TemporaryDirectory(prefix="heft_") as folder:
        result = Path(folder) / "result"
        code, said = parser_result(module, (str(path), *words, str(result)), seconds)
        if code:
            _refuse(code, said, seconds)
        yield result


def parser_result(module: str, words: Sequence[str], seconds: int) -> tuple[int, str]:
    """Exit code and error output of a parser in a process of its own."""
    environment = os.environ | {_LIMITS: str(seconds), "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    command = [sys.executable, "-P", "-m", module, *words]
    try:
        done = subprocess.run(command, env=environment, capture_output=True, timeout=SLOWER * seconds, check=False)
    except subprocess.TimeoutExpired:
        raise ParserError(f"reading it takes more than {seconds} s") from None
    return done.returncode, done.stderr.decode(errors="replace")


def _refuse(code: int, said: str, seconds: int) -> None:
    """Raise the reason why a parser ended without a result."""
    reason = said.strip().rpartition("\n")[2]
    kind, _, words = (part.strip() for part in reason.partition(":"))
    if kind == "ImportError":
        raise ImportError(words)
    if kind == "MemoryError" or code == -9:
        raise ParserError(f"reading it takes more than {MEMORY >> 30} GiB of memory")
    if code == -24:
        raise ParserError(f"reading it takes more than {seconds} s")
    if kind == "OutputError":
        raise ParserError(f"what it holds takes more than {OUTPUT >> 20} MiB")
    raise ParserError((words if kind == "refused" else reason or f"the parser ended with code {code}")[:MOST_LETTERS])


def run_parser(main: Callable[..., None]) -> None:
    """Run a parser on this process's arguments within its limits, and end the process."""
    seconds = int(os.environ.get(_LIMITS, SECONDS))
    for what, most in (
        (resource.RLIMIT_DATA, MEMORY),
        (resource.RLIMIT_CPU, seconds),
        (resource.RLIMIT_FSIZE, OUTPUT),
        (resource.RLIMIT_CORE, 0),
    ):
        # at the hard limit of time the kernel sends SIGKILL, not SIGXCPU
        resource.setrlimit(what, (most, most + (what == resource.RLIMIT_CPU)))
    reason = refusal(main, sys.argv[1:])
    if not reason:
        sys.exit(0)
    print(reason, file=sys.stderr)
    sys.stderr.flush()
    os._exit(1)  # cleanup could need more memory


def refusal(main: Callable[..., None], words: Sequence[str]) -> str:
    """Reason why a parser ends without a result, in a line; empty where it has one."""
    try:
        main(*words)
    except MemoryError:
        return "MemoryError"
    except ImportError as error:
        return f"ImportError: {error.name or error}"
    except OSError as error:
        full = error.errno == errno.EFBIG and error.filename is None  # of the result, not of a file that is read
        return "OutputError" if full else f"refused: {error.strerror or error}"
    except BaseException as error:
        return " ".join(f"refused: {str(error) or type(error).__name__}".splitlines())
    return ""
