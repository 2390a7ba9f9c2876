"""`heft robot hand-eye`: a tracker's frame from points that the tool touched and the tracker saw."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import tyro

COLUMNS = ("seen_x", "seen_y", "seen_z", "touched_x", "touched_y", "touched_z")


def hand_eye(
    points: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="POINTS.csv")],
    *,
    out: Annotated[Path, tyro.conf.arg(metavar="FILE")] = Path("hand_eye.toml"),
) -> None:
    """Find a tracker's pose in the arm's base frame, from points that the tool touched and the tracker saw.

    POINTS.csv has a row per point, 4 or more, not on one line, in meters: seen_x, seen_y, seen_z in the tracker's frame
    and touched_x, touched_y, touched_z of the tool center point in the arm's base frame. Moves nothing.

    Example: heft robot hand-eye points.csv --out hand_eye.toml

    Args:
        points: CSV file.
        out: TOML file to write; testbed.robot.calibration.load_hand_eye reads it.
    """
    from datetime import UTC, datetime

    import numpy as np
    import pandas as pd
    from scipy.spatial.transform import Rotation

    from testbed.errors import InvalidValueError
    from testbed.robot.calibration.file import save_hand_eye
    from testbed.robot.calibration.hand_eye import align

    if not points.is_file():
        raise InvalidValueError("POINTS.csv", str(points), "a path to an existing .csv file")
    table = pd.read_csv(points, skipinitialspace=True)
    if missing := [name for name in COLUMNS if name not in table]:
        raise InvalidValueError("columns", list(table), f"{', '.join(missing)} as well", file=points)
    seen, touched = (table[list(part)].to_numpy() for part in (COLUMNS[:3], COLUMNS[3:]))
    found = align(seen, touched)
    pose = found.tracker_in_base
    x, y, z = pose.position
    turn = Rotation.from_quat(pose.orientation, scalar_first=True).as_rotvec(degrees=True)
    about = ", ".join(f"{angle:.2f}" for angle in turn)
    print(f"tracker at ({x:.4f}, {y:.4f}, {z:.4f}) m, turned by ({about}) deg, base frame of the arm")
    off = np.linalg.norm(touched - found.to_base(seen), axis=1)
    print("residuals, mm: " + ", ".join(f"{1e3 * value:.2f}" for value in off))
    print(f"residual {1e3 * found.residual:.2f} mm; positions near the points to {1e3 * found.standard_error:.2f} mm")
    save_hand_eye(out, found, f"{datetime.now(UTC):%Y-%m-%d}")
    print(out)
