"""Sensing: errors of a sensor, tare and tool compensation, drift, a camera, and the windows that estimators read."""
