"""What trials can show of the masses, before or after they are made."""
