"""Commands of heft, called in this process."""

from scenarios.cli.main import main


def ended(*words: str) -> int:
    """Exit code of a command."""
    try:
        main([*words])
    except SystemExit as end:
        return int(end.code or 0)
    return 0
