"""Shared parts of tests besides fakes: records, oracles, conformance of runners."""
