"""heft robot: the commands of the real bench."""
