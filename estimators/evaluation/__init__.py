"""Evaluation: the paper's metrics NAD and MPD, statistics over draws, and the paper's own figures."""

from estimators.evaluation.metrics import ParticleDistance, mean_particle_distance, normalized_absolute_difference
from estimators.evaluation.statistics import Summary, significantly_best, summarize

__all__ = [
    "ParticleDistance",
    "Summary",
    "mean_particle_distance",
    "normalized_absolute_difference",
    "significantly_best",
    "summarize",
]
