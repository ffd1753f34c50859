"""Digital twin and controller of soft robots: finite elements, Lagrange multipliers, inverse QP.

The method is that of Coevoet et al., "Software toolkit for modeling, simulation and control of
soft robots", Advanced Robotics 31 (2017). The rooms of this package mirror its equations.
"""
