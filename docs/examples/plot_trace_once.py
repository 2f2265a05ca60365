"""
Trace once, reweight for any absorption
=======================================

The course of a ray does not depend on absorption. A room is traced a single time; absorption only
weights the recorded paths, smoothly and with an exact derivative.
"""

import matplotlib.pyplot as plt
import numpy as np

import roomfit
from roomfit.base.air import attenuation_per_m, speed_of_sound_m_s
from roomfit.materials.priors import uniform_scattering
from roomfit.model.weighing import energy_rows, weigh
from roomfit.tracing.paths import TraceSettings
from roomfit.tracing.trace import trace

room, _ = roomfit.read_room(
    roomfit.RoomSpec(shoebox=(6.0, 4.5, 2.8), materials={"floor": "carpet"})
)
scene = roomfit.scene_of(room, {"LS1": (1.2, 1.5, 1.1)}, {"MP1": (4.4, 2.9, 1.2)})

settings = TraceSettings(duration_s=0.3, n_rays=20_000, image_order=2)
traced = trace(scene, settings, uniform_scattering(room.materials, 0.1))
print(f"{len(traced.paths)} paths over the materials {', '.join(room.materials)}")

# %%
# One trace, three carpets. The energy of every 10 ms and its derivative come from the same paths.

edges_s = np.arange(0.0, 0.301, 0.01)
rows = energy_rows(traced.paths, 0, edges_s, speed_of_sound_m_s(scene.air))
bands = roomfit.bands_between("octave", 1000, 1000)
attenuation = attenuation_per_m(scene.air, bands)
carpet = room.materials.index("carpet")

figure, axes = plt.subplots(figsize=(6, 3.5), layout="constrained")
for alpha, colour in ((0.05, "#0072B2"), (0.3, "#D55E00"), (0.8, "#009E73")):
    absorption = np.full((len(room.materials), 1), 0.1)
    absorption[carpet] = alpha
    energy = weigh(rows, absorption, attenuation)[0]
    level_db = 10.0 * np.log10(np.maximum(energy, 1e-12) / energy.max())
    axes.step(1000 * edges_s[:-1], level_db, where="post", color=colour, label=f"carpet {alpha:g}")
axes.set(xlabel="time after emission (ms)", ylabel="energy of 10 ms (dB)", ylim=(-60, 3))
axes.legend(title="absorption", frameon=False)
plt.show()
