"""The world of exact Coulomb friction that the conformance kit ships, under the name that tests know."""

from estimators.testing.analytic_world import HEIGHT, accelerated, drawn_object, felt, turns

__all__ = ["HEIGHT", "accelerated", "drawn_object", "felt", "turns"]
