"""Block objects of one friction."""

from testbed.objects.blocks import block_object, parse_layout
from testbed.objects.model import ObjectModel


def blocks(
    rows: list[str],
    mass: list[float] | None = None,
    friction: float = 0.5,
    *,
    size: float = 0.05,
    height: float = 0.03,
    grid: int = 3,
) -> ObjectModel:
    """Blocks of a layout, of 0.4 kg each unless `mass` [kg] says otherwise."""
    cells = parse_layout(rows)
    mass, groups = mass or [0.4] * len(cells), [0] * len(cells)
    return block_object(
        "blocks", cells, size=size, height=height, mass=mass, friction=[friction], friction_group=groups, grid=grid
    )
