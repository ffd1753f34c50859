"""Draws what stiffness the Stifface renders: ``python tools/draw_stifface.py``.

- ``stifface_sweep.png``: the stiffness at the middle of the pad follows a profile while the touched
  point stays where it is. Beside the stiffness of the model at each step, presses of 1 mm are drawn:
  on the model, and on the finer pad with misplaced cables of ``stifface_device.yaml``, at the same
  lengths of its cables.
- ``stifface_reach.png``: the least and the greatest stiffness that a fingertip of 10 × 10 mm finds
  at each place of the pad, while that place is held within 0.1 mm, and their ratio.

Both are printed as numbers too.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import NamedTuple

import numpy as np
import yaml

from softrobot_twin.analysis.apparent_compliance import EffectorCompliance
from softrobot_twin.harness.figure import figure_file, legend_below
from softrobot_twin.harness.terminal import console, table
from softrobot_twin.scene import scene_from_mapping
from softrobot_twin.scene.loading import written_out
from softrobot_twin.simulation import CommandSetpoints, FollowTargets, Simulation, Touched

SCENES = Path(__file__).resolve().parents[1] / "config" / "scenes"
HELD = np.array([[0.0, 0.0, 0.022]])
"""Where the middle of the pad is held [m]."""
TIME_STEP = 0.02
PRESS_DEPTH, PRESS_STEPS = 1.0e-3, 4
"""Depth of a press [m], and the steps in which it is made."""
MOST_OFF = 1.0e-4
"""Distance of the touched place from where it is held up to which a stiffness counts as reached [m]."""
MOST_WRONG = 0.03
"""Error of a stiffness up to which it counts as reached."""
SETTLING = 25
"""Steps for each stiffness of a search."""
FACTOR = 1.06
"""Ratio of two stiffnesses that are tried one after the other."""


class Sweep(NamedTuple):
    """A stiffness profile that was followed.

    Attributes:
        times: [s], shape (step_count,).
        wanted: Profile [N/m], same shape.
        model: Stiffness of the model at each step [N/m], same shape.
        off: Distance of the touched place from where it is held [m], same shape.
        press_times: Times of presses [s], shape (press_count,).
        pressed: Force over depth of presses on the model [N/m], same shape.
        device: The same on the device, same shape.
    """

    times: np.ndarray
    wanted: np.ndarray
    model: np.ndarray
    off: np.ndarray
    press_times: np.ndarray
    pressed: np.ndarray
    device: np.ndarray


def profile(time: float) -> float:
    """Wanted stiffness [N/m] at a time [s]: held, raised, swung, and lowered at once."""
    if time < 2.0:
        return 200.0
    if time < 6.0:
        return 200.0 + 300.0 * (time - 2.0) / 4.0
    if time < 14.0:
        return 350.0 + 150.0 * np.cos(2.0 * np.pi * (time - 6.0) / 4.0)
    return 180.0


DURATION = 18.0


def press(simulation: Simulation, depth: float = PRESS_DEPTH) -> float:
    """Force by depth of a press along z [N/m]; the simulation is as it was afterwards."""
    before = simulation.state
    none = np.full_like(simulation.touches.points, np.nan)
    for share in np.linspace(0.0, 1.0, PRESS_STEPS + 1)[1:].tolist() + [1.0, 1.0]:
        place = before.memory["touches.points"].copy()
        place[:, 2] -= share * depth
        command = CommandSetpoints(before.setpoints, TIME_STEP)
        result = simulation.step(command, None, Touched(none, place))
    simulation.restore(before)
    return -float(result.touches.forces[0, 2]) / depth


def stiffness(compliance: EffectorCompliance) -> float:
    """Stiffness of the first effector along z [N/m]."""
    return 1.0 / float(compliance.at_state().compliance[0, 2, 2])


def wanted_along_z(value: float) -> np.ndarray:
    """Wanted stiffness [N/m] of the one effector, shape (1, 3)."""
    return np.array([[np.nan, np.nan, value]])


def sweep(duration: float = DURATION, device_scene: Path | None = None) -> Sweep:
    """Follows the profile.

    Args:
        duration: How much of it [s].
        device_scene: Scene of the device; None without a device.
    """
    twin = Simulation.from_scene_file(SCENES / "stifface.yaml")
    device = None if device_scene is None else Simulation.from_scene_file(device_scene)
    compliance = EffectorCompliance(twin)
    for _ in range(50):
        twin.step(FollowTargets(HELD, TIME_STEP, stiffness=wanted_along_z(profile(0.0))))
    rows, presses = [], []
    for step in range(round(duration / TIME_STEP)):
        time = step * TIME_STEP
        wanted = profile(time)
        result = twin.step(FollowTargets(HELD, TIME_STEP, stiffness=wanted_along_z(wanted)))
        rows.append((time, wanted, stiffness(compliance), result.effector_errors[0]))
        if step % 25 == 12:
            felt = np.nan
            if device is not None:
                # Its cables are shortened as much; they are attached elsewhere.
                lengths = device.rest_setpoints - result.displacements
                for _ in range(6):
                    device.step(CommandSetpoints(lengths, 1.0))
                felt = press(device)
            presses.append((time, press(twin), felt))
    return Sweep(*np.array(rows).T, *np.array(presses).T)


class Reach(NamedTuple):
    """Reachable stiffnesses at places of the pad.

    Attributes:
        places: x and y of the places at rest [m], shape (count, 2).
        least: [N/m], shape (count,).
        greatest: [N/m], same shape.
    """

    places: np.ndarray
    least: np.ndarray
    greatest: np.ndarray


def scene_touched_at(x: float, y: float) -> dict:
    """The Stifface with its fingertip at another place [m]."""
    mapping = written_out(yaml.safe_load((SCENES / "stifface.yaml").read_text()))
    mesh = mapping["body"]["mesh"]
    mesh["file"] = str((SCENES / mesh["file"]).resolve())
    for entry in (mapping["effectors"][0], mapping["touches"][0]):
        entry["points"] = [[x + point[0], y + point[1], point[2]] for point in entry["points"]]
    return mapping


def reach_at(x: float, y: float, nominal: np.ndarray) -> tuple[float, float]:
    """Least and greatest stiffness at a place [N/m].

    Args:
        x: The place at rest [m].
        y: Also.
        nominal: Lengths of the cables at which the pad has the shape that is held [m].
    """
    simulation = Simulation(scene_from_mapping(scene_touched_at(x, y)))
    compliance = EffectorCompliance(simulation)
    for _ in range(8):
        simulation.step(CommandSetpoints(nominal, 1.0))
    held, before = simulation.effector_positions(), simulation.state
    found = []
    for factor in (1.0 / FACTOR, FACTOR):
        simulation.restore(before)
        reached = wanted = stiffness(compliance)
        while True:
            wanted *= factor
            command = FollowTargets(held, TIME_STEP, stiffness=wanted_along_z(wanted))
            for _ in range(SETTLING):
                result = simulation.step(command)
            now = stiffness(compliance)
            is_held = result.effector_errors[0] <= MOST_OFF
            if not (is_held and abs(now - wanted) <= MOST_WRONG * wanted):
                break
            reached = now
        found.append(reached)
    return found[0], found[1]


def reach(spacing: float = 0.005) -> Reach:
    """Searches an eighth of the pad; the others are its mirror images.

    Args:
        spacing: Of the places along x and y [m].
    """
    simulation = Simulation.from_scene_file(SCENES / "stifface.yaml")
    for _ in range(60):
        result = simulation.step(FollowTargets(HELD, TIME_STEP, stiffness=wanted_along_z(250.0)))
    grid = np.arange(0.0, 0.0251, spacing)
    places = np.array([(x, y) for x in grid for y in grid if y <= x + 1e-9])
    found = np.array([reach_at(*place, result.setpoints) for place in places])
    return Reach(places, *found.T)


def draw_sweep(made: Sweep, path: Path) -> None:
    """Draws a sweep."""
    title = "Stifface: a stiffness profile at the middle of the pad"
    foot = (f"Presses: {1e3 * PRESS_DEPTH:g} mm, force by depth. The device has a finer mesh "
            "and cables attached up to 0.7 mm elsewhere; its cables have the twin's lengths.")
    with figure_file(path, (9.0, 6.0), title, foot) as figure:
        top, bottom = figure.subplots(2, 1, sharex=True, height_ratios=(3, 1))
        top.plot(made.times, made.wanted, color="#999999", lw=4, label="target")
        top.plot(made.times, made.model, color="#1f5fa8", lw=1.2, label="model")
        top.plot(made.press_times, made.pressed, "o", ms=4, color="#1f5fa8", mfc="none",
                 label="press on the model")
        top.plot(made.press_times, made.device, "x", ms=5, color="#c0392b",
                 label="press on the device")
        top.set_ylabel("stiffness [N/m]")
        top.set_ylim(0.0)
        legend_below(top, 8.0)
        bottom.semilogy(made.times, 100.0 * np.abs(made.model / made.wanted - 1.0),
                        color="#1f5fa8", label="error of the stiffness [%]")
        bottom.semilogy(made.times, 1e3 * made.off, color="#2e8b57",
                        label="distance of the place [mm]")
        bottom.axhline(3.0, color="#999999", lw=0.8)
        bottom.set_xlabel("time [s]")
        legend_below(bottom, 8.0)


def draw_reach(made: Reach, path: Path) -> None:
    """Draws reachable stiffnesses over the whole pad."""
    title = "Stifface: reachable stiffness over the pad, the touched place held within 0.1 mm"
    known = {tuple(np.round(place, 6)): (least, most)
             for place, least, most in zip(*made, strict=True)}  # fmt: skip
    half = np.unique(np.round(made.places[:, 0], 6))
    axis = np.concatenate([-half[:0:-1], half])
    pairs = [[known[max(abs(x), abs(y)), min(abs(x), abs(y))] for x in axis] for y in axis]
    least, most = np.moveaxis(np.array(pairs), -1, 0)
    step = 1e3 * (axis[1] - axis[0]) / 2.0
    extent = [1e3 * axis[0] - step, 1e3 * axis[-1] + step] * 2
    with figure_file(path, (12.0, 4.2), title) as figure:
        panels = (("least [N/m]", least, 0), ("greatest [N/m]", most, 0),
                  ("greatest / least", most / least, 1))
        for plot, (name, values, digits) in zip(figure.subplots(1, 3), panels, strict=True):
            shown = plot.imshow(values, origin="lower", extent=extent, cmap="viridis")
            plot.grid(visible=False)
            plot.set_title(name)
            plot.set_xlabel("x [mm]")
            plot.set_ylabel("y [mm]")
            figure.colorbar(shown, ax=plot)
            for (row, column), value in np.ndenumerate(values):
                if axis[column] >= 0.0 and axis[row] >= 0.0:
                    is_bright = shown.norm(value) > 0.6
                    plot.text(1e3 * axis[column], 1e3 * axis[row], f"{value:.{digits}f}",
                              ha="center", va="center", fontsize=6,
                              color="black" if is_bright else "white")


def main(arguments: list[str] | None = None) -> int:
    """Draws both; returns 0."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--output", type=Path, default=Path("docs"),
                        help="folder of the pictures (default: docs)")
    parser.add_argument("--only", choices=("sweep", "reach"), help="draw one of both")
    options = parser.parse_args(arguments)
    options.output.mkdir(parents=True, exist_ok=True)
    if options.only != "reach":
        made = sweep(device_scene=SCENES / "stifface_device.yaml")
        draw_sweep(made, options.output / "stifface_sweep.png")
        print_sweep(made)
    if options.only != "sweep":
        places = reach()
        draw_reach(places, options.output / "stifface_reach.png")
        print_reach(places)
    return 0


def print_sweep(made: Sweep) -> None:
    """Print the errors of a stiffness profile."""
    shown = table("A stiffness profile, 180 to 500 N/m", "what", "error, median", "greatest")
    settled = made.times >= 0.2
    # After the step down the cables need time, by their rates.
    settled &= (made.times < 14.0) | (made.times >= 14.4)
    aims = np.interp(made.press_times, made.times, made.wanted)
    for name, found, wanted in (
        ("the model at each step", made.model[settled], made.wanted[settled]),
        ("presses on the model", made.pressed, aims),
        ("presses on the device", made.device, aims),
    ):
        errors = 100.0 * np.abs(found / wanted - 1.0)
        shown.add_row(name, f"{np.median(errors):.2g} %", f"{errors.max():.2g} %")
    off = 1e3 * made.off[settled]
    shown.add_row("place of the point", f"{np.median(off):.2g} mm", f"{off.max():.2g} mm")
    console().print(shown)


def print_reach(made: Reach) -> None:
    """Print the stiffnesses that can be reached at each place."""
    shown = table("Reachable stiffness", "place [mm]", "least [N/m]", "greatest [N/m]", "ratio")
    for place, least, most in zip(*made, strict=True):
        x, y = 1e3 * place
        shown.add_row(f"{x:.0f}, {y:.0f}", f"{least:.0f}", f"{most:.0f}", f"{most / least:.2f}")
    console().print(shown)


if __name__ == "__main__":
    raise SystemExit(main())
