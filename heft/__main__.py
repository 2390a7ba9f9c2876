"""`python -m heft` is `heft`."""

from scenarios.cli.main import command

if __name__ == "__main__":
    command()
