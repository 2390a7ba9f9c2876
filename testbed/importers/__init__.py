"""Logs of other benches, CSV or MCAP, read into trajectories by a mapping of their columns and units."""
