"""Measured ISO 3382 values of a campaign as one problem a band, and predictions beside them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from roomfit.air import attenuation_per_m, speed_of_sound_m_s
from roomfit.app.binning import BinnedPaths, regrouped, rows_at
from roomfit.app.problems import absorption_block
from roomfit.bands import Bands
from roomfit.errors import InputError
from roomfit.materials.knowledge import MaterialKnowledge
from roomfit.objective.energy_problem import lone_rows
from roomfit.objective.parameters import Parameters
from roomfit.objective.room_values_problem import RoomValuesProblem, ValueObservation
from roomfit.objective.smearing import Smearing, band_smearing, smear
from roomfit.response.energy import weigh
from roomfit.response.rows import EnergyRows, rows_in_air
from roomfit.scene.scene import Scene, distances_m
from roomfit.signals.decay import echogram_decay_curve
from roomfit.signals.filters import FilterBank, statistical_bandwidth_hz
from roomfit.signals.jnd import in_jnd
from roomfit.signals.measured_values import MeasuredValues
from roomfit.signals.parameter_gradients import VALUE_NAMES, ValueName, value_gradients
from roomfit.typing import FloatArray
from roomfit.uncertainty.answer import Compared

MODEL_ERROR_JND = 0.3
# Room parameters do not feel when within half a millisecond a path arrives: it moves TS by a
# fortieth of a just noticeable difference at most, and all others by less.
_BINS_AS_ONE = 5


def value_problems(
    scene: Scene,
    bands: Bands,
    knowledge: tuple[MaterialKnowledge, ...],
    measured: Sequence[MeasuredValues],
    binned: BinnedPaths,
    start: FloatArray,
    *,
    parameters: Sequence[Parameters | None] | None = None,
    names: Sequence[ValueName] = VALUE_NAMES,
    model_error_jnd: float = MODEL_ERROR_JND,
) -> tuple[RoomValuesProblem | None, ...]:
    """Return the problem of every band, over all given values; None where a band has none.

    Parameters
    ----------
    measured : sequence of MeasuredValues
        Those to be fitted, each of a pair of the scene, with the centres of `bands` among its own.
    binned : BinnedPaths
        Traced so long that the slowest band falls by 35 dB, where T30 is to be fitted.
    start : float array, shape (n_bands,)
        Uniform absorption to start from.
    parameters : sequence of Parameters, optional
        Those of another problem of each band, to be joined with. Where it is None or left out, the
        absorptions alone.
    names : sequence of str
        Which parameters to fit.
    model_error_jnd : float
        See `RoomValuesProblem`.

    Raises
    ------
    InputError
        A pair that the scene does not have, or twice the same.
    """
    pairs = _pairs(scene, measured)
    coarse = coarser(binned, _BINS_AS_ONE)
    attenuation = attenuation_per_m(scene.air, bands)
    direct_s = distances_m(scene) / speed_of_sound_m_s(scene.air)
    problems: list[RoomValuesProblem | None] = []
    for band, centre_hz in enumerate(bands.centres_hz):
        seen = [
            _observation(pair, float(direct_s[pair]), m, float(centre_hz), names)
            for pair, m in zip(pairs, measured, strict=True)
        ]
        observations = tuple(o for o in seen if o.names)
        if not observations:
            problems.append(None)
            continue
        shared = None if parameters is None else parameters[band]
        own = Parameters((absorption_block(knowledge, band, float(start[band])),))
        one = Bands(bands.kind, bands.centres_hz[band : band + 1])
        bank = FilterBank(one)
        m = float(attenuation[band])
        heard = rows_at(coarse, centre_hz)
        rows = {o.pair: rows_in_air(heard[o.pair], m) for o in observations}
        problems.append(
            RoomValuesProblem(
                one,
                float(statistical_bandwidth_hz(bank)[0]),
                0.0,
                coarse.edges_s,
                tuple(rows[o.pair] for o in observations),
                tuple(lone_rows(rows[o.pair]) for o in observations),
                observations,
                bin_smearing(bank, coarse),
                own if shared is None else shared,
                model_error_jnd,
            )
        )
    return tuple(problems)


def coarser(binned: BinnedPaths, n: int) -> BinnedPaths:
    """Return the same paths in bins of n times the width; bins that are left over at the end go."""
    kept = (binned.edges_s.size - 1) // n

    def joined(fine: EnergyRows) -> EnergyRows:
        offsets = fine.offsets[: n * kept + 1 : n]
        last = int(offsets[-1])
        return EnergyRows(
            fine.materials,
            kept,
            offsets,
            fine.weight_per_m2[:last],
            fine.hits[:last],
            fine.length_m[:last],
            fine.batch[:last],
            fine.n_batches,
        )

    return regrouped(binned, binned.edges_s[: n * kept + 1 : n], joined)


def bin_smearing(bank: FilterBank, binned: BinnedPaths) -> Smearing:
    """Return how the first band of a bank smears the bins of binned paths."""
    width_s = float(binned.edges_s[1] - binned.edges_s[0])
    return band_smearing(bank, binned.edges_s.size - 1, width_s)


def predicted_values(
    scene: Scene,
    bands: Bands,
    binned: BinnedPaths,
    absorption: FloatArray,
    names: Sequence[ValueName] = VALUE_NAMES,
) -> FloatArray:
    """Return the room parameters that the paths predict, shape (n_pairs, n_names, n_bands).

    Parameters
    ----------
    absorption : float array, shape (n_materials, n_bands)
    """
    attenuation = attenuation_per_m(scene.air, bands)
    direct_s = distances_m(scene) / speed_of_sound_m_s(scene.air)
    coarse = coarser(binned, _BINS_AS_ONE)
    found = np.empty((len(binned.rows), len(names), len(bands)))
    for band in range(len(bands)):
        one = Bands(bands.kind, bands.centres_hz[band : band + 1])
        smearing = bin_smearing(FilterBank(one), coarse)
        chosen = slice(band, band + 1)
        for pair, rows in enumerate(rows_at(coarse, bands.centres_hz[band])):
            energy = _energy(rows, absorption[:, chosen], attenuation[chosen])
            curve = echogram_decay_curve(
                one, smear(smearing, energy), coarse.edges_s, float(direct_s[pair])
            )
            found[pair, :, band] = value_gradients(curve, 0, names)[0]
    return found


def compared_values(
    measured: Sequence[MeasuredValues],
    predicted: Sequence[FloatArray],
    fitted: Sequence[MeasuredValues],
    bands: Bands,
    names: Sequence[ValueName] = VALUE_NAMES,
) -> tuple[dict[ValueName, Compared], ...]:
    """Return measured, predicted and null value of every pair; parameters never measured left out.

    Parameters
    ----------
    measured : sequence of MeasuredValues
    predicted : sequence of float arrays, shape (n_names, n_bands)
        Of the same pairs.
    fitted : sequence of MeasuredValues
        Whose mean, the pair itself left out, is the null model.
    """
    tables = []
    for m, row in zip(measured, predicted, strict=True):
        table: dict[ValueName, Compared] = {}
        for name, values in zip(names, row, strict=True):
            found = values_at(m, name, bands)
            if not np.isfinite(found).any():
                continue
            others = np.array([values_at(o, name, bands) for o in fitted if o is not m])
            null = _mean_of_known(others.reshape(-1, len(bands)))
            table[name] = Compared(found, values, null, in_jnd(name, found, values))
        tables.append(table)
    return tuple(tables)


def values_at(measured: MeasuredValues, name: ValueName, bands: Bands) -> FloatArray:
    """Return a measured parameter at the centres of bands, NaN where unknown, (n_bands,)."""
    return _at(measured.centres_hz, measured.values.get(name), bands.centres_hz)


def _at(centres_hz: FloatArray, row: FloatArray | None, wanted_hz: FloatArray) -> FloatArray:
    out: FloatArray = np.full(wanted_hz.size, np.nan)
    if row is not None:
        match = np.abs(centres_hz[None, :] / wanted_hz[:, None] - 1.0) < 1e-6
        found = match.any(axis=1)
        out[found] = row[match.argmax(axis=1)[found]]
    return out


def _pairs(scene: Scene, measured: Sequence[MeasuredValues]) -> list[int]:
    index = {
        (scene.sources[s].name, scene.receivers[r].name): i for i, (s, r) in enumerate(scene.pairs)
    }
    found = []
    for m in measured:
        key = (m.source, m.receiver)
        if key not in index or index[key] in found:
            raise InputError(
                "measured values of a pair that the scene "
                + ("lacks" if key not in index else "has once, given twice"),
                found=f"{m.source} to {m.receiver}",
                needed=", ".join(f"{s} to {r}" for s, r in index),
                hint="define the source and the receiver; join what was measured twice",
            )
        found.append(index[key])
    return found


def _observation(
    pair: int, direct_s: float, m: MeasuredValues, centre_hz: float, names: Sequence[ValueName]
) -> ValueObservation:
    at = np.array([centre_hz])
    found = {n: float(_at(m.centres_hz, m.values.get(n), at)[0]) for n in names}
    known = tuple(n for n in names if np.isfinite(found[n]))
    spread = [float(_at(m.centres_hz, m.spread.get(n), at)[0]) for n in known]
    return ValueObservation(
        pair,
        direct_s,
        known,
        np.array([found[n] for n in known]),
        np.where(np.isfinite(spread), spread, 0.0),
    )


def _energy(rows: EnergyRows, absorption: FloatArray, attenuation: FloatArray) -> FloatArray:
    return weigh(rows, absorption, attenuation, derivative=False).energy


def _mean_of_known(values: FloatArray) -> FloatArray:
    known = np.isfinite(values)
    counts = known.sum(axis=0)
    sums = np.where(known, values, 0.0).sum(axis=0)
    return np.asarray(np.where(counts > 0, sums / np.maximum(counts, 1), np.nan))
