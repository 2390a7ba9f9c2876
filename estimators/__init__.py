"""From trajectories to mass distributions: models, methods, choice of actions, metrics."""
