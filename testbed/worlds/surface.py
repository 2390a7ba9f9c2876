"""Friction of a table's surface: by place and by speed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from testbed.validation import freeze_arrays

WAVELENGTH = (0.1, 0.4)
"""Least and greatest wavelength of the field of friction [m]."""
WAVES = 12
"""Waves of the field."""
REFERENCE_SPEED = 0.02
"""Speed at which friction is the stated one [m/s]."""
_SPEEDS = (1e-4, 1.0)
_LEAST = 0.1


@dataclass(frozen=True, eq=False)
class Surface:
    """Friction relative to its mean, by place and by speed."""

    wave: Float[np.ndarray, "K 2"]
    """Wave vectors of the field [rad/m]."""
    phase: Float[np.ndarray, "K"]
    """Phases of its waves [rad]."""
    amplitude: float
    """Amplitude of each wave, as a part of the mean friction."""
    decade: float
    """Change of friction with a tenfold speed, as a part of it."""

    def __post_init__(self) -> None:
        freeze_arrays(self, wave=(None, 2), phase=(len(self.wave),))

    @staticmethod
    def drawn(place: float, decade: float, rng: np.random.Generator) -> Surface:
        """Surface with a smooth random field of standard deviation `place`, and a change with speed."""
        length, way = rng.uniform(*WAVELENGTH, WAVES), rng.uniform(0, 2 * np.pi, WAVES)
        wave = 2 * np.pi / length[:, None] * np.column_stack([np.cos(way), np.sin(way)])
        return Surface(wave, rng.uniform(0, 2 * np.pi, WAVES), place * (2 / WAVES) ** 0.5, decade)

    def factor(self, position: Float[np.ndarray, "F 2"], speed: Float[np.ndarray, "F"]) -> Float[np.ndarray, "F"]:
        """Friction of feet relative to its mean, at positions [m], world, and speeds [m/s], (F,)."""
        field = 1 + self.amplitude * np.cos(position @ self.wave.T + self.phase).sum(axis=1)
        decades = np.log10(np.clip(speed, *_SPEEDS) / REFERENCE_SPEED)
        return np.maximum(field * (1 + self.decade * decades), _LEAST)
