"""Rerun recordings of trials, estimates, comparisons and plans, and Rerun's viewer."""
