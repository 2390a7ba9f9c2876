"""Outcomes of every fault of the real robot, over fakes: python bench/faults.py TABLE [runs of each], TABLE one of:

phases   in simulated time, each fault that the guard must see while a trial runs, in the middle of every phase: the
         longest time to the stop, and the longest way of the tool after the fault
moments  in simulated time, every kind of fault at random moments: after a stop, or after the arm's last feedback,
         nothing may drive the arm for longer than 150 ms; no record that is wrong by the fake's truth may be marked ok
wire     in real time, a program that drives the fake Gen3 at 20 mm/s under a guard, or stands, or closes the gripper;
         its processes are killed, frozen and signalled, and its connections reset; the fake does not stop by itself but
         in the last rows: the longest time to the first Stop command (100 ms are allowed), and the way of the tool

camera   in simulated time, a camera that sends wrong frames from the begin of a push and of a drag of links: what the
         record says, and the time to the stop where it is found at once

Exits with 1 where a bound was passed.
"""

from __future__ import annotations

import math
import re
import sys
from collections import Counter

from rich.table import Table
from shared import head_table, show

from testbed.trajectory import Trajectory
from testbed.trial import Trial
from tests.fakes.faults import BOUND, FAULTS, LIVE, Outcome, struck_by
from tests.fakes.gen3 import FakeGen3
from tests.fakes.lying_camera import DRAG, LIES, PUSH, Lie, begins
from tests.fakes.robot import robot_for, small_object
from tests.fakes.wire_faults import LAST, WIRE_FAULTS, freeze_both, stopped_after
from tests.fakes.wire_faults import PHASES as WIRE_PHASES
from tests.fakes.world import Gen3World

STOP_TIME = 0.1
"""Time within which a Stop must reach the arm [s]."""
ARM_TIME = 0.15
"""Time within which it must stop by itself after a silence of 100 ms [s]."""
GOES_ON = "went on"


def phases(runs: int) -> int:
    """Faults by phase; returns the number of those that passed their bound or are not in the record."""
    columns = ("fault", "stop after, ms", "slowest in", "way, mm", "furthest in", "ended", "the record says")
    table, bad = _table(*columns), 0
    for fault in LIVE:
        found = {phase: [struck_by(fault, seed, phase) for seed in range(runs)] for phase in fault.phases}
        stop = {phase: max(outcome.to_stop for outcome in outcomes) for phase, outcomes in found.items()}
        way = {phase: max(outcome.way for outcome in outcomes) for phase, outcomes in found.items()}
        everything = [outcome for outcomes in found.values() for outcome in outcomes]
        bad += sum(o.to_stop > fault.stops_in or fault.says not in o.reason or o.ended == "ok" for o in everything)
        table.add_row(
            fault.name,
            *(part for most in ((stop, 0), (way, 1)) for part in _most(*most)),
            _ends(everything),
            everything[-1].reason[:60],
        )
    show(table, width=170)
    print(f"{sum(len(fault.phases) for fault in LIVE) * runs} runs: {bad} too late or not in the record")
    return bad


def moments(runs: int) -> int:
    """Faults at random moments; returns the number of those that passed a bound."""
    table = _table("fault", "ended", "driven after stop, ms", "after loss, ms", "rolled, ms", "wrong ok")
    everything: list[Outcome] = []
    for fault in FAULTS:
        outcomes = [struck_by(fault, seed) for seed in range(runs)]
        everything += outcomes
        loss = [outcome.after_loss for outcome in outcomes if outcome.after_loss]
        table.add_row(
            fault.name,
            _ends(outcomes),
            f"{1e3 * max(outcome.after_stop for outcome in outcomes):.0f}",
            f"{1e3 * max(loss):.0f}" if loss else "",
            f"{1e3 * max(outcome.rolled for outcome in outcomes):.0f}",
            str(sum(bool(outcome.wrong) for outcome in outcomes)),
        )
    show(table, width=130)
    late, wrong = (
        sum(max(o.after_stop, o.after_loss) > BOUND for o in everything),
        sum(bool(o.wrong) for o in everything),
    )
    print(f"{len(everything)} runs: {late} driven too long, {wrong} wrongly ok")
    return late + wrong


def wire(runs: int) -> int:
    """Faults of programs; returns the number of those after which Stop came late, never, or the trial went on."""
    table, bad = _table("fault", "phase", "Stop after, ms", "way, mm", "the record says"), 0
    with FakeGen3(Gen3World(small_object())) as gen3:
        for name, fault in (*WIRE_FAULTS.items(), (LAST, freeze_both)):
            for phase in WIRE_PHASES:
                outcomes = [stopped_after(gen3, fault, phase, own_limit=name == LAST) for _ in range(runs)]
                stop, moved = max(o.stop_s for o in outcomes), max(o.moved_mm for o in outcomes)
                bad += sum(o.stop_s > (ARM_TIME if name == LAST else STOP_TIME) or GOES_ON in o.said for o in outcomes)
                table.add_row(name, phase, f"{1e3 * stop:.0f}", f"{moved:.1f}", outcomes[0].said[:90])
    show(table, width=190)
    print(f"{(len(WIRE_FAULTS) + 1) * len(WIRE_PHASES) * runs} runs: {bad} late, never stopped, or went on")
    return bad


def _lied_to(trial: Trial, lie: Lie, seed: int) -> tuple[Trajectory, float, float]:
    """Record of a trial, time from the first lie to the next stop [s], and way of the tool since then [m]."""
    robot, runner = robot_for(trial, begins(lie), seed=seed)
    with runner:
        record = runner.run(trial)
    at = robot.camera.lied_at
    return record, min((stop - at for stop in robot.arm.stopped if stop >= at), default=math.inf), robot.way_after(at)


def camera(runs: int) -> int:
    """Lies of a camera; returns the number of records that do not say so."""
    table, bad = _table("camera", "of", "Stop after, ms", "way, mm", "the record says"), 0
    for name, (lie, says) in LIES.items():
        for kind, trial in (("push", PUSH), ("links", DRAG)):
            outcomes = [_lied_to(trial, lie, seed) for seed in range(runs)]
            bad += sum(record.ok or re.search(says, record.reason) is None for record, _, _ in outcomes)
            stop, way = max(stop for _, stop, _ in outcomes), 1e3 * max(way for _, _, way in outcomes)
            live, record = f"{1e3 * stop:.0f}" if stop < 1 else "at the end", outcomes[0][0]
            table.add_row(name, kind, live, f"{way:.0f}", f"{record.status}: {record.reason[:80]}")
    show(table, width=170)
    print(f"{2 * len(LIES) * runs} runs: {bad} without a word")
    return bad


def _table(*columns: str) -> Table:
    return head_table(*columns, left=[name for name in columns if ", m" not in name])


def _ends(outcomes: list[Outcome]) -> str:
    return ", ".join(f"{count} {name}" for name, count in Counter(o.ended for o in outcomes).most_common())


def _most(values: dict[str, float], digits: int) -> tuple[str, str]:
    """Largest value [ms or mm], and its phase."""
    phase = max(values, key=lambda name: values[name])
    return f"{1e3 * values[phase]:.{digits}f}", phase


def main() -> None:
    """Print one of the tables."""
    table = {"phases": phases, "moments": moments, "wire": wire, "camera": camera}[sys.argv[1]]
    sys.exit(bool(table(int(sys.argv[2]) if len(sys.argv) > 2 else 1)))


if __name__ == "__main__":
    main()
