"""Worlds: how far a lab is from the estimators' model of it, drawn for each object and trial, and what is stated."""
