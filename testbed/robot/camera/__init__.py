"""Cameras of the real robot: their interface, and one that takes poses from a network socket."""
