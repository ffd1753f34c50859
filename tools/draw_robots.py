"""Draws the pictures of the robots in docs/ anew: ``python tools/draw_robots.py [ROBOT ...]``.

Each picture is made by one command of the package, which is printed. All take some minutes. With
``--moving`` the robots of the README are drawn as moving pictures of the same runs.
`docs/tracking.png` is the picture of a live demo (`make demo`), `tools/draw_stifface.py` draws what
stiffness the Stifface renders, and `accuracy` draws the pictures of accuracy.
"""

from __future__ import annotations

import argparse
import contextlib
import shlex
import sys
import tempfile
from pathlib import Path

import numpy as np
from PIL import Image

from softrobot_twin.__main__ import main
from softrobot_twin.simulation import Simulation
from softrobot_twin.study import direct_run, offline_run
from softrobot_twin.study.scene_picture import take_snapshot
from softrobot_twin.study.triangle_drawing import Solid, camera_at, image_of
from softrobot_twin.tables.input_tables import read_commands, read_targets
from softrobot_twin.tables.run_columns import RunColumns

ROOT = Path(__file__).resolve().parents[1]

PICTURES = {
    "diamond": "simulate config/scenes/diamond.yaml --targets config/targets/diamond_circle.csv "
               "--settle 40",
    "finger": "simulate config/scenes/finger.yaml --commands config/commands/finger_bend.csv "
              "--picture-at 0.2 2.5 6 --picture-view 10 -75",
    "trunk": "simulate config/scenes/trunk_cylinders.yaml --targets config/targets/trunk_beyond.csv "
             "--settle 40",
    "grasper": "simulate config/scenes/grasper.yaml --commands config/commands/grasper_lift.csv "
               "--picture-at 0.2 2 14 --picture-view 14 -50",
    "octoleg": "simulate config/scenes/octoleg.yaml --commands config/commands/octoleg_curl.csv "
               "--picture-at 0.2 2 6 --picture-view 12 -80",
    "springy": "simulate config/scenes/springy.yaml --commands config/commands/springy_grow.csv "
               "--rate 50 --picture-at 0.2 2 5 --picture-view 10 -60",
    "pneunet": "simulate config/scenes/pneunet.yaml --commands config/commands/pneunet_lift.csv "
               "--rate 100 --picture-at 0.2 2 14 --picture-view 14 -50",
    "fast_pneunet": "simulate config/scenes/fast_pneunet.yaml --commands "
                    "config/commands/fast_pneunet_curl.csv --rate 20 --picture-at 0.1 2 4.5 "
                    "--picture-view 12 -75",
    "finray": "simulate config/scenes/finray.yaml --commands config/commands/finray_press.csv "
              "--rate 50 --picture-at 0.1 2 4 --picture-view 8 -75",
    "tdcr": "simulate config/scenes/tdcr.yaml --commands config/commands/tdcr_bend.csv --rate 50 "
            "--picture-at 0.1 2 4.4 --picture-view 10 -70",
    "segment": "simulate config/scenes/segment.yaml --commands config/commands/segment_bend.csv "
               "--rate 50 --picture-at 0.2 3 8 --picture-view 10 35",
    "strider": "simulate config/scenes/strider.yaml --commands config/commands/strider_sway.csv "
               "--rate 50 --picture-at 0.2 1.2 3.2 --picture-view 14 -60",
    "fetch": "simulate config/scenes/fetch_reduced.yaml --commands config/commands/fetch_tilt.csv "
             "--rate 20 --picture-at 0.1 1.5 3 --picture-view 10 -60",
    "stifface": "simulate config/scenes/stifface.yaml --commands config/commands/stifface_press.csv "
                "--rate 50 --picture-at 0.2 0.7 2.7 --picture-view 22 -60",
    "flexo": "simulate config/scenes/flexo.yaml --commands config/commands/flexo_grasp.csv "
             "--rate 100 --picture-at 0.5 7 10 --picture-view 10 -60",
    "emio": "simulate config/scenes/emio.yaml --commands config/commands/emio_sway.csv "
            "--rate 50 --picture-at 0.2 1.2 3.2 --picture-view 14 -60",
    "emio_reach": "workspace config/scenes/emio.yaml --samples 400",
    "workspace": "workspace config/scenes/diamond.yaml --samples 160",
    "explained": "explain config/scenes/diamond.yaml --no-mesh-error",
}
"""Command of each picture, without the files that it writes."""


def arguments_of(name: str, folder: Path, tables: Path) -> list[str]:
    """Arguments of the command that draws a picture.

    Args:
        name: Name of the picture.
        folder: Folder of the picture.
        tables: Folder of the table that some commands write too.
    """
    words = shlex.split(PICTURES[name]) + ["--picture", str(folder / f"{name}.png")]
    if words[0] != "explain":
        words += ["--output", str(tables / f"{name}.csv")]
    return words


def draw(names: list[str], folder: Path) -> int:
    """Draws pictures; returns 1 if a command failed, else 0."""
    failed, folder = False, folder.resolve()
    with tempfile.TemporaryDirectory() as tables, contextlib.chdir(ROOT):
        for name in names:
            words = arguments_of(name, folder, Path(tables))
            print(f"softrobot_twin {shlex.join(words)}", flush=True)
            # 1 tells of rows that did not converge, such as targets beyond reach.
            failed |= main(words) not in (0, 1)
    return int(failed)


MOVING = ("diamond", "trunk", "grasper", "octoleg", "fetch", "flexo", "stifface")
FRAMES, FRAME_TIME = 36, 110
"""How many frames a moving picture has, and how long each is shown [ms]."""
WIDTH, HEIGHT = 320, 260
"""Most pixels of a moving picture."""


def draw_moving(name: str, folder: Path) -> None:
    """Draws the run of a robot's picture as a moving picture.

    Args:
        name: Name of the picture.
        folder: Folder of the picture.
    """
    reader = argparse.ArgumentParser()
    for option, kind in (("--targets", Path), ("--commands", Path), ("--rate", float), ("--settle", int)):
        reader.add_argument(option, type=kind)
    reader.add_argument("--picture-view", nargs=2, type=float, default=(24.0, -58.0))
    reader.add_argument("--picture-at", nargs="*")
    words = shlex.split(PICTURES[name])
    chosen = reader.parse_args(words[2:])
    simulation = Simulation.from_scene_file(words[1])
    if chosen.targets:
        table = read_targets(chosen.targets, simulation)
        rows = offline_run.run(simulation, table, chosen.settle or 0, offline_run.columns_of(simulation, table))
        count = len(table.times)
    else:
        table, rate = read_commands(chosen.commands, simulation), chosen.rate or direct_run.DEFAULT_RATE
        rows = direct_run.run_commands(simulation, table, rate, RunColumns(simulation, None, ()))
        count = len(direct_run.step_times(table, rate))
    taken = set(np.linspace(0, count - 1, FRAMES).astype(int))
    frames = [take_snapshot(simulation, None, "").solids for place, _ in enumerate(rows) if place in taken]
    images = list(map(Image.fromarray, images_of(frames, chosen.picture_view)))
    path = folder / f"{name}.webp"
    images[0].save(path, save_all=True, append_images=[*images[1:], *images[-2:0:-1]],
                   duration=FRAME_TIME, loop=0, quality=60, method=6)
    print(f"{path}: {path.stat().st_size / 1e3:.0f} kB", flush=True)


def images_of(frames: list[list[Solid]], view: tuple[float, float]) -> list[np.ndarray]:
    """Images of states, all in one window, each of shape (rows, columns, 3).

    Args:
        frames: What is seen in each state.
        view: Elevation and azimuth of the eye [degrees].
    """
    camera = camera_at(*view)
    places = camera.project(np.concatenate(
        [solid.triangles.reshape(-1, 3) for solids in frames for solid in solids]))[:, :2]
    low, high = places.min(axis=0), places.max(axis=0)
    margin = 0.02 * (high - low).max()
    low, high = low - margin, high + margin
    scale = min(np.array([WIDTH, HEIGHT]) / (high - low))
    columns, rows = np.round(scale * (high - low)).astype(int)
    return [image_of(solids, camera, (low[0], high[0], low[1], high[1]), (rows, columns))
            for solids in frames]


if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", metavar="ROBOT", nargs="*",
                        help=f"pictures to draw (default all): {', '.join(PICTURES)}")
    parser.add_argument("--folder", type=Path, default=ROOT / "docs",
                        help="where to write them (default docs/)")
    parser.add_argument("--moving", action="store_true",
                        help=f"draw moving pictures: {', '.join(MOVING)}")
    chosen = parser.parse_args()
    if chosen.moving:
        for name in chosen.names or MOVING:
            draw_moving(name, chosen.folder)
        sys.exit()
    if unknown := set(chosen.names) - set(PICTURES):
        parser.error(f"there is no picture {', '.join(sorted(unknown))}")
    sys.exit(draw(chosen.names or list(PICTURES), chosen.folder))
