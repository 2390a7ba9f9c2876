"""Fakes: benches, arms, sensors and worlds that tests run against."""
