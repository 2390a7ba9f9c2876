"""Trials in MuJoCo: scene, contacts, motion of the arm, runner, and pictures. Only this package imports MuJoCo.

Nothing is imported here: settings are light, and graphics are chosen before MuJoCo loads.
"""
