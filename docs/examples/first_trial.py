"""A first trial in ten lines: turn L2 there and back on the simulated bench, and look at what was felt."""

from testbed.actions.rotate import Rotate
from testbed.objects.files import load_object
from testbed.sensing.windows import steady_windows
from testbed.simulation.runner import SimulationRunner
from testbed.trial import Trial

trial = Trial(load_object("L2"), Rotate(grasp=2, duration=4.0, back=True), sensing="ft300s", seed=1)
with SimulationRunner() as bench:
    trajectory = bench.run(trial)
for window in steady_windows(trajectory):
    print(f"{window.twist[2]:+.3f} rad/s: force {window.wrench[:2].round(2)} N, torque {window.wrench[5]:+.3f} N m")
