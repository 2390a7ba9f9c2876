"""Draws of a world: the true errors of one setup, and of each trial in it. Draws are hidden from every method."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from typing import Any, Self

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from testbed.actions.base import Action
from testbed.frames import rotation_2d
from testbed.objects.model import GRAVITY, Grasp, ObjectModel
from testbed.worlds.feet import LEAST_FRICTION, Feet
from testbed.worlds.presets import QUANTITIES, World
from testbed.worlds.seeds import new_secret, seed_of
from testbed.worlds.setup_errors import PARAMETERS
from testbed.worlds.surface import Surface


@dataclass(frozen=True)
class WorldDraw:
    """One draw of a world. Every quantity has its own random stream, which the sizes of others do not change."""

    world: World
    """Sizes of the errors."""
    seed: int
    """Seed, derived from a secret; with `repeat` it determines the draw."""
    repeat: int = 0
    """Number of the trial among those of one action: errors of grasp, start and encoders are drawn anew for each."""

    @classmethod
    def of(cls, world: World, model: ObjectModel, seed: int | str, secret: str | None = None) -> Self:
        """Draw of a world for an object.

        Args:
            world: sizes of the errors.
            model: the object.
            seed: number of the draw.
            secret: text from which the draws are seeded; a fresh one if left out, so that no draw repeats.
        """
        return cls(world, seed_of(new_secret() if secret is None else secret, "world", seed, model.name))

    @classmethod
    def in_record(cls, provenance: Mapping[str, str]) -> Self | None:
        """The draw behind a clean record, by its provenance; None for a record of the ideal world."""
        if "world" not in provenance:
            return None
        found = json.loads(provenance["world"])
        return cls(World(**found["world"]), found["seed"], found.get("repeat", 0))

    @property
    def provenance(self) -> dict[str, str]:
        """Entry of a clean record, which `draw_sensing` and `blinded` remove."""
        return {"world": json.dumps(self._content)}

    @property
    def _content(self) -> dict[str, Any]:
        """Fields as plain data; the repeat of an action only from the second trial on."""
        return {name: value for name, value in asdict(self).items() if name != "repeat" or value}

    def request(self, model: ObjectModel) -> dict[str, Any]:
        """Settings that decide the errors of an object's trials, as plain data, without those that it cannot have."""
        shape, content = model.shape, self._content
        sized = {name: described.sized(shape.n_m, len(shape.feet)) for name, described in PARAMETERS.items()}
        content["world"] = {
            name: size
            for name, size in content["world"].items()
            if name in {"name", *QUANTITIES} and 0 not in sized.get(name, ())
        }
        return content

    def rng(self, quantity: str, action: Action | None = None) -> np.random.Generator:
        """Random stream of a quantity, of the setup or of the trial of an action."""
        trial = "" if action is None else json.dumps(action.to_dict(), sort_keys=True)
        trial += f" {self.repeat}" if trial and self.repeat else ""
        return np.random.default_rng(seed_of("", self.seed, quantity, trial))

    def normal(self, quantity: str, count: int, action: Action | None = None) -> Float[np.ndarray, "count"]:
        """Drawn values of a quantity, `count` of the same standard deviation."""
        return getattr(self.world, quantity) * self.rng(quantity, action).standard_normal(count)

    def true_object(self, nominal: ObjectModel) -> ObjectModel:
        """Object with its mass groups at their true places; grasps stay, since the pads close on the faces."""
        if not self.world.particle_offset:
            return nominal
        shape = nominal.shape
        offset = self.normal("particle_offset", 2 * shape.n_m).reshape(-1, 2)
        level = np.hstack([offset, np.zeros((shape.n_m, 1))])
        moved = [replace(solid, vertices=solid.vertices + level[group]) for group, solid in enumerate(nominal.solids)]
        particles = shape.particles + offset[shape.mass_group]
        return replace(nominal, shape=replace(shape, particles=particles), solids=tuple(moved))

    def feet(self, body: ObjectModel) -> Feet:
        """Points of contact of an object and their mean friction."""
        points, known = int(self.world.contact_points), len(body.shape.feet)
        if known:
            offset = self.normal("foot_offset", 2 * known).reshape(-1, 2)
            feet = Feet.known(body, offset, self.normal("foot_load", known))
        else:
            feet = Feet.drawn(body, points, self.rng("contact_points")) if points else Feet.of(body)
        group = 1 + self.normal("group_friction", body.shape.n_m)
        along_x = self.normal("anisotropy", 1)[0]
        factor = np.outer(group[body.shape.mass_group[feet.particle]], [1 + along_x, 1 - along_x])
        height = self.normal("flatness", len(feet.particle)) * (not known)
        return replace(feet, height=height, friction=np.maximum(feet.friction * factor, LEAST_FRICTION))

    @property
    def surface(self) -> Surface | None:
        """Friction by place and speed; None if it is constant."""
        if not (self.world.place_friction or self.world.speed_friction):
            return None
        decade = self.normal("speed_friction", 1)[0]
        return Surface.drawn(self.world.place_friction, decade, self.rng("place_friction"))

    @property
    def gravity(self) -> Float[np.ndarray, "3"]:
        """Gravity [m/s^2] in the table's axes."""
        tilt = np.append(self.normal("table_tilt", 2), 0.0)
        return Rotation.from_rotvec(tilt).apply([0.0, 0.0, -GRAVITY])

    def grasp(self, nominal: Grasp, action: Action) -> Grasp:
        """True grasp of the pads on the object in a trial."""
        offset = rotation_2d(nominal.angle) @ self.normal("grasp_offset", 2, action)
        turn = self.normal("grasp_angle", 1, action)[0]
        return replace(nominal, position=nominal.position + offset, angle=nominal.angle + turn)

    def start(self, action: Action) -> Float[np.ndarray, "3"]:
        """Shift of the start of a trial on the table [m, m, rad]."""
        return np.append(self.normal("start_offset", 2, action), self.normal("start_angle", 1, action))
