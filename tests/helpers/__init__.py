"""What tests share besides fakes: records, oracles, conformance of runners."""
