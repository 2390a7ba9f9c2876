"""Parsers of untrusted logs and meshes, each in a process of its own with bounded memory, time and output."""
