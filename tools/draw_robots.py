"""Draws the pictures of the robots in docs/ anew: ``python tools/draw_robots.py [ROBOT ...]``.

Each picture is made by one command of the package, which is printed. All take some minutes.
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

from softrobot_twin.__main__ import main

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


if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", metavar="ROBOT", nargs="*",
                        help=f"pictures to draw (default all): {', '.join(PICTURES)}")
    parser.add_argument("--folder", type=Path, default=ROOT / "docs",
                        help="where to write them (default docs/)")
    chosen = parser.parse_args()
    if unknown := set(chosen.names) - set(PICTURES):
        parser.error(f"there is no picture {', '.join(sorted(unknown))}")
    sys.exit(draw(chosen.names or list(PICTURES), chosen.folder))
