"""Kinova Gen3 and its Robotiq 2F-85 over Kortex, which runs in a process of its own: `KortexArm`, `KortexGripper`.

Nothing is imported here: that process may run another Python without heft's dependencies.
"""
