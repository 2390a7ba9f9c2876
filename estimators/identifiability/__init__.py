"""Identifiability of masses and frictions by trials, planned or made, with standard errors."""
