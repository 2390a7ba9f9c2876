"""The paper's baselines, and general optimizers on the same loss."""
