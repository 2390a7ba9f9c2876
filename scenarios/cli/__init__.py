"""The heft command: a module a command."""
