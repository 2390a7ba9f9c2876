"""Training of methods that learn from simulated trials."""
