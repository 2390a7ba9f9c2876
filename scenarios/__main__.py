"""`python -m scenarios` is `heft`."""

from scenarios.cli.main import main

if __name__ == "__main__":
    main()
