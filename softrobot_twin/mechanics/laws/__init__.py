"""Laws of materials, one file each. Importing this package registers them."""

from softrobot_twin.mechanics.laws import (
    corotational,
    mooney_rivlin,
    neo_hookean,
    ogden,
    orthotropic,
    saint_venant_kirchhoff,
    small_displacement,
    yeoh,
)
from softrobot_twin.mechanics.point_law import law_named, law_names

__all__ = [
    "corotational", "law_named", "law_names", "mooney_rivlin", "neo_hookean", "ogden",
    "orthotropic", "saint_venant_kirchhoff", "small_displacement", "yeoh",
]  # fmt: skip
