"""Actions of long recordings: shown as a table, and written as the [[logs]] tables of a mapping."""

from __future__ import annotations

import math
import os
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

from rich import box
from rich.table import Table
from rich.text import Text

from scenarios.cli.terminal import open_console
from scenarios.results.logs import placed_in
from testbed.actions.push import Push
from testbed.errors import HeftError, InvalidValueError
from testbed.files import write_text
from testbed.importers.logs import LogError
from testbed.importers.mapping import Mapping
from testbed.importers.segments import Segment, find_segments
from testbed.toml import load_toml, toml_text


def show_found(mapping: Path, logs: Sequence[Path], grasps: Sequence[str]) -> bool:
    """Print the segments of recordings, and write the mapping with a [[logs]] table for each action.

    Returns:
        True if all logs could be read; the others are named on stderr.

    Raises:
        HeftError: no log could be read, or the mapping or its *.found.toml is not as needed.
    """
    table = load_toml(mapping, Mapping)
    if table.logs or not logs:
        raise InvalidValueError("--find", mapping, "a mapping without [[logs]], and the recordings after it")
    if (path := mapping.with_suffix(".found.toml")).exists():
        raise InvalidValueError("--find", str(path), "no such file yet: --find writes it; rename or delete it")
    console, text, known = open_console(), mapping.read_text(encoding="utf-8").rstrip() + "\n", True
    failed: list[HeftError] = []
    for log in logs:
        try:
            found = find_segments(log, mapping, grasps)
        except HeftError as error:
            failed.append(placed_in(str(log), error))
            continue
        console.print(_table(log, found))
        known &= _check_grasps(found)
        text += "".join(_entries(os.path.relpath(log, mapping.parent), found, table.hand.closing_deg))
    if len(failed) == len(logs):
        raise LogError("\n".join(map(str, failed)))
    for error in failed:
        print(f"left out: {error}", file=sys.stderr)
    if known:
        write_text(path, text)
        print(f"{path}: review and correct it, then run heft import {path}")
    return not failed


def _table(log: Path, found: Sequence[Segment]) -> Table:
    table = Table(title=Text(str(log)), title_justify="left", box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0))
    for name in ("from s", "to s", "", "speed", "through", "center mm", "grasp", "tare from s"):
        words = name in ("", "grasp")
        table.add_column(name, justify="left" if words else "right", no_wrap=not words)
    for segment in found:
        cells = [f"{segment.from_s:.1f}", f"{segment.to_s:.1f}", segment.kind]
        if segment.action is not None:
            center = segment.center and f"({round(1e3 * segment.center[0])}, {round(1e3 * segment.center[1])})"
            cells[2] = _kind(segment)
            cells += [*_extent(segment), center or "", _place(segment)]
            cells.append(f"{segment.tare[0]:.1f}" if segment.tare else "none")
        elif segment.reason:
            cells += ["", "", "", segment.reason]
        table.add_row(*map(Text, cells), style="" if segment.action else "dim")
    table.caption, table.caption_justify = "center: from the middle between the pads, as they close and across", "left"
    return table


def _place(segment: Segment) -> str:
    """Grasps that an action fits, or the point and direction of a push."""
    action = segment.action
    if isinstance(action, Push):
        x, y = (f"{1e3 * value:.0f}" for value in action.point)
        return f"at ({x}, {y}) mm towards {math.degrees(action.direction):.0f} deg"
    return " or ".join(segment.grasps) or "none fits"


def _kind(segment: Segment) -> str:
    action = segment.action
    assert action is not None
    if action.pushes:
        return "push"
    if not action.turns:
        return "slide"
    side = "left" if action.steady[0].speed > 0 else "right"
    return f"{segment.kind} {side}{' and back' if getattr(action, 'back', False) else ''}"


def _extent(segment: Segment) -> tuple[str, str]:
    """Speed, and angle or distance, as text."""
    action = segment.action
    assert action is not None
    first = action.steady[0]
    if isinstance(action, Push):
        return f"{1e3 * action.speed:.1f} mm/s", f"{1e3 * action.length:.0f} mm"
    if not action.turns:
        return f"{1e3 * first.speed:.1f} mm/s", f"{1e3 * first.speed * first.seconds:.0f} mm"
    if action.accelerated:
        turned = math.degrees(abs(segment.closing_end[2] - segment.closing[2]))
        return f"{len(action.steady)} steps", f"{turned:.0f} deg"
    return f"{math.degrees(abs(first.speed)):.1f} deg/s", f"{math.degrees(abs(first.speed) * first.seconds):.0f} deg"


def _check_grasps(found: Sequence[Segment]) -> bool:
    """True if every grasp is known; otherwise print what to do."""
    actions = [segment for segment in found if segment.held]
    if all(len(action.grasps) == 1 for action in actions):
        return True
    if all(action.grasps for action in actions):
        several = " or ".join(actions[0].grasps)
        print(f"the motion is consistent with several grasps: name the first, --grasps NAME ({several})")
    else:
        print(
            "no grasps match the motion of the hand between the actions: tcp_in_hand_m, closing_deg or the object is "
            f"wrong; if the object was placed again, name the grasps of all {len(actions)} actions, --grasps NAME ..."
        )
    return False


def _entries(file: str, found: Sequence[Segment], closing_deg: float) -> Iterator[str]:
    """[[logs]] tables of the actions, with `phases` where heft import would not find the motion or tare."""
    for segment in found:
        action = segment.action
        if action is None:
            continue
        table = {name: value for name, value in action.to_dict().items() if value is not None}
        if not action.pushes:
            table["grasp"] = segment.grasps[0] if segment.grasps else 0
        line = toml_text({"action": [table]}).strip().removeprefix("action = [").removesuffix("]")
        times = {"file": file, "from_s": segment.trial[0], "to_s": segment.trial[1]}
        times |= {"closing_deg": closing_deg + 180.0} if segment.flipped else {}
        text = f"\n[[logs]]\n{toml_text(times)}action = {line}\n"
        if action.accelerated or action.pushes or not segment.alone:
            windows = [("tare", segment.tare)] if segment.tare else []
            windows += [("steady", window) for window in segment.steady]
            text += "phases = [\n"
            for phase, (begin, end) in windows:
                text += f'    {{ phase = "{phase}", from_s = {begin:g}, to_s = {end:g} }},\n'
            text += "]\n"
        yield text
