"""Choice of the next action."""
