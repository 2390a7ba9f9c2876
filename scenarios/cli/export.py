"""heft export and payload: estimates as models and as payloads for other programs, trials as messages."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from testbed.errors import InvalidValueError, nearest

if TYPE_CHECKING:
    from collections.abc import Iterator

    import pandas as pd

    from estimators.evaluation.statistics import Row
    from estimators.inertial.payload import Payload
    from testbed.objects.export import Exported
    from testbed.objects.model import ObjectModel

_ENDING = {"mjcf": "xml", "urdf": "urdf", "sdf": "sdf", "toml": "toml", "mcap": "mcap"}


def export(
    folder: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="DIR")],
    what: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="ESTIMATE|TRIAL")],
    *,
    format_: Annotated[Literal["mjcf", "urdf", "sdf", "toml", "mcap"], tyro.conf.arg(name="format")] = "mjcf",
    inertial: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False,
    scene: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False,
    draws: Annotated[int | None, tyro.conf.arg(metavar="N")] = None,
    models: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False,
    out: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None,
) -> None:
    """Export an estimate to another simulator, with a box per block and a body per link, or a trial as ROS 2 messages.

    A JSON file beside a model contains the error of every mass; with the mapping beside an MCAP file, heft import reads
    it back.

    Examples: heft export results/blocks 3f9a
              heft export results/blocks 3f9a --scene --out L2.xml    (then python -m mujoco.viewer --mjcf L2.xml)
              heft export results/blocks 3f9a --format urdf --inertial --out my_robot/hammer.urdf
              heft export results/blocks 3f9a --draws 500
              heft export results/blocks 3f9a --draws 100 --models
              heft export results/lab 7c41 --format mcap

    Args:
        folder: results folder of a run.
        what: beginning of an estimate's key (see the report); with --format mcap, of a trial's key.
        format_: mjcf, urdf, sdf; toml: an object file that heft itself can run; mcap: a trial, for Foxglove,
            PlotJuggler, Rerun and ros2 bag.
        inertial: a single mass, center of mass and inertia for the object, or for each link, instead of blocks.
        scene: with mjcf, add a floor and a light, to open the file in MuJoCo's viewer.
        draws: also write N posterior draws of masses and frictions as CSV, of an estimate by hidden_states or bayes.
        models: also write each draw as a numbered model in a folder, to train or test a controller on all of them.
        out: output file; default: DIR/exports/OBJECT_KEY with the extension of the format.
    """
    from scenarios.results.files import check_results

    check_results(folder)
    if out is not None and out.suffix not in (f".{_ENDING[format_]}", f".{format_}"):
        raise InvalidValueError("--out", out, f"a file that ends in .{_ENDING[format_]}, for --format {format_}")
    if format_ == "mcap":
        for name, given in (("--inertial", inertial), ("--scene", scene), ("--draws", draws), ("--models", models)):
            if given:
                raise InvalidValueError(name, given, "of an estimate; --format mcap writes a trial")
        _export_trial(folder, what, out)
        return
    from scenarios.results.estimates import row_of
    from scenarios.results.files import inside
    from scenarios.views.figures import file_name
    from testbed.files import write_text, write_whole
    from testbed.objects.export import to_sidecar, written

    if models and draws is None:
        raise InvalidValueError("--models", True, "with --draws N")
    row = row_of(folder, what)
    exported = exported_of(folder, row)
    text = written(exported, format_, inertial=inertial, scene=scene)
    name = file_name(f"{exported.name}_{row['key'][:8]}.{_ENDING[format_]}")
    path = out or inside(folder, "exports", name)
    table = None if draws is None else posterior_table(folder, row, draws)  # refused before anything is written
    for file, content in ((path, text), (path.with_suffix(".json"), to_sidecar(exported))):
        write_text(file, content)
        print(file)
    if table is not None:
        write_whole(path.with_suffix(".draws.csv"), lambda part: table.to_csv(part, index=False))
        print(path.with_suffix(".draws.csv"))
        for number, drawn in enumerate(drawn_from(exported, table) if models else ()):
            file = path.with_suffix(".draws") / f"{number:04d}{path.suffix}"
            write_text(file, written(drawn, format_, inertial=inertial, scene=scene))
        if models:
            print(path.with_suffix(".draws"))


def payload(
    source: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="DIR|FILE.toml")],
    name: Annotated[str | None, tyro.conf.Positional, tyro.conf.arg(metavar="OBJECT")] = None,
    *,
    format_: Annotated[Literal["json", "franka", "ur", "kortex"], tyro.conf.arg(name="format")] = "json",
    grasp: Annotated[str | None, tyro.conf.arg(metavar="NAME")] = None,
    with_tool: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False,
    flange: Annotated[tuple[float, float, float, float], tyro.conf.arg(metavar="X Y Z DEG")] = (0.0, 0.0, 0.0, 0.0),
    out: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None,
) -> None:
    """Write the payload of a robot's flange for its controller: mass, center of mass and inertia, with intervals.

    Computed from the lifts of an object in DIR, or from the file of heft calibrate, which contains the mass and the
    center of mass of everything below the sensor, but no inertia. The numbers are physically consistent.

    Examples: heft payload results/lab drill
              heft payload results/lab drill --format ur --with-tool
              heft payload calibration.toml --format franka --flange 0 0 0.0127 45

    Args:
        source: results folder with lifts, or calibration file.
        name: object, if the folder has lifts of several.
        format_: json: all numbers; franka: arguments of setLoad; ur: a line of URScript; kortex: a ToolConfiguration.
        grasp: grasp by which the payload is held, if the object was lifted by several.
        with_tool: with lifts, add the tool below the sensor as stated by the trials.
        flange: position of the sensor frame in the flange frame [m], and its rotation about z [deg].
        out: output file; default: print.
    """
    import numpy as np

    from estimators.inertial.payload import FORMATS, Payload
    from testbed.files import write_text
    from testbed.frames import rotation_z
    from testbed.robot.calibration.file import load_calibration

    if source.is_dir():
        found = _lifted(source, name, grasp, with_tool=with_tool)
    elif not source.exists():
        raise InvalidValueError("DIR|FILE.toml", source, "a folder with lifts, or a file of heft calibrate")
    elif with_tool or name is not None or grasp is not None:
        raise InvalidValueError(
            "FILE.toml", source, "a folder with lifts: OBJECT, --grasp and --with-tool are of lifts"
        )
    else:
        found = Payload.of_poses(load_calibration(source))
    found = found.on_flange(rotation_z(math.radians(flange[3])), np.array(flange[:3]))
    body, mass = found.parameters, found.interval("mass")
    place = ", ".join(f"{1e3 * value:.1f}" for value in body.center_of_mass)
    low, high = (", ".join(f"{1e3 * value:.1f}" for value in end) for end in found.interval("center_of_mass"))
    print(f"mass {body.mass:.4f} kg [{mass[0]:.4f}, {mass[1]:.4f}], center ({place}) mm [({low}), ({high})]")
    if found.grasp:
        print(f"held by grasp {found.grasp}")
    if found.undetermined:
        print(f"not determined: {', '.join(found.undetermined)}")
    text = FORMATS[format_](found)
    if out is None:
        print(text, end="")
        return
    write_text(out, text)
    print(out)


def _lifted(folder: Path, name: str | None, grasp: str | None, *, with_tool: bool) -> Payload:
    """Payload of an object from the lifts of a folder."""
    from estimators.inertial.payload import Payload
    from scenarios.results.store import Store
    from scenarios.results.trials import keys_of, kind_of_trial, read_trial, recorded_order, sensed_trials
    from scenarios.views.values import sensing_of

    records = [read_trial(folder, key) for key in keys_of(folder) if kind_of_trial(folder, key) == "lift"]
    names = list(dict.fromkeys(record.object.name for record in records))
    if not names:
        raise InvalidValueError("DIR", folder, "a folder with lifts; a [policy] with lifts makes some")
    if (name is None and len(names) > 1) or name not in (None, *names):
        raise InvalidValueError("OBJECT", name, f"one of {', '.join(names)}{nearest(name or '', names)}")
    chosen = [record for record in records if record.object.name == (name or names[0])]
    keys = tuple(record.folder.name for record in sorted(chosen, key=recorded_order))
    trials = sensed_trials(Store(folder), keys, sensing_of(folder), 0)
    try:
        return Payload.of_lifts(chosen[0].object.shape, trials, with_tool=with_tool, grasp=grasp)
    except InvalidValueError as error:
        field = "--grasp" if error.field == "grasp" else error.field
        raise InvalidValueError(field, error.given, error.allowed) from None


def _export_trial(folder: Path, beginning: str, out: Path | None) -> None:
    """Write a trial as MCAP, with the mapping and the object file for `heft import` beside it."""
    from scenarios.results.files import inside
    from scenarios.results.trials import read_trial
    from scenarios.views.figures import file_name
    from testbed.exporters.ros2 import mapping_text, write_mcap
    from testbed.files import write_text
    from testbed.sensing.noise import draw_sensing
    from testbed.sensing.presets import preset

    record = read_trial(folder, beginning)
    shape, trajectory = record.object.shape, record.trajectory
    if trajectory.is_clean:  # a stored simulation is not tared yet
        trajectory = draw_sensing(trajectory, preset("ideal"), 0)
    name = file_name(f"{record.object.name}_{record.folder.name[:8]}.mcap")
    path = out or inside(folder, "exports", name)
    mapped, (called, text) = trajectory.action.on_table and trajectory.ok, _named_object(record.object)
    mapping = path.with_suffix(".toml")
    if mapped and mapping.name == called:
        raise InvalidValueError("--out", out, f"another name: {called} beside it is the object's file, not the mapping")
    write_mcap(trajectory, path)
    print(path)
    if not mapped:
        print("without a mapping: heft import reads turns, slides and pushes that are data")
        return
    texts = {mapping: mapping_text(trajectory, shape, called, path.name)}
    if text is not None:
        texts[path.with_name(called)] = text
    for file, content in texts.items():
        write_text(file, content)
        print(file)
    if called.endswith(".toml") and text is None:
        print(f"the mapping names {called}: put the object's file beside it")


def _named_object(model: ObjectModel) -> tuple[str, str | None]:
    """Name of an object for a mapping, and the text of its object file; None if it needs none, or cannot be written."""
    import numpy as np

    from testbed.errors import HeftError
    from testbed.objects.export import Exported, to_object_file
    from testbed.objects.files import load_object, object_names

    if model.name in object_names():
        ours = load_object(model.name, measured=True).shape.particles
        if np.array_equal(ours, model.shape.particles):
            return model.name, None
    name = f"{model.name}.toml"
    try:
        if not model.masses_known:
            return name, None
        exported = Exported(model.name, model.shape, model.truth, hinge_friction=model.hinge_friction)
        return name, to_object_file(exported)
    except HeftError:  # of meshes, which are files of their own
        return name, None


def posterior_table(folder: Path, row: Row, count: int) -> pd.DataFrame:
    """Draws from the joint posterior of a row's trials, one per row: mass of each group [kg], and frictions.

    Raises:
        InvalidValueError: an estimate of another method than hidden_states and bayes, or a count below 1.
    """
    import numpy as np
    import pandas as pd

    from estimators.evaluation.statistics import AXIS
    from estimators.hidden_states.estimator import HiddenStates
    from estimators.posterior.estimator import Bayes
    from estimators.registry import METHODS, build_method
    from scenarios.results.estimates import load_estimate
    from scenarios.results.files import read_manifest
    from scenarios.results.trials import trials_behind
    from scenarios.views.values import estimate_view
    from testbed.sensing.windows import weight_of

    if count < 1:
        raise InvalidValueError("--draws", count, "an integer from 1 on")
    scenario = (read_manifest(folder) or {}).get("scenario", {})
    kind = METHODS.get(row["kind"])  # of heft's own alone: a folder names no code to run
    answer, shape = load_estimate(folder, row["key"]), estimate_view(folder, row).shape
    prefix = f"{AXIS}methods.{row['method']}."
    swept = {name.removeprefix(prefix): value for name, value in row.items() if name.startswith(prefix)}
    settings = scenario.get("methods", {}).get(row["method"], {}) | swept | {"method": row["kind"]}
    method = build_method(row["kind"], settings) if kind else None
    if not isinstance(method, HiddenStates | Bayes) or answer.distribution is None:
        raise InvalidValueError("--draws", row["method"], "an estimate by hidden_states or bayes that has masses")
    weighing, *trials = trials_behind(folder, row)
    method = method if isinstance(method, Bayes) else Bayes()
    posterior = method.posterior(shape, weight_of(weighing), trials)
    assert posterior is not None
    table = np.hstack(posterior.draws(shape, count, seed=0))
    return pd.DataFrame(table, columns=[*shape.group_names, *shape.friction_names])


def drawn_from(exported: Exported, table: pd.DataFrame) -> Iterator[Exported]:
    """Object with the masses and frictions of each draw of a `posterior_table` in place of the estimate."""
    from testbed.objects.model import MassDistribution

    shape = exported.shape
    for number, values in enumerate(table.to_numpy()):
        at = MassDistribution(values[: shape.n_m] / shape.particles_per_group, values[shape.n_m :])
        notes = (*exported.notes, f"draw {number} from the posterior")
        yield replace(exported, distribution=at, covariance=None, notes=notes)


def exported_of(folder: Path, row: Row) -> Exported:
    """Masses of a row of the results for export, and the friction of hinges, estimated or the object's.

    Raises:
        InvalidValueError: the estimate has no masses.
    """
    import numpy as np

    from scenarios.views.values import estimate_view, typical_trial
    from testbed.objects.export import Exported

    view = estimate_view(folder, row)
    if view.answer is None:
        why = f"{row['status']}: {row['message']}"
        raise InvalidValueError("ESTIMATE", row["key"], f"one with masses; this one has none, {why}")
    why = f": {row['message']}" if row.get("message") else ""
    notes = (
        f"estimated by heft: {view.title}, draw {row['seed']}",
        f"status {row['status']}{why}",
        *([f"assumed, not tested: {row['assumes']}"] if row.get("assumes") else []),
        f"estimate {row['key']}",
    )
    exported = Exported(str(row["object"]), view.shape, view.answer, view.covariance, notes)
    if not exported.has_hinges:
        return exported
    own = typical_trial(folder, row).object.hinge_friction
    given = row.get("hinge_Nm")
    found = [math.nan] * len(own) if given is None else np.array(given, dtype=float).tolist()
    torques, more = [], []
    for index, torque in enumerate(found):
        if math.isnan(torque):
            more.append(f"friction of hinge_{index} not estimated: the object's own")
        elif torque < 0:
            more.append(f"friction of hinge_{index} estimated as {torque:.4g} N m, written as 0")
        torques.append(own[index] if math.isnan(torque) else max(torque, 0.0))
    whole = not any(map(math.isnan, found))
    deviation = tuple(float(std) for std in row["hinge_error_Nm"]) if whole else None
    return replace(exported, notes=(*notes, *more), hinge_friction=tuple(torques), hinge_deviation=deviation)
