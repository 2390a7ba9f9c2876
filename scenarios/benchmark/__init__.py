"""Benchmark with hidden truth: a published set of simulated trials, answers as CSV, and their scores."""
