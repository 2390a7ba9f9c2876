"""Commands of heft, called in this process."""

import pytest

from scenarios.cli.main import main


def ended(*words: str) -> int:
    """Exit code of a command."""
    try:
        main([*words])
    except SystemExit as end:
        return int(end.code or 0)
    return 0


def refusal(capsys: pytest.CaptureFixture[str], *words: str) -> str:
    """Message of a refused command, in one line; its exit code is 2."""
    capsys.readouterr()
    assert ended(*words) == 2
    message = capsys.readouterr().err
    assert message.startswith("heft: ") and message.count("\n") == 1, message
    return message
