"""Rerun recordings and their viewer."""
