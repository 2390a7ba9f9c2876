"""Scenario files, studies, results on disk, and the heft command."""
