"""What is measured: objects, actions, trials, trajectories, sensing."""
