"""Calibration from recordings, put in against found: python bench/calibration.py [--draws 200].

A hand rests for two seconds in each of eight poses, or goes slowly through them, under a sensor with the noise of an
FT-300S. 90 % intervals of mount, mass, center and zero that hold the truth, and their standard deviations (mean over
draws): of the mount [deg], the tool's mass [g] and center [mm].
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from testbed.robot.calibration.recorded_poses import recorded_poses
from testbed.robot.calibration.static_poses import calibrate
from tests.fakes.static_hand import off, recorded

NINETY = 1.645


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--draws", type=int, default=200)
    options = parser.parse_args()
    table = Table("recording", "90 % hold", "mount", "mass", "center", "worst, std", title=f"{options.draws} draws")
    ways = {"eight rests": {}, "slow": {"rest_s": 0.0, "way_s": 20.0}}
    with tempfile.TemporaryDirectory() as folder:
        for name, way in ways.items():
            found = [calibrate(recorded_poses(*recorded(Path(folder), seed=k, **way))[0]) for k in range(options.draws)]
            scores = np.abs([off(each) for each in found])
            mount = np.degrees(np.mean([each.sensor_in_hand_std.max() for each in found]))
            mass, center = (
                1e3 * np.mean([np.max(getattr(each, s)) for each in found]) for s in ("mass_std", "com_std")
            )
            held = f"{100 * np.mean(scores < NINETY):.0f} %"
            table.add_row(name, held, f"{mount:.2f}", f"{mass:.1f}", f"{center:.2f}", f"{scores.max():.1f}")
    Console().print(table)


if __name__ == "__main__":
    main()
