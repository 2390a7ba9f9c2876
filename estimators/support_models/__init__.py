"""Estimation where it is not known who carries the object's weight."""
