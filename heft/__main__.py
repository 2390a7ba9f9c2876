"""`python -m heft` is `heft`, where no folder hides a package."""

from scenarios.cli.main import command

if __name__ == "__main__":
    command()
