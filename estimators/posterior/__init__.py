"""Joint posterior of masses, frictions and the errors of the setup, from any set of measurements."""
