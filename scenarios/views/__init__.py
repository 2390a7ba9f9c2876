"""Views of a results folder: its pages in the viewer, its figures and its report."""
