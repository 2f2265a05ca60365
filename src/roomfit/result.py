"""The result of an identification: numbers, their intervals, and every finding."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, ClassVar, Literal

import numpy as np

from roomfit.base.bands import Bands
from roomfit.base.findings import About, Code, Finding
from roomfit.base.shown import Shown
from roomfit.base.typing import VALUE_NAMES, BoolArray, FloatArray
from roomfit.materials.priors import MaterialPrior, object_area_m2, object_volumes_m3
from roomfit.settings import Settings
from roomfit.uncertainty.posterior import AbsorptionPosterior, covariance_from_intervals

if TYPE_CHECKING:
    from roomfit.base.table import Table

    # compiled, and nobody who reads a result waits for it
    from roomfit.fit.fits import FittedGeometry
    from roomfit.model.directivity import FittedDirectivity
    from roomfit.uncertainty.combinations import Combination
    from roomfit.uncertainty.profile import Profile

Use = Literal["fit", "validate"]


@dataclass(frozen=True, slots=True, eq=False)
class Compared:
    """One room-acoustic parameter of one pair in every band, measured and predicted."""

    measured: FloatArray  # (n_bands,), NaN where it cannot be determined
    predicted: FloatArray  # (n_bands,), NaN where it cannot be determined
    # (n_bands,), The mean of this parameter over the other measurements that were fitted: what
    # one would guess without any model of the room. NaN where there is no other
    null: FloatArray
    # (n_bands,), Predicted minus measured in just noticeable differences of ISO 3382-1
    jnd: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Decay:
    """Energy decay curves of one pair, for looking at."""

    time_s: FloatArray  # (n_times,), After emission
    # (n_bands, n_times), Relative to the whole; NaN beyond the usable part
    measured_db: FloatArray
    # (n_bands, n_times), Relative to the whole; NaN beyond the usable part
    predicted_db: FloatArray
    # (n_bands,), where the measured decay meets the noise; NaN where the file ends before
    noise_db: FloatArray | None = None


@dataclass(frozen=True, slots=True, eq=False)
class ComparedPair:
    """Measured against predicted for one source and receiver."""

    source: str
    receiver: str
    use: Use  # "validate": this pair was predicted without having been fitted
    parameters: Mapping[str, Compared]  # and "G_dB", those that are known
    decay: Decay | None  # None where room parameters were measured and no response
    state: str = ""  # of the room; "": as it is described


@dataclass(frozen=True, slots=True, eq=False)
class ObjectAreas:
    """What was found of the objects in a room: equivalent absorption areas in m2."""

    names: tuple[str, ...]
    area_m2: FloatArray  # (n_objects, n_bands), and its 95 % interval
    lower95_m2: FloatArray
    upper95_m2: FloatArray
    # (n_objects, n_bands), whether the data halve the prior's standard deviation of its logarithm
    identifiable: BoolArray
    # absorption of walls and objects with the covariance of both, as predictions take it
    posterior: AbsorptionPosterior


@dataclass(frozen=True, slots=True, eq=False)
class Result(Shown):
    """What an identification found.

    Examples
    --------
    ``print(result)`` shows what the command line prints; a notebook shows a table.
    """

    described_in: ClassVar[str] = "answer"
    bands: Bands
    materials: tuple[str, ...]
    areas_m2: FloatArray  # (n_materials,)
    # energy absorption coefficient and its 95 % interval, 0 to 1 where undetermined; each of shape
    # (n_materials, n_bands)
    absorption: FloatArray
    lower95: FloatArray
    upper95: FloatArray
    identifiable: BoolArray  # (n_materials, n_bands)
    # (3, n_bands), area-weighted mean absorption of the room, its lower and its upper 95 % bound
    mean_absorption: FloatArray
    chi2_reduced: FloatArray  # (n_bands,); above 2 the model does not fit
    cost: float  # sum over bands of half the squared weighted residuals, priors included
    evaluations: int  # of every fit, trial, profile and draw: how often data were predicted
    converged: BoolArray  # (n_bands,)
    pairs: tuple[ComparedPair, ...]
    findings: tuple[Finding, ...]
    method: str
    model: str
    interval_kind: str  # how the intervals were made, in words
    speed_of_sound_m_s: float
    seed: int
    seconds: float
    # (n_bands, n_materials, n_materials), covariance of logit absorption, misfit included; zeros
    # for what is fixed. None where only the intervals are known
    logit_covariance: FloatArray | None = None
    logit_prior: FloatArray | None = None  # (2, n_materials, n_bands), prior mean and sd
    # (n_bands, n_materials, n_materials), of the same prior; None: materials are independent
    logit_prior_covariance: FloatArray | None = None
    # by band, means over groups of materials that the data determine, the whole room first
    combinations: tuple[tuple[Combination, ...], ...] = ()
    models: tuple[str, ...] = ()  # by band, "energy", "coherent", "values", or "prior" alone
    # (n_bands,), where decays are predicted by pressures of image sources; None: nowhere
    by_pressures: BoolArray | None = None
    scattering: FloatArray | None = None  # (n_materials, n_bands): specified, assumed or fitted
    geometry: FittedGeometry | None = None  # None where arrival times were not fitted
    directivities: tuple[FittedDirectivity, ...] = ()  # of the sources for which it was fitted
    sentences: tuple[str, ...] = ()  # by band, which groups of materials the data determine
    # (3, n_materials, n_bands), share of each material in the room's absorption with its bounds
    shares: FloatArray | None = None
    # by band and material, "gaussian", "profile", "given", or "none" where undetermined
    interval_kinds: tuple[tuple[str, ...], ...] = ()
    profiles: tuple[tuple[Profile, ...], ...] = ()  # by band; `entry` counts materials
    prior: FloatArray | None = None  # (3, n_materials, n_bands), prior median and 95 % bounds
    reasons: tuple[str, ...] = ()  # what was chosen, and why
    plan: tuple[str, ...] = ()  # where each source and receiver was taken to stand, in words
    prior_specified: BoolArray | None = None  # (n_materials,); False: the broad default
    # (n_draws, n_materials, n_bands), of the posterior, as predictions take them; None: not drawn
    draws: FloatArray | None = None
    settings: Settings = field(default_factory=Settings)
    # what the trace used: duration_s, n_rays (a source), receiver_radius_m, and scattering_groups
    # of bands; empty where unknown
    trace: Mapping[str, float] = field(default_factory=dict)
    # as `mean_absorption`, of each further state of the room by its name
    state_means: Mapping[str, FloatArray] = field(default_factory=dict)
    # by band, (n_materials,), standard deviation of each logit absorption by which term of the
    # uncertainty were left out, "" for none (`roomfit.uncertainty.gaussian.sd_without_term`)
    costs: tuple[Mapping[str, FloatArray], ...] = ()
    mean_costs: tuple[Mapping[str, float], ...] = ()  # likewise, of the mean, not in the logit
    # (n_materials, n_bands), what is identifiable by the rule alone, before findings; None: unknown
    identifiable_by_rule: BoolArray | None = None
    # (n_bands,), uniform absorption that Eyring's formula gives of the measured decay; NaN or None
    # where no decay was measured
    eyring_absorption: FloatArray | None = None
    objects: ObjectAreas | None = None  # of what stands in the room; None where nothing does

    def __repr__(self) -> str:
        """Return at most ten lines: size, how much is identifiable, the mean of the room."""
        middle = int(np.argmin(np.abs(np.log2(self.bands.centres_hz / 1000.0))))
        mean, low, high = self.mean_absorption[:, middle]
        names = [*self.materials[:3], "..."] if len(self.materials) > 4 else self.materials
        codes = list(dict.fromkeys(f.code.value for f in self.findings if f.severity == "serious"))
        at = f"{self.bands.centres_hz[middle]:g} Hz"
        return "\n".join(
            (
                f"Result of {len(self.materials)} materials ({', '.join(names)})",
                f"  bands         {', '.join(f'{f:g}' for f in self.bands.centres_hz[:10])} Hz",
                f"  identifiable  {int(self.identifiable.sum())} of {self.identifiable.size}",
                f"  mean          {mean:.3f} ({low:.3f} to {high:.3f}) at {at}",
                f"  chi-square    {np.nanmax(self.chi2_reduced):.2f} at most, reduced",
                f"  pairs         {len(self.pairs)}",
                f"  findings      {len(self.findings)}; serious: {', '.join(codes[:4]) or 'none'}",
                "  print(result) shows all of it",
            )
        )

    def records(self) -> Table:
        """Return the content of absorption.csv: one row a material and band."""
        values = np.stack([self.absorption, self.lower95, self.upper95])
        return absorption_records(self.materials, self.bands, values, self.identifiable)

    def to_dataframe(self) -> Any:
        """Return a pandas data frame of one row a material and band, as absorption.csv."""
        from roomfit.base.table import data_frame

        return data_frame(self.records(), "absorption.csv")

    def to_xarray(self) -> Any:
        """Return absorption with its intervals, and its prior, as an xarray data set.

        ``absorption``, ``lower95``, ``upper95``, ``identifiable``, the ``interval`` (how it was
        made) and ``prior``, ``prior_lower95``, ``prior_upper95`` have the dimensions ``material``
        and ``band_hz``; ``area_m2`` has ``material``; ``mean_absorption`` with its bounds and
        ``chi2_reduced`` have ``band_hz``. What the result does not know is left out.
        """
        from roomfit.base.table import optional_package

        both, names = ("material", "band_hz"), ("absorption", "lower95", "upper95", "identifiable")
        own: dict[str, Any] = {name: (both, getattr(self, name)) for name in names}
        if all(self.interval_kinds) and self.interval_kinds:
            own["interval"] = both, np.array(self.interval_kinds).T
        for start, stack in (("prior", self.prior), ("mean_absorption", self.mean_absorption)):
            for name, values in zip(
                ("", "_lower95", "_upper95"), () if stack is None else stack, strict=False
            ):
                own[f"{start}{name}"] = both[-values.ndim :], values
        return optional_package("xarray", "data sets", "to_xarray").Dataset(
            own
            | {
                "area_m2": ("material", self.areas_m2),
                "chi2_reduced": ("band_hz", self.chi2_reduced),
            },
            coords={"material": list(self.materials), "band_hz": self.bands.centres_hz},
            attrs={"intervals": self.interval_kind, "method": self.method, "model": self.model},
        )


def absorption_records(
    materials: Sequence[str], bands: Bands, values: FloatArray, identifiable: BoolArray
) -> Table:
    """Return the content of absorption.csv: one row a material and band.

    Shapes: `values` (3, n_materials, n_bands), `identifiable` (n_materials, n_bands).
    """
    from roomfit.base.table import Column, Table

    rows = [
        (name, centre, *values[:, i, j].tolist(), bool(identifiable[i, j]))
        for i, name in enumerate(materials)
        for j, centre in enumerate(bands.centres_hz.tolist())
    ]
    numbers = ("absorption", "lower95", "upper95")
    columns = ("material", Column("band_hz"), *numbers, "identifiable")
    return Table("", columns, rows, form=".5f")


def absorption_posterior(answer: Result) -> AbsorptionPosterior:
    """Return the absorption of an answer with its posterior, as predictions and designs take it.

    Where the answer has no covariance, the intervals are taken as independent.

    Examples
    --------
    >>> import roomfit
    >>> room = roomfit.shoebox_room((6.0, 5.0, 3.0), "plaster")
    >>> scene = roomfit.scene_of(room, {"S": (1.5, 1.2, 1.5)}, {"R": (4.0, 3.5, 1.2)})
    >>> measured = roomfit.MeasuredValues("S", "R", [1000.0], {"T20_s": [0.8]})
    >>> octave, few = roomfit.bands_between("octave", 1000, 1000), roomfit.Settings(n_rays=2000)
    >>> result = roomfit.identify(scene, [measured], bands=octave, settings=few)
    >>> found = absorption_posterior(result)
    >>> found.materials, found.logit_covariance.shape
    (('plaster',), (1, 1, 1))
    """
    if answer.objects is not None:
        return replace(answer.objects.posterior, result_findings=answer.findings)
    covariance = answer.logit_covariance
    if covariance is None:
        covariance = covariance_from_intervals(answer.absorption, answer.lower95, answer.upper95)
    mean, sd = (None, None) if answer.logit_prior is None else answer.logit_prior
    return AbsorptionPosterior(
        answer.materials,
        answer.bands,
        answer.absorption,
        answer.lower95,
        answer.upper95,
        covariance,
        prior_logit_mean=mean,
        prior_logit_sd=sd,
        prior_logit_covariance=answer.logit_prior_covariance,
        scattering=answer.scattering,
        by_pressures=answer.by_pressures,
        directivities={n: p for d in answer.directivities for n, p in d.patterns().items()},
        prior_specified=answer.prior_specified,
        chi2_reduced=answer.chi2_reduced,
        draws=answer.draws,
        fitted_jnd=departures_jnd(
            [{n: c.jnd for n, c in p.parameters.items()} for p in answer.pairs if p.use == "fit"],
            answer.bands,
        ),
        areas_m2=answer.areas_m2,
        fitted_states=tuple(sorted({p.state for p in answer.pairs if p.use == "fit"})),
        result_findings=answer.findings,
    )


def with_objects_apart(whole: Result, priors: Sequence[MaterialPrior]) -> Result:
    """Return a result whose materials are those of surfaces, objects with their areas in m2."""
    volumes = object_volumes_m3(priors)
    if not volumes:
        return whole
    n = len(priors) - len(volumes)
    posterior = replace(absorption_posterior(whole), objects=volumes)
    room_m3 = next(iter(volumes.values()))
    area_m2, lower95_m2, upper95_m2 = (
        object_area_m2(x[n:], room_m3) for x in (whole.absorption, whole.lower95, whole.upper95)
    )
    names = whole.materials
    return replace(
        whole,
        **{f: _of_walls(getattr(whole, f), axes, n) for f, axes in _MATERIAL_AXES.items()},
        profiles=tuple(tuple(p for p in b if p.entry < n) for b in whole.profiles),
        costs=tuple({k: v[:n] for k, v in band.items()} for band in whole.costs),
        interval_kinds=tuple(kinds[:n] for kinds in whole.interval_kinds),
        objects=ObjectAreas(
            names[n:], area_m2, lower95_m2, upper95_m2, whole.identifiable[n:], posterior
        ),
    )


# Of the arrays of a result, along which axes they run over materials.
_MATERIAL_AXES: Mapping[str, tuple[int, ...]] = {
    **dict.fromkeys(("materials", "areas_m2", "absorption", "lower95", "upper95"), (0,)),
    **dict.fromkeys(("identifiable", "identifiable_by_rule", "scattering"), (0,)),
    **dict.fromkeys(("logit_covariance", "logit_prior_covariance"), (1, 2)),
    **dict.fromkeys(("logit_prior", "prior", "draws"), (1,)),
    "prior_specified": (0,),
}


def _of_walls(values: Any, axes: tuple[int, ...], n: int) -> Any:
    """Return the first n entries along some axes of an array or tuple, None of None."""
    if values is None or isinstance(values, tuple):
        return values if values is None else values[:n]
    at = tuple(slice(n) if axis in axes else slice(None) for axis in range(max(axes) + 1))
    return values[at]


def departures_jnd(tables: Sequence[Mapping[str, Any]], bands: Bands) -> FloatArray:
    """Return departures of pairs by parameter as one array, (n_pairs, n_names, n_bands).

    Names in the order of `VALUE_NAMES`; NaN where unknown.
    """
    unknown = np.full(len(bands), np.nan)
    rows = [[table.get(name, unknown) for name in VALUE_NAMES] for table in tables]
    shape = len(tables), len(VALUE_NAMES), len(bands)
    return np.array(rows, dtype=np.float64).reshape(shape)


def result_doubts(
    absorption: AbsorptionPosterior, others: Iterable[Finding] = (), what: str = "prediction"
) -> tuple[Finding, ...]:
    """Return what doubts the result that an absorption comes from, to stand in what rests on it.

    First one sentence, where findings of the result void identifiability or its reduced chi-square
    is above 2 in one of these bands; then its findings that are serious or void identifiability,
    without those that concern
    other materials or bands alone, or stand among `others` already. `what` rests on the result: a
    prediction, a design.
    """
    known = {(f.code, f.about) for f in others}
    serious = [
        f
        for f in absorption.result_findings
        if (f.severity == "serious" or f.code.voids_identifiability)
        and (not f.about.materials or set(f.about.materials) & set(absorption.materials))
        and any(f.about.in_band(float(centre)) for centre in absorption.bands.centres_hz)
    ]
    from roomfit.uncertainty.gaussian import LARGEST_CHI2_REDUCED

    voids = list(dict.fromkeys(f.code for f in serious if f.code.voids_identifiability))
    chi2 = absorption.chi2_reduced
    misfit = np.zeros(0) if chi2 is None else chi2[chi2 > LARGEST_CHI2_REDUCED]
    repeated = tuple(f for f in serious if (f.code, f.about) not in known)
    if not voids and not misfit.size:
        return repeated
    reasons = [f"no wall of it counts as identifiable ({', '.join(voids)})"] if voids else []
    at_hz: list[float] = []
    if chi2 is not None and misfit.size:
        at_hz = absorption.bands.centres_hz[chi2 > LARGEST_CHI2_REDUCED].tolist()
        reasons.append(
            f"its reduced chi-square is up to {misfit.max():.1f} at "
            f"{', '.join(f'{f:g}' for f in at_hz)} Hz"
        )
    text = f"The {what} rests on a doubted result: {', and '.join(reasons)}."
    about = About(bands_hz=() if voids else at_hz)
    evidence = {"codes": [c.value for c in voids], "chi2_reduced": np.round(misfit, 2).tolist()}
    return (Finding(Code.RESULT_DOUBTED, about, text, evidence), *repeated)
