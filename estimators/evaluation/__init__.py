"""Evaluation: the paper's metrics NAD and MPD, statistics over draws, and the paper's own figures."""
