"""Actions of long recordings: shown as a table, and written as the [[logs]] tables of a mapping."""

from __future__ import annotations

import math
import os
from collections.abc import Iterator, Sequence
from pathlib import Path

from rich import box
from rich.table import Table
from rich.text import Text

from scenarios.cli.terminal import open_console
from testbed.errors import InvalidValueError
from testbed.files import write_whole
from testbed.importers.mapping import Mapping
from testbed.importers.segments import Segment, find_segments
from testbed.toml import load_toml, toml_text


def show_found(mapping: Path, logs: Sequence[Path], grasps: Sequence[str]) -> None:
    """Print the segments of recordings, and write the mapping with a [[logs]] table for each action.

    Raises:
        HeftError: a file is not what it should be, or the grasps are ambiguous.
    """
    table = load_toml(mapping, Mapping)
    if table.logs or not logs:
        raise InvalidValueError("--find", str(mapping), "a mapping without [[logs]], and the recordings after it")
    console, text, known = open_console(), mapping.read_text(encoding="utf-8").rstrip() + "\n", True
    for log in logs:
        found = find_segments(log, mapping, grasps)
        console.print(_table(log, found))
        known &= _say_grasps(found)
        text += "".join(_entries(os.path.relpath(log, mapping.parent), found, table.hand.closing_deg))
    if known:
        path = mapping.with_suffix(".found.toml")
        write_whole(path, lambda part: part.write_text(text, encoding="utf-8"))
        print(f"{path}: look it through, correct what is wrong, then heft import {path}")


def _table(log: Path, found: Sequence[Segment]) -> Table:
    """Segments down."""
    table = Table(title=Text(str(log)), title_justify="left", box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0))
    for name in ("from s", "to s", "", "speed", "through", "center mm", "grasp", "tare from s"):
        words = name in ("", "grasp")
        table.add_column(name, justify="left" if words else "right", no_wrap=not words)
    for segment in found:
        cells = [f"{segment.from_s:.1f}", f"{segment.to_s:.1f}", segment.kind]
        if segment.action is not None:
            center = segment.center and f"({1e3 * segment.center[0]:.0f}, {1e3 * segment.center[1]:.0f})"
            cells[2] = _kind(segment)
            cells += [*_extent(segment), center or "", " or ".join(segment.grasps) or "none fits"]
            cells.append(f"{segment.tare[0]:.1f}" if segment.tare else "none")
        table.add_row(*map(Text, cells), style="" if segment.action else "dim")
    table.caption, table.caption_justify = "center: from the middle between the pads, as they close and across", "left"
    return table


def _kind(segment: Segment) -> str:
    action = segment.action
    assert action is not None
    if not action.turns:
        return "slide"
    side = "left" if action.steady[0].speed > 0 else "right"
    return f"{segment.kind} {side}{' and back' if getattr(action, 'back', False) else ''}"


def _extent(segment: Segment) -> tuple[str, str]:
    """Speed, and angle or way, as people say them."""
    action = segment.action
    assert action is not None
    first = action.steady[0]
    if not action.turns:
        return f"{1e3 * first.speed:.1f} mm/s", f"{1e3 * first.speed * first.seconds:.0f} mm"
    if action.accelerated:
        turned = math.degrees(abs(segment.closing_end[2] - segment.closing[2]))
        return f"{len(action.steady)} steps", f"{turned:.0f} deg"
    return f"{math.degrees(abs(first.speed)):.1f} deg/s", f"{math.degrees(abs(first.speed) * first.seconds):.0f} deg"


def _say_grasps(found: Sequence[Segment]) -> bool:
    """True if every grasp is known; else what to do is printed."""
    actions = [segment for segment in found if segment.action or segment.kind == "other motion"]
    if all(len(action.grasps) == 1 for action in actions):
        return True
    if all(action.grasps for action in actions):
        several = " or ".join(actions[0].grasps)
        print(f"the motion fits several grasps: name the first, --grasps NAME ({several})")
    else:
        print(
            "no grasps lie as the hand went from one action to the next: tcp_in_hand_m, closing_deg or the object is "
            f"wrong; or it was laid anew: then name the grasps of all {len(actions)} actions, --grasps NAME ..."
        )
    return False


def _entries(file: str, found: Sequence[Segment], closing_deg: float) -> Iterator[str]:
    """[[logs]] tables of the actions. One whose motion or tare heft import would not find has its [[phases]]."""
    for segment in found:
        action = segment.action
        if action is None or segment.tare is None:
            continue
        given = {name: value for name, value in action.to_dict().items() if name != "grasp" and value is not None}
        said = {"kind": given.pop("kind"), "grasp": segment.grasps[0] if segment.grasps else 0, **given}
        line = toml_text({"action": [said]}).strip().removeprefix("action = [").removesuffix("]")
        times = {"file": file, "from_s": segment.trial[0], "to_s": segment.trial[1]}
        times |= {"closing_deg": closing_deg + 180.0} if segment.flipped else {}
        text = f"\n[[logs]]\n{toml_text(times)}action = {line}\n"
        if action.accelerated or not segment.alone:
            windows = [("tare", segment.tare), *(("steady", window) for window in segment.steady)]
            text += "phases = [\n"
            for phase, (begin, end) in windows:
                text += f'    {{ phase = "{phase}", from_s = {begin:g}, to_s = {end:g} }},\n'
            text += "]\n"
        yield text
