"""The particle model: dynamics, steady windows, support, and the errors of each."""
