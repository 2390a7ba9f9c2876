"""The real robot: interfaces of arm, gripper, sensor and pose source, their registry, the trial runner and its guards.

Nothing is imported here: the Kortex process may run another Python without heft's dependencies.
"""
