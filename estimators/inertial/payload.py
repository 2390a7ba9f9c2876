"""Payload of a robot's flange, in the formats of robots' controllers."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from estimators.inertial.body import SIZE, InertialParameters
from estimators.inertial.estimate import DRAWS
from estimators.inertial.lifts import lift_equations
from estimators.inertial.parts import ellipsoid_of
from estimators.inertial.semidefinite import consistent_inertia
from estimators.particles.lifts import lifts_among
from testbed.errors import InvalidValueError
from testbed.objects.model import ObjectShape
from testbed.robot.calibration.static_poses import Calibration
from testbed.trajectory import Trajectory

LEVEL = 0.9
"""Probability of an interval."""
UNDETERMINED = 0.5
"""Half width of an interval, relative to the value, above which a moment of inertia is not determined. Ours."""
_ORDER = (0, 1, 2, 0, 0, 1), (0, 1, 2, 1, 2, 2)
"""Entries of an inertia in the order of UR's controllers: xx, yy, zz, xy, xz, yz."""


@dataclass(frozen=True, eq=False)
class Payload:
    """Mass, center of mass and inertia of a flange's payload, flange frame."""

    parameters: InertialParameters
    """Most likely body of positive density; its inertia is NaN where the trials do not show all of it."""
    draws: tuple[InertialParameters, ...]
    """Draws of the body from its posterior."""
    grasp: str = ""
    """Name of the grasp; empty where the payload is no object."""

    @staticmethod
    def of_lifts(
        shape: ObjectShape, trajectories: Sequence[Trajectory], *, with_tool: bool = False, grasp: str | None = None
    ) -> Payload:
        """Payload of an object from its lifts, in the sensor's frame of the first lift by the grasp.

        Args:
            shape: geometry.
            trajectories: trials; all but lifts that ended well are left out.
            with_tool: True adds the tool below the sensor, as the trials state it.
            grasp: name of the grasp; None where all lifts are by the same.

        Raises:
            InvalidValueError: no lift that ended well, none by that grasp, or several grasps and none named.
            HeftError: no physically consistent body explains the lifts.
        """
        lifts = [each for each in trajectories if each.action.in_air and each.ok]
        equations = lift_equations(shape, lifts)
        of = lifts_among(shape, lifts).items()
        names = list(dict.fromkeys(shape.grasps[window.grasp].name for _, (window, *_) in of))
        if grasp not in names and (grasp is not None or len(names) > 1):
            allowed = f"{', '.join(names)}: a grasp of the lifts; it decides the payload's frame"
            raise InvalidValueError("grasp", grasp, allowed)
        held = grasp or names[0]
        first, window = next((i, window) for i, (window, *_) in of if shape.grasps[window.grasp].name == held)
        found = consistent_inertia(equations, ellipsoid_of(shape))
        tool = lifts[first].tool
        assert tool is not None
        axes = window.from_sensor[:3, :3]
        tcp = np.append(shape.grasps[window.grasp].position, window.tcp_height)
        beside = InertialParameters(tool.mass, tool.com, tool.inertia).vector * with_tool

        def carried(body: InertialParameters) -> InertialParameters:
            in_sensor = body.moved(axes, tcp - axes @ tool.tcp)
            return InertialParameters.of_vector(in_sensor.vector + beside)

        drawn = tuple(carried(InertialParameters.of_vector(d)) for d in found.draws)
        best = carried(found.parameters)
        if equations.rank < SIZE:
            best = replace(best, inertia=np.full((3, 3), np.nan))
        return Payload(best, drawn, held)

    @staticmethod
    def of_poses(calibration: Calibration) -> Payload:
        """Payload of all mass below a sensor, sensor frame, from still poses, which show no inertia."""
        rng, unknown = np.random.default_rng(0), np.full((3, 3), np.nan)
        mass = rng.normal(calibration.mass, calibration.mass_std, DRAWS)
        center = rng.normal(calibration.com, calibration.com_std, (DRAWS, 3))
        drawn = tuple(InertialParameters(float(m), c, unknown) for m, c in zip(mass, center, strict=True))
        return Payload(InertialParameters(calibration.mass, calibration.com, unknown), drawn)

    def on_flange(self, rotation: Float[np.ndarray, "3 3"], origin: Float[np.ndarray, "3"]) -> Payload:
        """The payload in another frame, in which the present one has axes `rotation` (columns) and `origin` (m)."""
        into = rotation.T, -rotation.T @ origin
        return replace(self, parameters=self.parameters.moved(*into), draws=tuple(d.moved(*into) for d in self.draws))

    def interval(self, name: str) -> Float[np.ndarray, "2 ..."]:
        """Ends of the 90 % interval of `mass`, `center_of_mass` or `inertia`."""
        ends = (1 - LEVEL) / 2, (1 + LEVEL) / 2
        return np.quantile([getattr(each, name) for each in self.draws], ends, axis=0)

    @property
    def undetermined(self) -> list[str]:
        """Names of the moments of inertia whose relative error is above `UNDETERMINED` or unknown."""
        value, half = np.diag(self.parameters.inertia), np.diff(self.interval("inertia"), axis=0)[0].diagonal() / 2
        return [f"I{axis}{axis}" for axis, v, h in zip("xyz", value, half, strict=True) if not h < UNDETERMINED * v]


def as_json(payload: Payload) -> str:
    """All numbers with their intervals as JSON; null for those that are not observed."""
    body, units = payload.parameters, {"mass": "kg", "center_of_mass": "m", "inertia": "kg_m2"}
    table: dict[str, object] = {"frame": "flange; inertia about the center of mass, along the flange's axes"}
    for name, unit in units.items():
        for called, values in ((name, getattr(body, name)), (f"{name}_90", payload.interval(name))):
            table[f"{called}_{unit}"] = _plain(np.asarray(values, dtype=float).tolist())
    return json.dumps(table | {"not_determined": payload.undetermined}, indent=1) + "\n"


def _plain(value: list | float) -> list | float | None:
    """Numbers for JSON, None in place of NaN."""
    return [_plain(each) for each in value] if isinstance(value, list) else None if math.isnan(value) else value


def as_franka(payload: Payload) -> str:
    """Arguments of libfranka's `Robot::setLoad` and of the ROS 2 service SetLoad: the inertia column by column."""
    body = payload.parameters
    inertia = np.nan_to_num(body.inertia).flatten(order="F").tolist()  # that of a point where it is not observed
    table = {"mass": body.mass, "center_of_mass": body.center_of_mass.tolist(), "load_inertia": inertia}
    return json.dumps(table, indent=1) + "\n"


def as_ur(payload: Payload) -> str:
    """Line of URScript: set_target_payload with mass, center and, where it is observed, the inertia."""
    body, lists = payload.parameters, [payload.parameters.center_of_mass]
    if np.isfinite(body.inertia).all():
        lists.append(body.inertia[_ORDER])
    written = [f"[{', '.join(f'{value:.6g}' for value in each)}]" for each in lists]
    return f"set_target_payload({', '.join([f'{body.mass:.6g}', *written])})\n"


def as_kortex(payload: Payload) -> str:
    """Mass and center of a Kortex `ToolConfiguration`, which has no inertia, as protobuf's JSON."""
    center = dict(zip("xyz", payload.parameters.center_of_mass.tolist(), strict=True))
    return json.dumps({"tool_mass": payload.parameters.mass, "tool_mass_center": center}, indent=1) + "\n"


FORMATS: dict[str, Callable[[Payload], str]] = {"json": as_json, "franka": as_franka, "ur": as_ur, "kortex": as_kortex}
"""Writers of a payload by format name."""
