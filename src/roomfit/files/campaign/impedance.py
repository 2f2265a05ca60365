"""What a campaign file says of the impedance of walls."""

from __future__ import annotations

from roomfit.checks import nearest
from roomfit.errors import InputError, located
from roomfit.files.campaign.campaign import Campaign
from roomfit.files.campaign.schema import MaterialTable
from roomfit.impedance.choose import WallModel
from roomfit.impedance.laws import LAWS, Parameter


def wall_models(campaign: Campaign, materials: tuple[str, ...]) -> dict[str, WallModel]:
    """Return how each material's R0 is to run over frequency; what is not told is a spline.

    Raises
    ------
    InputError
        A material that the room does not have, a start that is not passive, an unknown number of a
        law, or bounds out of order.
    """
    found = {name: WallModel() for name in materials}
    for name, table in campaign.materials.items():
        where = f"{campaign.path}, materials.{name}"
        if name not in found:
            guess = nearest(name, materials)
            raise InputError(
                "the campaign describes a material that the room does not have",
                where=where,
                needed=f"one of {', '.join(materials)}",
                hint=f"did you mean {guess!r}?" if guess else None,
            )
        with located(where):
            found[name] = _wall_model(table)
    return found


def _wall_model(table: MaterialTable) -> WallModel:
    kind = table.impedance or "spline"
    told = dict(table.impedance_start or {})
    if kind in LAWS:
        known = {p.name: p for p in LAWS[kind][1]}
        return WallModel(
            kind, parameters={name: _parameter(known, kind, name, v) for name, v in told.items()}
        )
    start: complex = 0.8
    for name, value in told.items():
        if name != "r0":
            raise InputError(
                "unknown key of impedance_start",
                found=repr(name),
                needed=f'r0 for impedance = "{kind}": a number, or [real, imaginary]',
            )
        start = _start_r0(value)
    return WallModel(kind, start)


def _start_r0(value: float | list[float]) -> complex:
    parts = [float(v) for v in value] if isinstance(value, list) else [float(value), 0.0]
    if len(parts) != 2:
        raise InputError(
            "r0 of impedance_start is not a complex number",
            found=repr(value),
            needed="a number, or [real, imaginary]",
        )
    return complex(*parts)


def _parameter(
    known: dict[str, Parameter], kind: str, name: str, value: float | list[float]
) -> Parameter:
    if name not in known:
        guess = nearest(name, known)
        raise InputError(
            "unknown key of impedance_start",
            found=repr(name),
            needed=f'one of {", ".join(known)} for impedance = "{kind}"',
            hint=f"did you mean {guess!r}?" if guess else None,
        )
    usual = known[name]
    numbers = [float(v) for v in value] if isinstance(value, list) else [float(value)]
    if len(numbers) == 1:
        numbers += [min(usual.low, numbers[0] / 10.0), max(usual.high, numbers[0] * 10.0)]
    if len(numbers) != 3 or not 0.0 < numbers[1] <= numbers[0] <= numbers[2]:
        raise InputError(
            f"start and bounds of {name} are out of order",
            found=repr(value),
            needed=f"a number above 0 ({usual.unit}), or [start, lowest, highest]",
        )
    if numbers[1] == numbers[2]:
        raise InputError(
            f"bounds of {name} leave nothing to find",
            found=repr(value),
            needed="a lowest below the highest",
        )
    return Parameter(name, usual.unit, *numbers)
