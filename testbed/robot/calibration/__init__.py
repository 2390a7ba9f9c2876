"""Calibration of the sensor's mount, the tool and a pose source."""
