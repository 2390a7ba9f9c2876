"""Views of values and files."""
