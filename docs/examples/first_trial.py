"""A first trial in ten lines: turn L2 there and back in simulation, and print the wrench."""

import heft

trial = heft.Trial(heft.load_object("L2"), heft.Rotate(grasp=2, duration=4.0, back=True), sensing="ft300s")
with heft.SimulationRunner() as simulation:
    trajectory = simulation.run(trial)
for window in heft.steady_windows(trajectory):
    print(f"{window.twist[2]:+.3f} rad/s: force {window.wrench[:2].round(2)} N, torque {window.wrench[5]:+.3f} N m")
