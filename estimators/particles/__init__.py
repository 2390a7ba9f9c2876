"""Windows of trials on the table as one batch, their errors, and the friction system."""
