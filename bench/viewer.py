"""Cost of a turn's recording: time to log it over the time to simulate it, size, and time to the first frame.

python bench/viewer.py
"""

from __future__ import annotations

import subprocess
import tempfile
import time
from pathlib import Path

import psutil
from rerun.experimental import ViewerClient

from scenarios.results.store import Store, key_of, trial_request
from scenarios.study.trials import simulate
from scenarios.views.pages import trial_page
from testbed.actions.rotate import Rotate
from testbed.objects.files import load_object
from testbed.simulation.settings import SimulationSettings
from testbed.trial import Trial
from viz.recordings.page import save
from viz.recordings.viewer import HOST, environment, free_port, program, url_of

REPEATS = 5


def main() -> None:
    """Side by side in one run, processor time; the least of some."""
    trial, settings = Trial(load_object("L2"), Rotate(0)), SimulationSettings()
    key = key_of(trial_request(trial, settings))
    with tempfile.TemporaryDirectory() as folder:
        root, simulated, logged = Path(folder), [], []
        for _ in range(REPEATS):
            (root / "trials" / key / "trial.json").unlink(missing_ok=True)
            begin = psutil.Process().cpu_times()
            simulate(trial, settings, Store(root))
            middle = psutil.Process().cpu_times()
            save(trial_page(root, key), root / "trial.rrd")
            end = psutil.Process().cpu_times()
            simulated.append(middle.user + middle.system - begin.user - begin.system)
            logged.append(end.user + end.system - middle.user - middle.system)
        size = (root / "trial.rrd").stat().st_size
        print(f"an 18 s turn: simulated in {min(simulated):.2f} s, logged in {min(logged):.2f} s of processor time: "
              f"{100 * min(logged) / min(simulated):.0f} %; file {size / 1e6:.1f} MB")  # fmt: skip
        print(f"first frame after {min(first_frame(root / 'trial.rrd') for _ in range(3)):.1f} s")


def first_frame(path: Path) -> float:
    """Time from starting the viewer to a picture of the recording, s."""
    port, begin = free_port(), time.monotonic()
    command = [*program(), str(path), "--headless", "--bind", HOST, "--port", str(port), "--window-size", "1600x1000"]
    process = subprocess.Popen(command, env=environment(), stderr=subprocess.DEVNULL)
    try:
        while process.poll() is None:
            try:
                client = ViewerClient.connect(url_of(port))
                state = client.get_state()
                if state.recordings and state.views and not state.loading:
                    client.take_screenshot()
                    return time.monotonic() - begin
            except Exception:  # it does not answer yet
                pass
            time.sleep(0.02)
        raise SystemExit("the viewer ended: apt install mesa-vulkan-drivers")
    finally:
        process.kill()
        process.wait()


if __name__ == "__main__":
    main()
