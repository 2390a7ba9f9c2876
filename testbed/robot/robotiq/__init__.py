"""Robotiq FT-300S on a serial line."""
