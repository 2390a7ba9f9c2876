"""Views of values: figures, Rerun recordings, the report, films."""
