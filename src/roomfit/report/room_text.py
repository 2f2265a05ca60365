"""A checked room in words."""

from __future__ import annotations

from roomfit.findings import Finding
from roomfit.scene.room_check import RoomCheck


def room_text(title: str, check: RoomCheck) -> str:
    """Return the room's size, its materials, and what is wrong with it, ready to print."""
    about = "" if check.closed else "  (approximate: the mesh is not closed)"
    x, y, z = check.size_m
    rows = [
        title,
        f"  size            {x:.2f} x {y:.2f} x {z:.2f} m",
        f"  volume V        {check.volume_m3:.2f} m3{about}",
        f"  surface S       {check.surface_m2:.2f} m2",
        f"  mean free path  {check.mean_free_path_m:.3f} m  (4 V / S)",
        f"  mesh            {check.n_triangles} triangles, {check.n_surfaces} surfaces, "
        f"{'closed' if check.closed else 'not closed'}, {_leak(check.leak)}",
        "",
        *_materials(check),
    ]
    faults = [f for f in check.findings if f.severity == "serious"]
    doubts = [f for f in check.findings if f.severity != "serious"]
    if doubts:
        rows += ["", "findings", *(f"  {f.severity:<8} {f.sentence}" for f in doubts)]
    if faults:
        rows += ["", "faults that forbid tracing", *(line for f in faults for line in _fault(f))]
    else:
        rows += ["", "The room can be traced."]
    return "\n".join(rows)


def _leak(leak: float | None) -> str:
    if leak is None:
        return "no point inside found"
    return f"{1e2 * leak:.3g} % of hits lost" if leak else "no ray lost"


def _materials(check: RoomCheck) -> list[str]:
    names = [name or "(no material)" for name, _ in check.material_areas_m2]
    width = max(map(len, (*names, "material")))
    rows = [f"  {'material':<{width}}  {'area in m2':>10}  {'share':>6}"]
    for name, (_, area) in zip(names, check.material_areas_m2, strict=True):
        share = area / check.surface_m2 if check.surface_m2 > 0.0 else 0.0
        rows.append(f"  {name:<{width}}  {area:10.2f}  {1e2 * share:5.1f} %")
    return rows


def _fault(finding: Finding) -> list[str]:
    rows = [f"  {finding.evidence.get('what', finding.sentence)}"]
    for key in ("where", "found", "needed", "try"):
        if key in finding.evidence:
            rows.append(f"    {key:<7} {finding.evidence[key]}")
    return rows
