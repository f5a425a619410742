"""The membrane H(d): the harmonic extension of values d on the diffusion curves γ into a face's box (eq. 1).

In the order of use:

    cuts = cut_edges(points, layout, Lattice.over(box))
    membrane = build_membrane(cuts).solve(values)
    membrane.read(xs, ys)
"""

from pvg.membrane.edge_cuts import cut_edges
from pvg.membrane.lattice import TARGET_HEIGHT, Lattice
from pvg.membrane.membrane import Membrane
from pvg.membrane.operator import TOLERANCE, MembraneOperator, build_membrane

__all__ = [
    "TARGET_HEIGHT",
    "TOLERANCE",
    "Lattice",
    "Membrane",
    "MembraneOperator",
    "build_membrane",
    "cut_edges",
]
