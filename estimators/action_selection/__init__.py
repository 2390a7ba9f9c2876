"""Choice of actions: the paper's rank-driven policy, plans made before the first trial, and the online policy."""
