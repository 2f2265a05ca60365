"""
The error function of the paper, and an ill-defined one
=======================================================

Suh (2001) looks for two absorptions that bring the energies of ray tracing nearest to those of a
"measurement". Two ways to cut the same response into windows make two very different functions.

The room is reconstructed from the arrival times and Table 2 of the paper, whose drawing is lost.
"""

import matplotlib.pyplot as plt
import numpy as np

from roomfit.paper.proof import certify
from roomfit.paper.room import error, paper_problem, paper_scene, trace_paper_room, true_absorption

paths = trace_paper_room(paper_scene())
windows = {
    "case1": "5 ms from the first reflection on",
    "ill_defined": "50 ms from the direct sound on",
}
problems = {name: paper_problem(name, paths) for name in windows}

# %%
# The room was traced once. Each function is now evaluated at the 441 points of the paper's grid.
# The levels are a factor of three apart; a cross marks the true absorption.

grid = np.linspace(0.0, 1.0, 21)
figure, panels = plt.subplots(1, 2, figsize=(8, 4), sharey=True, layout="constrained")
for axes, (name, problem) in zip(panels, problems.items(), strict=True):
    errors = np.array([[error(problem, np.array([a, b])) for a in grid] for b in grid])
    levels = errors.max() / 3.0 ** np.arange(12, -1, -1)
    axes.contour(grid, grid, errors, levels, cmap="viridis_r", norm="log")
    axes.plot(*true_absorption(name), "+", color="#D55E00", ms=12, mew=2)
    axes.set(title=windows[name], xlabel="absorption of floor and ceilings", aspect="equal")
panels[0].set_ylabel("absorption of walls")
figure.suptitle("Room reconstructed from the arrival times and Table 2 of the paper", fontsize=10)
plt.show()

# %%
# With 5 ms the function is a bowl. With 50 ms, and the direct sound as the largest energy of all,
# it is a narrow valley in which many pairs explain the windows nearly as well as the true one. A
# coarse grid shows islands in that valley. That neither function has a second minimum is proven: no
# other absorption at all has an error within 1e-8 of the lowest.

for name, problem in problems.items():
    proof = certify(problem)
    for cluster in proof.clusters:
        print(f"{name:<12} {cluster.minimiser.round(4)}, one minimum: {cluster.unique}")
