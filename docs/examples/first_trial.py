"""A first trial in ten lines: turn L2 there and back in simulation, and print the wrench."""

from testbed import Rotate, SimulationRunner, Trial, load_object, steady_windows

trial = Trial(load_object("L2"), Rotate(grasp=2, duration=4.0, back=True), sensing="ft300s")
with SimulationRunner() as simulation:
    trajectory = simulation.run(trial)
for window in steady_windows(trajectory):
    print(f"{window.twist[2]:+.3f} rad/s: force {window.wrench[:2].round(2)} N, torque {window.wrench[5]:+.3f} N m")
