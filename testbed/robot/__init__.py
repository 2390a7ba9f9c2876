"""The real bench: ports of the arm, gripper, wrench sensor and object pose, and the drivers behind them."""
