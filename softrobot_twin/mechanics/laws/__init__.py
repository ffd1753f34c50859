"""Laws of materials, one file each. Importing this package registers them."""

from softrobot_twin.mechanics.laws import corotational, neo_hookean, small_displacement
from softrobot_twin.mechanics.point_law import law_named, law_names

__all__ = ["corotational", "law_named", "law_names", "neo_hookean", "small_displacement"]
