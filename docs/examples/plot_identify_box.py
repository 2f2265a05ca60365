"""
Identify a simulated box
========================

A box with six walls of different materials is "measured" independently of the model that is fitted:
pressures of image sources that interfere, a loudspeaker with levels of its own, noise, and
positions a centimetre from the specified ones. Then it is identified without using its absorption.
"""

from dataclasses import replace

import matplotlib.pyplot as plt
import numpy as np

import roomfit
from roomfit.demo.boxes import SAMPLING_RATE_HZ, WALLS, demo_plan, simulated_responses

plan = demo_plan()
plan = replace(plan, sources_m={"LS1": plan.sources_m["LS1"]})
responses = simulated_responses(plan, np.random.default_rng(1))

# %%
# To be quick, one source, four receivers and a single octave.

room = roomfit.shoebox_room(plan.lengths_m, dict(zip(WALLS, plan.materials, strict=True)))
scene = roomfit.scene_of(room, plan.sources_m, plan.receivers_m)
measurements = [
    roomfit.Measurement(source, receiver, samples, SAMPLING_RATE_HZ)
    for (source, receiver), samples in responses.items()
]
result = roomfit.identify(scene, measurements, bands=roomfit.bands_between("octave", 1000, 1000))
print(result)

# %%
# The last table sets the errors of the prediction beside those of the baseline, which needs no
# model. In a dry room the decay at a single position depends on how a few reflections interfere,
# which a sum of energies does not predict; then the model need not be better than the baseline.
#
# Open points are not identifiable: their intervals are wide, and the position of the point within
# them has little meaning. The mean of the room, weighted by area, is determined much better than
# any wall.

octave = 4  # 1 kHz: the absorption of the plan begins at 63 Hz
true = plan.absorption[[plan.materials.index(name) for name in result.materials], octave]
value, low, high = (a[:, 0] for a in (result.absorption, result.lower95, result.upper95))
identifiable = result.identifiable[:, 0]
x = np.arange(len(true))

figure, axes = plt.subplots(figsize=(6.5, 3.5), layout="constrained")
axes.errorbar(x, value, (value - low, high - value), fmt="none", ecolor="#0072B2", capsize=3)
axes.plot(x[identifiable], value[identifiable], "o", color="#0072B2", label="identified")
axes.plot(
    x[~identifiable], value[~identifiable], "o",
    color="#0072B2", mfc="white", label="not identifiable",
)  # fmt: skip
axes.plot(x, true, "x", color="#D55E00", ms=8, mew=2, label="true")
axes.set(ylabel="absorption at 1 kHz", ylim=(0, 1))
axes.set_xticks(x, result.materials)
axes.legend(frameon=False)
plt.show()
