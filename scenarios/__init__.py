"""Scenario files, runs, storage, tables, the heft command."""
