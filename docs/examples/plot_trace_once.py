"""
Trace once, reweight for any absorption
=======================================

The course of a ray does not depend on absorption. A room is traced a single time; absorption only
weights the recorded paths, smoothly and with an exact derivative.
"""

import matplotlib.pyplot as plt
import numpy as np

import roomfit

room, _ = roomfit.read_room(
    roomfit.RoomSpec(shoebox=(6.0, 4.5, 2.8), materials={"floor": "carpet"})
)
source = roomfit.Point("LS1", np.array([1.2, 1.5, 1.1]))
receiver = roomfit.Point("MP1", np.array([4.4, 2.9, 1.2]))
air = roomfit.Air()
scene = roomfit.Scene(room, (source,), (receiver,), np.array([[0, 0]]), air)

settings = roomfit.TraceSettings(duration_s=0.3, n_rays=20_000, image_order=2)
traced = roomfit.trace(scene, settings, roomfit.uniform_scattering(room.materials, 0.1))
print(f"{len(traced.paths)} paths over the materials {', '.join(room.materials)}")

# %%
# One trace, three carpets. The energy of every 10 ms and its derivative come from the same paths.

edges_s = np.arange(0.0, 0.301, 0.01)
rows = roomfit.energy_rows(traced.paths, 0, edges_s, roomfit.speed_of_sound_m_s(air))
bands = roomfit.bands_between("octave", 1000, 1000)
attenuation = roomfit.attenuation_per_m(air, bands)
carpet = room.materials.index("carpet")

figure, axes = plt.subplots(figsize=(6, 3.5), layout="constrained")
for alpha, colour in ((0.05, "#0072B2"), (0.3, "#D55E00"), (0.8, "#009E73")):
    absorption = np.full((len(room.materials), 1), 0.1)
    absorption[carpet] = alpha
    energy = roomfit.weigh(rows, absorption, attenuation).energy[0]
    level_db = 10.0 * np.log10(np.maximum(energy, 1e-12) / energy.max())
    axes.step(1000 * edges_s[:-1], level_db, where="post", color=colour, label=f"carpet {alpha:g}")
axes.set(xlabel="time after emission (ms)", ylabel="energy of 10 ms (dB)", ylim=(-60, 3))
axes.legend(title="absorption", frameon=False)
plt.show()
