"""Worlds: how far a lab is from the estimators' model of it, drawn for each object and trial, and what is stated."""

from testbed.worlds.setup_errors import EXACT_SETUP, SetupErrors

__all__ = ["EXACT_SETUP", "SetupErrors"]
