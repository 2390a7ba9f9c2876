"""Estimation where the support is not known: a test of the support models, and the masses that fit each."""
