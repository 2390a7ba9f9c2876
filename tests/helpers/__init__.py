"""Shared parts of tests other than fakes: records, oracles, conformance of runners."""
