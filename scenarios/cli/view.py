"""Commands that show results in the viewer, as recordings, figures and films, and list the libraries."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np
import tyro
from rich.console import Console
from rich.table import Table
from rich.text import Text

from scenarios.cli.film import RenderRequest
from scenarios.cli.terminal import open_console, open_table, orderly_end
from testbed.errors import HeftError, InvalidValueError

if TYPE_CHECKING:
    from collections.abc import Iterator

    from testbed.objects.model import ObjectModel

NO_OPTIONS = RenderRequest()
PLA = 1.24
"""Density of printed PLA, solid, g/cm^3."""


def view(
    folder: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="DIR")],
    what: Annotated[tuple[str, ...], tyro.conf.Positional, tyro.conf.arg(metavar="[WHAT ...]")] = (),
    *,
    web: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False,
    port: Annotated[int | None, tyro.conf.arg(metavar="N")] = None,
    record: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False,
    all_: Annotated[bool, tyro.conf.arg(name="all"), tyro.conf.FlagCreatePairsOff] = False,
    figures: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False,
    report: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False,
    film: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False,
    options: Annotated[RenderRequest, tyro.conf.OmitArgPrefixes, tyro.conf.arg(name="film")] = NO_OPTIONS,
) -> None:
    """View a results folder in the Rerun viewer, or write recordings, figures, a report or a film.

    Without an option, the viewer opens on everything, on one object with every method, or on the trial or estimate
    whose key begins with WHAT (the report lists the keys).

    Examples: heft view results/blocks L2
              heft view results/blocks 3f9a --web --port 9090
              heft view results/blocks L2 3f9a --record
              heft view results/blocks --figures --report
              heft view results/blocks 3f9a --film --speed 4
              heft view results/blocks 3f9a --film --out turn.gif --camera above --width 480 --height 320 --fps 12.5

    Results on another machine: run `heft view DIR --web --port 9090` there and `ssh -L 9090:127.0.0.1:9090 THERE` here,
    and open the printed address in a browser here.

    Args:
        folder: results folder of a finished or running run.
        what: objects, or beginnings of keys of trials or estimates; default: everything.
        web: serve the viewer to a browser on this machine instead of opening a window.
        port: port of --web, for the page and its data; default: a free one.
        record: write Rerun recordings instead: DIR/recording.rrd, or DIR/recordings/WHAT.rrd; open them with
            `rerun FILE`.
        all_: with --record, write the missing recordings of all trials and estimates.
        figures: write figures as PDF and PNG to DIR/figures, of the run or of the estimates WHAT.
        report: rewrite DIR/report.html: tables, figures, failures, and the command that repeats the run.
        film: render trials as a film (.mp4, .gif) or one picture (.png), without a display; without WHAT, list them.
        options: with --film.
    """
    from scenarios.results.files import check_results

    if port is not None and not web:
        raise InvalidValueError("--port", port, "only with --web: a window needs none")
    if all_ and not record:
        raise InvalidValueError("--all", all_, "only with --record")
    if not film:
        for name, value in vars(options).items():
            if value != getattr(NO_OPTIONS, name):
                raise InvalidValueError(f"--{name}", value, "only with --film")
    check_results(folder)
    if not (record or figures or report or film):
        _open_viewer(folder, what, port or 0, web=web)
    if record:
        _record(folder, what, missing=all_)
    if figures:
        _draw_figures(folder, what)
    if report:
        from scenarios.views.report import report as write

        print(write(folder))
    if film:
        _draw_films(folder, what, options)


def _open_viewer(folder: Path, what: tuple[str, ...], port: int, *, web: bool) -> None:
    """Open a window, or serve a browser until an interrupt."""
    import tempfile

    from scenarios.views.pages import page_of
    from scenarios.views.show import serve
    from viz.recordings import viewer
    from viz.recordings.page import save

    if len(what) > 1:
        raise InvalidValueError("WHAT", " ".join(what), "one object or key at a time; several with --record")
    viewer.check_display(web=web)
    page = page_of(folder, what[0] if what else None)
    with orderly_end(), tempfile.TemporaryDirectory(prefix="heft-") as place:
        path = Path(place) / "page.rrd"
        save(page, path)
        if not web:
            viewer.open_file(path)
            return
        serve(path, port)


def _record(folder: Path, what: tuple[str, ...], *, missing: bool) -> None:
    """Write recordings of the named objects and keys, one of everything, or every missing one."""
    from scenarios.cli.run import show_progress
    from scenarios.views.pages import page_of, record_all, recording_path
    from viz.recordings.page import save

    if missing:
        with show_progress() as progress:
            record_all(folder, progress)
        return
    for name in what or [None]:
        path = folder / "recording.rrd" if name is None else recording_path(folder, name)
        save(page_of(folder, name), path)
        print(f"recording: {path}")


def _draw_figures(folder: Path, what: tuple[str, ...]) -> None:
    """Draw figures of a whole run, or of estimates: maps, bars, losses and wrench fits."""
    from scenarios.results.estimates import row_of
    from scenarios.views.figures import figures as draw

    for name in what or [None]:
        for path in draw(folder, None if name is None else row_of(folder, name)):
            print(f"figure: {path}")


def _draw_films(folder: Path, what: tuple[str, ...], options: RenderRequest) -> None:
    """Draw films or pictures of trials; list the trials by default."""
    from scenarios.cli.film import list_trials, render_trial
    from scenarios.cli.run import show_progress

    if not what:
        open_console().print(list_trials(folder))
    if options.out is not None and len(what) > 1:
        raise InvalidValueError("--out", str(options.out), "for one trial; else DIR/trials/TRIAL/trial.mp4")
    for trial in what:
        with show_progress() as progress:
            path, pace = render_trial(folder, trial, options, progress)
        paced = options.speed is None and pace != 1
        print(f"{path} ({pace:g} times as fast; --speed 1 is the trial's own time)" if paced else path)


def objects() -> None:
    """List the objects in the library."""
    from testbed.objects.files import load_object, object_names

    names = ("name", "grasps")
    table = open_table("name", "groups", "mass, kg", "grasps", left=names, title="Objects", title_justify="left")
    for name in object_names():
        model = load_object(name)
        grasps = " ".join(grasp.name for grasp in model.shape.grasps)
        table.add_row(name, str(model.shape.n_m), f"{model.total_mass:.3f}", grasps)
    open_console().print(table)


def scenarios() -> None:
    """List the scenarios in the library."""
    from scenarios.catalog import purpose, scenario_names

    listed = Table.grid(padding=(0, 2))
    for name in scenario_names():
        listed.add_row(name, purpose(name))
    open_console().print(listed)


def methods() -> None:
    """List the methods of heft and of installed packages, with their settings and defaults.

    Settings go into [methods.LABEL] of a scenario. heft run --methods accepts these names, and package:Class.
    """
    from estimators.registry import ESTIMATOR, METHODS, class_of
    from testbed.plugins import installed, settings_of

    listed, others = Table.grid(padding=(0, 2)), installed(ESTIMATOR)
    for name in [*METHODS, *(name for name in others if name not in METHODS)]:
        try:
            kind = class_of(name)
        except HeftError as error:  # the others are listed all the same
            listed.add_row(name, f"cannot be used: {error}")
            continue
        line = (kind.__doc__ or "").strip().partition("\n")[0]
        listed.add_row(name, "" if line.startswith(f"{kind.__name__}(") else line)  # a dataclass without a word
        listed.add_row("", f"[{', '.join(settings_of(kind)) or 'no settings'}]", style="dim")
        if name in METHODS and name in others:
            listed.add_row("", f"{others[name]} has this name too and is not used: name it by its path")
    open_console().print(listed)


def show(
    object_: Annotated[str, tyro.conf.Positional, tyro.conf.arg(name="object", metavar="OBJECT")],
    *,
    record: Annotated[Path | None, tyro.conf.arg(metavar="FILE.rrd")] = None,
    pads: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None,
) -> None:
    """Show one object: blocks, mass, center of mass, inertia and grasps.

    Examples: heft show hammer
              heft show docs/objects/T.toml --record results/T.rrd
              heft show pads.toml --pads results/pads

    Args:
        object_: name in the library, or path to a TOML file.
        record: also write a 3D recording of the object on the table with its parts, contact points and grasps.
        pads: output folder for STL files (mm) of pads to print and glue under an object with [feet].
    """
    from testbed.objects.files import load_object

    console, model = open_console(), load_object(object_, measured=True)
    if record is not None:
        from viz.recordings.page import save
        from viz.recordings.solid import object_page

        save(object_page(model), record)
        print(f"recording: {record}; look: rerun {record}")
    shape, com = model.shape, np.round(model.center_of_mass * 1e3, 1) + 0.0  # no -0.0
    facts = f": masses not given, {shape.height * 1e3:.0f} mm high"
    if model.masses_known:
        facts = (
            f": {model.total_mass:.3f} kg, center of mass ({com[0]:.1f}, {com[1]:.1f}) mm from the origin, "
            f"I_cm {model.inertia_cm:.5f} kg m^2, {shape.height * 1e3:.0f} mm high"
        )
    console.print(Text.assemble((model.name, "bold"), facts))
    (_show_solids if model.solids else _show_blocks)(console, model)
    _show_hinges(console, model)
    if pads is not None:
        for line in _write_pads(model, pads):
            print(line)


def _write_pads(model: ObjectModel, folder: Path) -> Iterator[str]:
    """Write a file for each kind of pad; yield a line with its size, its mass in PLA, and its groups."""
    from testbed.files import write_whole
    from testbed.objects.export import Pad

    kinds: dict[Pad, list[str]] = {}
    for group, name in enumerate(model.shape.group_names):
        kinds.setdefault(Pad.of(model.shape, group), []).append(name)
    for pad, names in kinds.items():
        mesh = pad.mesh()
        path = folder / f"{model.name}_{names[0]}.stl"
        write_whole(path, lambda part, mesh=mesh: mesh.export(part, file_type="stl"))
        size = " x ".join(f"{length:.1f}" for length in mesh.extents)
        grams = mesh.volume * 1e-3 * PLA
        yield f"{path}: {size} mm, {grams:.1f} g of PLA; print {len(names)}, for {', '.join(names)}"


def _show_blocks(console: Console, model: ObjectModel) -> None:
    """Print an object of blocks: drawing, blocks and grasps."""
    shape = model.shape
    console.print(drawing(model))
    table = open_table("block", "x, mm", "y, mm", "mass, kg", "friction", "gripped across")
    grasps = {grasp.name: "x" if abs(np.cos(grasp.angle)) > 0.5 else "y" for grasp in shape.grasps}
    for group, label in enumerate(shape.group_names):
        at = _millimeters(shape.particles[shape.mass_group == group].mean(axis=0))
        table.add_row(label, *at, _mass(model, group), _friction(model, group), grasps.get(label, "-"))
    for grasp in shape.grasps:
        if grasp.name not in shape.group_names:
            table.add_row(
                grasp.name, *_millimeters(grasp.position), "", "", f"{grasps[grasp.name]}, {grasp.width * 1e3:.0f} mm"
            )
    console.print(table)


def _show_solids(console: Console, model: ObjectModel) -> None:
    """Print an object of meshes: map of particles, mass groups and grasps."""
    shape = model.shape
    console.print(particle_map(model))
    groups = open_table("group", "on the map", "mass, kg", "particles", "touching", "friction")
    for group, label in enumerate(shape.group_names):
        own = shape.mass_group == group
        feet, letter = int((own & (shape.friction_group >= 0)).sum()), _letter(group)
        counts = (str(own.sum()), str(feet))
        groups.add_row(label, f"{letter} {letter.upper()}", _mass(model, group), *counts, _friction(model, group))
    columns = ("grasp", "x, mm", "y, mm", "closes, deg", "wide, mm", "long, mm", "high, mm")
    grasps = open_table(*columns, no_wrap=True)
    for grasp in shape.grasps:
        top = shape.height if grasp.top is None else grasp.top
        numbers = (*grasp.position * 1e3, np.degrees(grasp.angle), grasp.width * 1e3, grasp.length * 1e3)
        grasps.add_row(grasp.name, *(str(round(x)) for x in numbers), f"{grasp.bottom * 1e3:.0f} to {top * 1e3:.0f}")
    console.print(groups)
    console.print(grasps)


def _show_hinges(console: Console, model: ObjectModel) -> None:
    """Print the hinges of an object, their links and friction; nothing for a rigid object."""
    chain, names = model.shape.chain, np.array(model.shape.group_names)
    if chain is None:
        return
    table = open_table("hinge", "x, mm", "y, mm", "joins", "friction, mN m")
    for hinge, (place, torque) in enumerate(zip(chain.hinges, model.hinge_friction, strict=True)):
        links = (", ".join(names[chain.link == link]) for link in (hinge, hinge + 1))
        table.add_row(str(hinge), *_millimeters(place), " | ".join(links), f"{torque * 1e3:g}")
    console.print(table)


def _millimeters(place: np.ndarray) -> tuple[str, str]:
    """Coordinates from the object's origin, mm."""
    x, y = np.round(1e3 * place, 1) + 0.0  # no -0.0
    return f"{x:.1f}", f"{y:.1f}"


def _mass(model: ObjectModel, group: int) -> str:
    return f"{model.group_mass[group]:.3f}" if model.masses_known else "-"


def _friction(model: ObjectModel, group: int) -> str:
    touching = np.unique(model.shape.friction_group[model.shape.mass_group == group])
    return " ".join(f"{model.truth.friction[k]:g}" for k in touching if k >= 0) or "no contact"


def _letter(group: int) -> str:
    return chr(ord("a") + group % 26)


def particle_map(model: ObjectModel) -> str:
    """Map of the particles from above: a letter per mass group, a capital where a particle touches the table."""
    shape = model.shape
    low = shape.particles[~shape.is_contact].min(axis=0)
    column, row = np.maximum(np.round((shape.particles - low) / shape.cell), 0).astype(int).T
    cells = np.full((row.max() + 1, column.max() + 1), " ")
    for i, group in enumerate(shape.mass_group):
        letter = _letter(int(group))
        cells[row[i], column[i]] = letter.upper() if shape.friction_group[i] >= 0 else letter
    return "\n".join("  " + "".join(line).rstrip() for line in cells[::-1])


def drawing(model: ObjectModel) -> str:
    """Map of the groups, top row first: their masses in grams, or their names where masses are not given."""
    shape = model.shape
    centers = np.array([shape.particles[shape.mass_group == g].mean(axis=0) for g in range(shape.n_m)])
    side = shape.cell * np.sqrt(np.bincount(shape.mass_group[shape.cells]).max())
    column, row = np.round((centers - centers.min(axis=0)) / side).astype(int).T
    lines = []
    for r in range(row.max(), -1, -1):
        cells = ["     "] * (column.max() + 1)
        for group in np.flatnonzero(row == r):
            grams = f"{model.group_mass[group] * 1e3:3.0f}" if model.masses_known else f"{shape.group_names[group]:>3}"
            cells[column[group]] = f"[{grams}]"
        lines.append("  " + "".join(cells))
    return "\n".join(lines)
