"""Reading a results folder: estimates as a table, trials as trajectories.

Columns of the table, a row an estimate (one method, one draw of the sensor's errors):

| column | |
|---|---|
| object, support, sensing, method, seed | what was asked of whom; `method` is the scenario's label |
| kind | the method behind the label |
| axis.<field> | value of each swept field of the scenario |
| status | ok; underdetermined, not_converged, no_data: what the method says; failed, infeasible: there is no answer |
| message | why status is not ok |
| nad | normalized absolute difference, a part of 1 |
| mpd_open_loop_m, mpd_turn_m | mean particle distance after 1 s, and over a whole turn |
| mpd_open_loop_of_truth_m, mpd_turn_of_truth_m | what the true masses score; with the scenario's first method only |
| mass_kg, true_mass_kg, group_names | of each mass group |
| friction | of each friction group |
| com_error_m, inertia_error, unobserved | of methods with hidden states: distance of c, I_cm over the truth minus 1 |
| weight_kg | M as weighed |
| loss, optimizer | least loss of the search, and who found it |
| rollouts | guesses that the search held against all data; 0 of methods that do not search |
| trials, robot_s | what the method was given, and the robot time it took |
| seconds | computing time of the estimate |
| key | folder of the estimate in estimates/ |
| trial_keys | folders in trials/ of what the method was given, the weighing first |
| held_out_keys | folders in trials/ of the turns that its prediction was held against |
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pandas as pd

from scenarios.results.store import Store
from testbed.errors import InvalidValueError
from testbed.trajectory import Trajectory, load_trajectory


def load_results(path: str | Path) -> pd.DataFrame:
    """The estimates of a run, a row each.

    Args:
        path: results folder, or its results.parquet.

    Raises:
        InvalidValueError: there are no results.
    """
    file = Path(path) / "results.parquet" if Path(path).is_dir() else Path(path)
    if not file.is_file():
        raise InvalidValueError(
            "path", str(path), "a results folder with a results.parquet, which a finished run leaves"
        )
    return pd.read_parquet(file)


def load_trajectories(path: str | Path) -> Iterator[tuple[str, Trajectory]]:
    """Key and record of every finished trial of a run, one at a time, as the runner left it: no sensing drawn.

    Args:
        path: results folder.

    Raises:
        InvalidValueError: not a results folder.
        TrajectoryFileError: a damaged record.
    """
    folder = Path(path) / "trials"
    if not folder.is_dir():
        raise InvalidValueError("path", str(path), "a results folder, with trials/ in it")
    store = Store(Path(path))
    for trial in sorted(folder.iterdir()):
        if store.has_trial(trial.name):
            yield trial.name, load_trajectory(trial / "trajectory.parquet")
