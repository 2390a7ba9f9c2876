"""Results on disk: written whole, read back as values."""
