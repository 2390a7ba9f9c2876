"""Kinova Gen3 over Kortex."""
