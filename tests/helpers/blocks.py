"""Block objects."""

from testbed.objects.blocks import block_object, parse_layout
from testbed.objects.model import ROBOTIQ_2F85, Hand, ObjectModel


def blocks(
    rows: list[str],
    mass: list[float] | None = None,
    friction: float | list[float] = 0.5,
    groups: list[int] | None = None,
    *,
    size: float = 0.05,
    height: float = 0.03,
    grid: int = 3,
    hand: Hand = ROBOTIQ_2F85,
    name: str = "blocks",
) -> ObjectModel:
    """Blocks of a layout, by default of 0.4 kg each and of one friction; `groups` are those of friction."""
    cells = parse_layout(rows)
    mass, groups = mass or [0.4] * len(cells), groups or [0] * len(cells)
    friction = friction if isinstance(friction, list) else [friction]
    sizes = {"size": size, "height": height, "grid": grid}
    return block_object(name, cells, mass=mass, friction=friction, friction_group=groups, hand=hand, **sizes)
