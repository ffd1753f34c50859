"""Arrays in, arrays out: A⁻¹, the Schur complement W, and the small problems posed on it."""
