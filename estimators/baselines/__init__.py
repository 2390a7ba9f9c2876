"""The paper's baselines, and other people's optimisers on the same loss."""
