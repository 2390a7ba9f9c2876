"""Sensing: how a force/torque sensor errs, what is taken off its record, and the steady windows that are left."""
