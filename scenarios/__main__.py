"""`python -m scenarios` is `heft`."""

from scenarios.cli.main import command

if __name__ == "__main__":
    command()
