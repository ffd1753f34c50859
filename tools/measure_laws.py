"""Time of the assembly with each material law, beside that of the corotational one.

    python tools/measure_laws.py [SCENE] [--element linear] [--steps 60]

All laws are timed in turn in one process, by the time of its thread, and medians are compared, so that
a busy machine slows all of them. The body is stretched a little; its law is replaced.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from time import thread_time

import numpy as np

from softrobot_twin.mechanics.elements import Elements
from softrobot_twin.mechanics.laws import law_named
from softrobot_twin.scene import load_scene
from softrobot_twin.simulation.build import build_model

DEFAULT = Path(__file__).resolve().parents[1] / "config" / "scenes" / "diamond.yaml"
YOUNG, POISSON = 1.8e5, 0.45
SHEAR, BULK = YOUNG / (2.0 + 2.0 * POISSON), YOUNG / (3.0 - 6.0 * POISSON)
CONSTANTS = {
    "mooney_rivlin": {"c10": 0.35 * SHEAR, "c01": 0.15 * SHEAR},
    "yeoh": {"c1": 0.5 * SHEAR, "c2": -0.005 * SHEAR, "c3": 0.0005 * SHEAR},
    "ogden": {"shear_moduli": (1.2 * SHEAR, 0.05 * SHEAR), "exponents": (1.5, 4.0)},
}
LAWS = ("corotational", "saint_venant_kirchhoff", "neo_hookean", *CONSTANTS)
STRETCH = (1.02, 0.99, 1.01)


def parameters_of(law: str) -> tuple:
    """Parameters of a law with the moduli above at rest."""
    own = law_named(law).own
    if own is None:
        return law_named(law).of_moduli(YOUNG, POISSON)
    return own.parameters(CONSTANTS[law], BULK)


class Timed:
    """The elements of a model with one law."""

    def __init__(self, scene, law: str):
        """Build the scene and put the law in."""
        self._model = build_model(scene, None, False)
        (self._term,) = [term for term in self._model.forces if type(term) is Elements]
        self._term.law = parameters_of(law)
        self._positions = self._model.nodes.rest_positions * STRETCH
        self._forces = np.zeros((self._model.nodes.free_node_count, 3))

    def seconds(self, projected: bool) -> float:
        """Time of one assembly of forces and stiffness at a new state [s]."""
        factorization = self._model.factorization
        factorization.clear()
        self._positions[0] += 1.0e-9  # Forces of a state that is known are not computed again.
        begin = thread_time()
        self._term.add(self._positions, self._forces, factorization.storage, projected)
        return thread_time() - begin


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scene", nargs="?", type=Path, default=DEFAULT)
    parser.add_argument("--element", default="linear")
    parser.add_argument("--steps", type=int, default=60)
    chosen = parser.parse_args()
    scene = load_scene(chosen.scene)
    terms = {}
    for law in LAWS:
        material = scene.body.material.model_copy(update={
            "law": law, "constants": CONSTANTS.get(law), "poisson_ratio": POISSON,
            "young_modulus": None if law in CONSTANTS else YOUNG,
        })  # fmt: skip
        body = scene.body.model_copy(update={"material": material, "element": chosen.element})
        terms[law] = Timed(scene.model_copy(update={"body": body}), law)
    for projected in (False, True):
        times = {law: [] for law in LAWS}
        for step in range(chosen.steps + 2):
            for law in LAWS:
                seconds = terms[law].seconds(projected)
                if step >= 2:
                    times[law].append(seconds)
        print(f"{chosen.scene.stem}, {chosen.element}, {'projected' if projected else 'exact'}")
        first = np.median(times[LAWS[0]])
        for law in LAWS:
            median = np.median(times[law])
            print(f"  {law:24} {1e3 * median:8.3f} ms   {median / first:5.2f} x")


if __name__ == "__main__":
    main()
