"""Compiles the kernels of all scenes of this package and of the usual combinations, in two processes:

    python tools/compile_kernels.py
    python tools/compile_kernels.py --ship [SCENE...]

Combinations are those of elements, laws and ways to move in time, and a robot with an observer. Kernels
that are kept on disk are only read, and where nothing changed since the last time, nothing is done. With `--ship`, for a
release, also those of the Python of the README; then all entries that Python calls are put into the
package as `kernels.zip`, and what the scenes called as the list by which processes compile ahead.
Names of scenes limit the archive to these and the README.
"""

from __future__ import annotations

import logging
import lzma
import os
import pickle
import sys
import tempfile
import time
import warnings
from collections.abc import Sequence
from contextlib import suppress
from hashlib import sha256
from itertools import product
from multiprocessing import get_context
from pathlib import Path
from zipfile import ZIP_LZMA, ZipFile, ZipInfo

ROOT = Path(__file__).resolve().parents[1]
SCENES = ROOT / "config" / "scenes"
README = "README"
# These have the most kernels in common with others, and few with each other.
FIRST = ("bar", "trunk_device")
MODULI = "young_modulus: 200000.0"
LAWS = {
    **dict.fromkeys(("corotational", "linear", "neo_hookean", "saint_venant_kirchhoff"), MODULI),
    "mooney_rivlin": "constants: {c10: 30000.0, c01: 5000.0}",
    "ogden": "constants: {shear_moduli: [30000.0], exponents: [2.0]}",
    "yeoh": "constants: {c1: 30000.0, c2: 1000.0, c3: 0.0}",
}
ELEMENTS = {"bar": ("linear", "smoothed", "quadratic"), "bar_hexahedra": ("hexahedral",)}
MOTIONS = ("quasi_static", "dynamic")
# Kernels that nobody uses for a week are deleted [s].
KEPT = 5 * 24 * 3600

Job = tuple[str, tuple[str, ...]]


def jobs(names: Sequence[str]) -> list[Job]:
    """Scenes with changes of entries: those of these names, else all, and the usual combinations."""
    scenes = sorted((path.stem for path in SCENES.glob("*.yaml")), key=lambda name: name not in FIRST)
    found: list[Job] = [(name, ()) for name in names or scenes]
    if not names:
        found += [("diamond", ("observer={}",))]
        found += [
            (scene, (f"body.element={element}", f"integration={motion}",
                     f"body.material={{law: {law}, {constants}, poisson_ratio: 0.45, density: 1070.0}}"))
            for motion, (law, constants), scene in product(MOTIONS, LAWS.items(), ELEMENTS)
            for element in ELEMENTS[scene]
        ]  # fmt: skip
    return [*found, (README, ())]


def run(job: Job):
    """What a job called from Python, if nothing had to be compiled.

    Raises:
        RuntimeError: The scene cannot be built; other errors do not pass from process to process.
    """
    from softrobot_twin.errors import SoftRobotTwinError

    logging.disable(logging.WARNING)
    warnings.simplefilter("ignore")
    name, changes = job
    try:
        return run_readme() if name == README else run_scene(name, changes)
    except SoftRobotTwinError as error:
        raise RuntimeError(f"{name} {' '.join(changes)}: {error}") from None


def run_scene(name: str, changes: Sequence[str]):
    """Builds a scene and takes every path of a step and a tick; see `run`."""
    from softrobot_twin.control.loop_settings import LoopSettings, Mode
    from softrobot_twin.control.twin_loop import TwinLoop
    from softrobot_twin.errors import ParameterError
    from softrobot_twin.kernels import kernel_cache, kernels_ahead
    from softrobot_twin.scene import load_scene
    from softrobot_twin.shared_files import ScenePath
    from softrobot_twin.simulation import Simulation

    scene = load_scene(ScenePath(SCENES / f"{name}.yaml", changes))
    simulation = Simulation(scene)
    simulation.warm_up()
    for mode in Mode:
        with suppress(ParameterError):  # Not every scene has all modes.
            TwinLoop(simulation, LoopSettings(), mode).tick(0.0, 0)
    calls = tuple(
        (module, kernel, pickle.dumps(signature))
        for module, kernel, signature in kernel_cache.used.values() if "<locals>" not in kernel
    )  # fmt: skip
    return list(kernel_cache.used), kernels_ahead.SceneKernels(kernels_ahead.words_of(scene), calls)


def run_readme():
    """Runs the Python of the README, and what a twin computes in idle time; see `run`."""
    from softrobot_twin.analysis.mesh_error import MeshErrorEstimator
    from softrobot_twin.kernels import kernel_cache
    from softrobot_twin.scene import load_scene

    MeshErrorEstimator(load_scene(SCENES / "finger.yaml")).at_rest()
    code = (ROOT / "README.md").read_text(encoding="utf-8").partition("```python\n")[2]
    os.environ["MPLBACKEND"] = "agg"
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        exec(code.partition("```")[0], {})
        os.chdir(ROOT)
    return list(kernel_cache.used), None


def in_two_processes(work: Sequence[Job], **options):
    """What `run` returns for each job, in order, and how far it is, as text."""
    began = time.monotonic()
    with get_context("spawn").Pool(2, **options) as pool:
        for number, found in enumerate(pool.imap(run, work, chunksize=1), start=1):
            print(f"\rkernels of {number} of {len(work)} scenes, "
                  f"{time.monotonic() - began:.0f} s", end="", flush=True)  # fmt: skip
            yield found
    print()


def ship(work: Sequence[Job]) -> None:
    """Puts the entries that Python calls, which are all on disk, and their list into the package."""
    from softrobot_twin.kernels.kernel_cache import SHIPPED, kernel_folder
    from softrobot_twin.kernels.kernels_ahead import LIST

    # A process that compiles nothing asks for what Python calls, and for nothing else.
    found = list(in_two_processes(work, maxtasksperchild=1))
    with ZipFile(SHIPPED, "w", ZIP_LZMA) as archive:
        for name in sorted({name for names, _ in found for name in names}):
            # The same entries make the same archive.
            archive.writestr(ZipInfo(name), (kernel_folder() / name).read_bytes(), ZIP_LZMA)
    # What is the same for several scenes is written once.
    same: dict = {}
    scenes = [kernels._replace(kernels=tuple(same.setdefault(call, call) for call in kernels.kernels))
              for _, kernels in found if kernels is not None]  # fmt: skip
    LIST.write_bytes(lzma.compress(pickle.dumps(scenes)))
    for path in (SHIPPED, LIST):
        print(f"wrote {path.relative_to(ROOT)}, {path.stat().st_size / 1e6:.1f} MB")


def stamp() -> Path:
    """The file that says for some days that these sources have been here and all is compiled."""
    import numba

    from softrobot_twin.kernels.kernel_cache import kernel_folder

    state = sha256(repr((sys.version, numba.__version__, numba.config.CPU_NAME)).encode())
    for path in (Path(__file__), *sorted(SCENES.glob("*.yaml")),
                 *sorted((ROOT / "softrobot_twin").rglob("*.py"))):  # fmt: skip
        state.update(path.read_bytes())
    return kernel_folder() / f"all-{state.hexdigest()[:16]}.nbc"


def main(arguments: Sequence[str]) -> None:
    """Warms up all scenes."""
    if arguments[:1] == ["--ship"]:
        from softrobot_twin.kernels.kernel_cache import SHIPPED

        SHIPPED.unlink(missing_ok=True)
        work = jobs(arguments[1:])
        for _ in in_two_processes(work):
            pass
        ship(work)
    elif not (done := stamp()).exists() or time.time() - done.stat().st_mtime > KEPT:
        for _ in in_two_processes([job for job in jobs(()) if job[0] != README]):
            pass
        done.touch()


if __name__ == "__main__":
    main(sys.argv[1:])
