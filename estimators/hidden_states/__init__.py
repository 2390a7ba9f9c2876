"""Algorithm 1 of the paper: mass and friction by way of the hidden states."""
