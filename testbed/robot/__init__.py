"""The real bench: interfaces of arm, gripper, sensor and pose source, the trial runner on them, and its guards."""
