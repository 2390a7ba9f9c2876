"""Rows of results, as estimates leave them."""

import numpy as np

from testbed.objects.files import load_object

KNOWN = ("I1", "I2", "L1", "L2", "F1", "F2", "hammer")


def row(method: str, seed: int, nad: float | None, name: str = "L2", **more: object) -> dict:
    """Row of one estimate; an unknown object has the masses of L2."""
    model = load_object(name if name in KNOWN else "L2")
    mass = np.array(model.group_mass)
    columns = {
        "object": name, "support": "own_weight", "sensing": "ft300s", "seed": seed, "method": method, "kind": method,
        "status": "ok" if nad is not None else "underdetermined", "message": "", "nad": nad,
        "seconds": 1.0 + seed + (nad or 0), "robot_s": 300.0,
        "mass_kg": None if nad is None else (mass * (1 + nad)).tolist(), "true_mass_kg": mass.tolist(),
        "group_names": list(model.shape.group_names),
        "mpd_open_loop_m": 0.0111, "mpd_turn_m": 0.0222,
        "mpd_open_loop_of_truth_m": 0.0033, "mpd_turn_of_truth_m": 0.0044, "trial_keys": ["weighing", "turn"],
    }  # fmt: skip
    return columns | more
