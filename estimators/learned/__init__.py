"""Posterior over the masses of the groups that a network learns from simulated trials."""
