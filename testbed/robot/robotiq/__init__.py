"""Robotiq FT-300S on a serial line (`ft300s.Ft300s`), and the data sheet of the 2F-85 gripper.

Nothing is imported here: the data sheet needs no driver, the sensor needs pyserial and pymodbus.
"""
