"""
Check the mesh of a room
========================

Most trouble with measured rooms is trouble with their drawings. A room is examined before anything
is traced in it: is it closed, do the normals agree, does every surface have a material?
"""

from pathlib import Path
from tempfile import TemporaryDirectory

import matplotlib.pyplot as plt

import roomfit
from roomfit.files.inputs import check_room
from roomfit.report.check import room_blocks
from roomfit.report.text import text

plan = ((0, 0), (5, 0), (5, 3), (3, 3), (3, 4), (0, 4))
height_m = 2.6

figure, axes = plt.subplots(figsize=(4, 3), layout="constrained")
axes.fill(*zip(*plan, strict=True), facecolor="#dbe9f4", edgecolor="#222222", lw=2)
axes.set(xlabel="x (m)", ylabel="y (m)", aspect="equal", title=f"height {height_m:g} m")
plt.show()

# %%
# As a file: the corners in pairs of bottom and top, then floor, ceiling and one face for each wall.


def obj_of(plan, height_m, *, door_is_open):
    """Return the room as the text of an OBJ file; its first wall may be left out."""
    n = len(plan)
    lines = [f"v {x} {y} {z}" for x, y in plan for z in (0.0, height_m)]
    lines += ["usemtl parquet", "f " + " ".join(str(2 * i + 1) for i in reversed(range(n)))]
    lines += ["usemtl plaster", "f " + " ".join(str(2 * i + 2) for i in range(n))]
    lines += ["usemtl brick"]
    for i in range(1 if door_is_open else 0, n):
        j = (i + 1) % n
        lines.append(f"f {2 * i + 1} {2 * j + 1} {2 * j + 2} {2 * i + 2}")
    return "\n".join(lines)


# %%
# The floor is concave, 5 x 3 m and 3 x 1 m: 18 m², a volume of 46.8 m³. An OBJ file carries no
# unit, so it must be specified.

with TemporaryDirectory() as folder:
    file = Path(folder) / "room.obj"
    file.write_text(obj_of(plan, height_m, door_is_open=False))
    sound = check_room(roomfit.RoomSpec(file=file, unit="m"))
print(text(room_blocks("an L-shaped room", sound)))

# %%
# Without one of its walls the room leaks. The check counts how much sound is lost there, and says
# where; `roomfit check` would leave with exit code 2.

with TemporaryDirectory() as folder:
    file = Path(folder) / "room.obj"
    file.write_text(obj_of(plan, height_m, door_is_open=True))
    leaking = check_room(roomfit.RoomSpec(file=file, unit="m"))
print(text(room_blocks("the same without its south wall", leaking)))
