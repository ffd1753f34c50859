"""Enhanced hexahedra: patch tests, rigid motion, tangents, bending without locking."""

import numpy as np
import pytest

from softrobot_twin.geometry.hexahedral_mesh import HexahedralMesh, block_mesh, enhance
from softrobot_twin.geometry.shape_functions import (
    ENHANCED_HEXAHEDRON,
    HEXAHEDRON_CORNERS,
    TRILINEAR_HEXAHEDRON,
)
from softrobot_twin.mechanics.elements import Elements
from softrobot_twin.mechanics.laws.corotational import Corotational
from softrobot_twin.mechanics.laws.small_displacement import SmallDisplacement
from softrobot_twin.mechanics.rotation import rotation_matrix
