"""Identifiability: what trials show of masses and frictions, before or after they are made, and with which errors."""
