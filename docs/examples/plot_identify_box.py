"""
Identify a simulated box
========================

A box with six walls of different make is "measured" by another road than the model that is fitted:
pressures of image sources that interfere, a loudspeaker with levels of its own, noise, and
positions a centimetre from where the campaign says. Then it is identified as if nobody knew the
walls.
"""

from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import matplotlib.pyplot as plt
import numpy as np

import roomfit
from roomfit.io.inputs import identify_arguments
from roomfit.synthetic.boxes import demo_plan, write_measured_box

plan = demo_plan()
plan = replace(plan, sources_m={"LS1": plan.sources_m["LS1"]})

# %%
# To be quick, one source, four receivers and a single octave; the campaign file on the disk asks
# for six octaves.

with TemporaryDirectory() as folder:
    box = write_measured_box(plan, Path(folder), np.random.default_rng(1))
    campaign = roomfit.read_campaign(box.campaign)
    campaign = replace(campaign, bands=roomfit.bands_between("octave", 1000, 1000))
    answer = roomfit.identify(**identify_arguments(campaign))
print(roomfit.answer_text(answer))

# %%
# The last table sets the errors of the prediction beside those of a guess without any model. In a
# dry room the decay at a single place hangs on how a few reflections interfere, which a sum of
# energies does not predict; then the model need not be better than the guess.
#
# Hollow points are not identifiable: their intervals are wide, and their place within them says
# little. The room's mean, weighted by area, is known much better than any wall.

band = int(np.argmin(np.abs(box.centres_hz - 1000.0)))
truth = box.absorption[[box.materials.index(name) for name in answer.materials], band]
value, low, high = (a[:, 0] for a in (answer.absorption, answer.lower95, answer.upper95))
sure = answer.identifiable[:, 0]
places = np.arange(len(truth))

figure, axes = plt.subplots(figsize=(6.5, 3.5), layout="constrained")
axes.errorbar(places, value, (value - low, high - value), fmt="none", ecolor="#0072B2", capsize=3)
axes.plot(places[sure], value[sure], "o", color="#0072B2", label="identified")
axes.plot(places[~sure], value[~sure], "o", color="#0072B2", mfc="white", label="not identifiable")
axes.plot(places, truth, "x", color="#D55E00", ms=8, mew=2, label="true")
axes.set(ylabel="absorption at 1 kHz", ylim=(0, 1))
axes.set_xticks(places, answer.materials)
axes.legend(frameon=False)
plt.show()
