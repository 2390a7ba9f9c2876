"""Robotiq FT-300S on a serial line: `ft300s.Ft300s`. Nothing is imported here: it needs pyserial and pymodbus."""
