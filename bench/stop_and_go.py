"""Inertial parameters of tools from stop-and-go motions: python bench/stop_and_go.py DIR [--draws N].

DIR holds a folder a tool, as the published set has them (docs/tools.md): `mesh.ply`, `Inertia.yaml` and
`stop_and_go.npz`, a motion and its wrench without noise. Each draw adds the errors of a sensor. Errors are medians over
tools and draws: of M and of the inertia about the center of mass (Frobenius norm) in percent, of c in mm; then the 90 %
intervals that hold the truth (M, c, the inertia's diagonal), and answers that a body of positive density can have.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from rich import box
from scipy.signal import lfilter
from shared import head_table, parser_of, show

from estimators.inertial import (
    Ellipsoid,
    HeldMotion,
    InertialEstimate,
    InertialParameters,
    consistent_inertia,
    homogeneous_parts,
    inertial_equations,
    least_squares_inertia,
)
from scenarios.study.meshes import stated_inertia
from testbed.errors import HeftError
from testbed.objects.conversion.convert import convert_mesh
from testbed.objects.model import GRAVITY
from testbed.sensing.presets import Sensing, preset

SENSING = ("ideal", "ft300s", "moderate")
METHODS = ("least squares", "consistent (SDP)", "homogeneous parts")


@dataclass(frozen=True, eq=False)
class Tool:
    """One tool of the set, all in the axes of the sensor."""

    name: str
    motion: HeldMotion
    truth: InertialParameters
    within: Ellipsoid
    parts: tuple[InertialParameters, ...]


def main() -> None:
    """Print a row per sensor and method."""
    parser = parser_of(__doc__, draws=10)
    parser.add_argument("folder", type=Path)
    args = parser.parse_args()
    tools = [read_tool(each) for each in sorted(args.folder.iterdir()) if (each / "stop_and_go.npz").exists()]
    told = {tool.name: len(tool.parts) for tool in tools}
    print(f"{len(tools)} tools, parts of each: {told}")
    columns = ("sensor", "method", "M, %", "c, mm", "inertia, %", "90 % hold", "physical, %", "no answer")
    table = head_table(*columns, left=("sensor", "method"), box=box.SIMPLE)
    for sensing in map(preset, SENSING):
        draws = 1 if sensing.name == "ideal" else args.draws
        for method in METHODS:
            found = [(tool, each) for tool in tools for each in answers(tool, method, sensing, draws)]
            rows = [(*judged(tool.truth, each), each.parameters.consistent) for tool, each in found if each is not None]
            middle = np.median([row[:3] for row in rows], axis=0)
            hold, physical = np.mean([row[3] for row in rows]), np.mean([row[4] for row in rows])
            none = len(found) - len(rows)
            numbers = [f"{each:.2g}" for each in middle]
            table.add_row(sensing.name, method, *numbers, f"{100 * hold:.0f}", f"{100 * physical:.0f}", str(none))
    show(table, width=110)


def answers(tool: Tool, method: str, sensing: Sensing, draws: int) -> Iterator[InertialEstimate | None]:
    """A method's answers to a tool's motion under so many draws of a sensor's errors; None where it has none."""
    for seed in range(draws):
        motion = measured(tool.motion, sensing, seed)
        try:
            if method == "homogeneous parts":
                yield homogeneous_parts(inertial_equations(motion, sensing, still_only=True), tool.parts)
            elif method == "least squares":
                yield least_squares_inertia(inertial_equations(motion, sensing))
            else:
                yield consistent_inertia(inertial_equations(motion, sensing), tool.within)
        except HeftError as error:
            if seed == 0:
                print(f"{tool.name}, {method}, {sensing.name}: {error}")
            yield None


def judged(truth: InertialParameters, found: InertialEstimate) -> tuple[float, float, float, float]:
    """Errors of M [%], c [mm] and inertia [%], and the part of the intervals of M, c and its diagonal that hold."""
    best = found.parameters

    def numbers(of: InertialParameters) -> np.ndarray:
        return np.concatenate([[of.mass], of.center_of_mass, np.diag(of.inertia)])

    low, high = found.interval(numbers)
    off = np.linalg.norm(best.inertia - truth.inertia) / np.linalg.norm(truth.inertia)
    return (
        100 * abs(best.mass / truth.mass - 1),
        1e3 * float(np.linalg.norm(best.center_of_mass - truth.center_of_mass)),
        100 * float(off),
        float(np.mean((low - 1e-12 <= numbers(truth)) & (numbers(truth) <= high + 1e-12))),
    )


def measured(exact: HeldMotion, sensing: Sensing, seed: int) -> HeldMotion:
    """A motion as a sensor with errors and an arm with noisy accelerations record it, the bias of a tare in all."""
    rng, count = np.random.default_rng(seed), len(exact.time_s)
    dt = float(np.median(np.diff(exact.time_s)))
    white = rng.standard_normal((count, 6))
    white[1:] *= np.sqrt(1 - sensing.lag1**2)
    noise = np.asarray(lfilter([1.0], [1.0, -sensing.lag1], white, axis=0))
    noise *= [*sensing.force_noise, *sensing.torque_noise]
    walk = np.cumsum(np.sqrt(dt) * rng.standard_normal((count, 6)), axis=0) * sensing.drift_std
    off = noise + walk + sensing.bias_std * rng.standard_normal(6)
    return replace(
        exact,
        wrench=exact.wrench + off,
        pull=exact.pull + sensing.linear_acceleration_noise * rng.standard_normal((count, 3)),
        angular_acceleration=exact.angular_acceleration
        + sensing.angular_acceleration_noise * rng.standard_normal((count, 3)),
    )


def read_tool(folder: Path) -> Tool:
    """A tool of the set, from its files."""
    with np.load(folder / "stop_and_go.npz") as data:
        pose, inside = data["ft_pose"], np.linalg.inv(data["ft_pose"][0]) @ data["object_pose"][0]
        turned = pose[:, :3, :3].transpose(0, 2, 1)
        velocity, acceleration = data["ft_vel"][:, :, 0], data["ft_acc"][:, :, 0]
        wrench, time = data["ft_value"], data["timestamp"]

    def by_sensor(vectors: np.ndarray) -> np.ndarray:
        return np.einsum("tij,tj->ti", turned, vectors)

    # the arrays hold m (a + g): as on a body that gravity pulls up
    pull = by_sensor(acceleration[:, :3] - [0.0, 0.0, GRAVITY])
    both = np.hstack([by_sensor(wrench[:, :3]), by_sensor(wrench[:, 3:])])
    motion = HeldMotion(time, pull, by_sensor(velocity[:, 3:]), by_sensor(acceleration[:, 3:]), both)
    rotation, origin = inside[:3, :3].T, -inside[:3, :3].T @ inside[:3, 3]
    notes = folder / "Inertia.yaml"
    of_mesh = stated_inertia(notes.read_text(encoding="utf-8"), notes)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        made = convert_mesh(folder / "mesh.ply")
    back = np.linalg.inv(np.vstack([made.pose.matrix, [0.0, 0.0, 0.0, 1.0]]))
    parts, low, high = [], [], []
    for part in made.parts:
        as_told = part.copy().apply_transform(back)
        as_told.density = 1.0
        center, about = as_told.center_mass, as_told.moment_inertia
        parts.append(InertialParameters(as_told.volume, center, about).moved(rotation, origin))
        corners = (as_told.vertices - origin) @ rotation
        low.append(corners.min(axis=0))
        high.append(corners.max(axis=0))
    within = Ellipsoid.around(np.min(low, axis=0), np.max(high, axis=0))
    return Tool(folder.name, motion, of_mesh.moved(rotation, origin), within, tuple(parts))


if __name__ == "__main__":
    main()
