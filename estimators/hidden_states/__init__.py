"""Algorithm 1 of the paper: mass by way of the hidden states."""
