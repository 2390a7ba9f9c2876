"""Trials in formats of other programs."""
