"""What is measured: objects, actions, trials, trajectories, sensing; the bench that makes them, simulated or real."""
