"""Metrics, statistics over draws, and the paper's own figures."""
