"""What a results folder looks like: its pages in the viewer, its figures and its report."""
