"""Worlds: errors of a lab relative to the estimators' model, drawn for each object and trial, and those stated."""
