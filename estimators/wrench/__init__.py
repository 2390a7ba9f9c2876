"""Forward model of the measured wrench: what a sensor shows of given masses, motion and errors of the setup."""
