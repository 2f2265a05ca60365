"""Table 2 of Suh (2001): the search in case 1, as printed."""

from __future__ import annotations

import numpy as np

from roomfit.checks import read_only

# alpha of floor and ceilings, alpha of walls, error in the paper's unknown unit
TABLE2 = read_only(
    np.array(
        [
            (0.010, 0.900, 448.681),
            (0.025, 0.880, 423.263),
            (0.020, 0.900, 430.133),
            (0.010, 0.900, 448.681),
            (0.020, 0.900, 430.133),
            (0.018, 0.930, 432.507),
            (0.003, 0.950, 458.833),
            (0.031, 0.925, 409.098),
            (0.049, 0.867, 382.489),
            (0.111, 0.849, 293.459),
            (0.384, 0.688, 63.880),
            (0.977, 0.221, 69.751),
            (0.402, 0.630, 53.198),
            (0.977, 0.221, 69.751),
            (0.241, 0.790, 157.592),
            (0.653, 0.340, 0.022),
            (0.662, 0.352, 0.129),
            (0.653, 0.340, 0.022),
            (0.653, 0.363, 0.053),
            (0.650, 0.350, 0.000),
        ]
    )
)
# Smaller errors are printed with too few digits, and depend on digits of alpha that are not.
COMPARED_ABOVE = 10.0
