"""Forces and stiffness of bodies, their unknowns, and the mappings of points onto them."""
