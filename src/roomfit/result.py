"""The result of an identification: numbers, their intervals, and every finding."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, ClassVar, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from roomfit.base.air import speed_of_sound_m_s
from roomfit.base.bands import Bands
from roomfit.base.findings import About, Code, Finding
from roomfit.base.logit import Z95, expit
from roomfit.base.table import Shown
from roomfit.base.typing import VALUE_NAMES, BoolArray, FloatArray
from roomfit.materials.priors import (
    MaterialPrior,
    are_specified,
    object_area_m2,
    object_volumes_m3,
    plain_logit_law,
    prior_logits,
)
from roomfit.settings import Settings
from roomfit.uncertainty import posterior

if TYPE_CHECKING:
    from roomfit.base.table import Table

    # compiled, and nobody who reads a result waits for it
    from roomfit.fit.fits import FittedGeometry
    from roomfit.model.directivity import FittedDirectivity
    from roomfit.room.scene import Scene
    from roomfit.uncertainty.combinations import Combination, Determined
    from roomfit.uncertainty.gaussian import BandEstimate

Use = Literal["fit", "validate"]


class Compared(NamedTuple):
    """One room-acoustic parameter of one pair in every band, measured and predicted."""

    measured: FloatArray  # (n_bands,), NaN where it cannot be determined
    predicted: FloatArray  # (n_bands,), NaN where it cannot be determined
    # (n_bands,), The mean of this parameter over the other measurements that were fitted: what
    # one would guess without any model of the room. NaN where there is no other
    null: FloatArray
    # (n_bands,), Predicted minus measured in just noticeable differences of ISO 3382-1
    jnd: FloatArray
    # (n_bands,), by Barron's revised theory with the mean decay time of these others, see
    # `roomfit.model.eyring.diffuse_values`
    diffuse: FloatArray | None = None


class Decay(NamedTuple):
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
    distance_m: float = np.nan  # from source to receiver


class ObjectAreas(NamedTuple):
    """What was found of the objects in a room: equivalent absorption areas in m2."""

    volumes_m3: Mapping[str, float]  # of the room, by each object's name
    area_m2: FloatArray  # (n_objects, n_bands), and its 95 % interval
    lower95_m2: FloatArray
    upper95_m2: FloatArray
    # (n_objects, n_bands), whether the data halve the prior's standard deviation of its logarithm
    identifiable: BoolArray

    @property
    def names(self) -> tuple[str, ...]:
        """Those of the objects."""
        return tuple(self.volumes_m3)


def object_areas(
    priors: Sequence[MaterialPrior], estimates: Sequence[BandEstimate], identifiable: BoolArray
) -> ObjectAreas | None:
    """Return what was found of the objects, which are the last materials; None without any."""
    volumes = object_volumes_m3(priors)
    if not volumes:
        return None
    n, volume_m3 = len(priors) - len(volumes), next(iter(volumes.values()))
    value, lower, upper = (
        object_area_m2(np.stack([getattr(b, name)[n:] for b in estimates], axis=1), volume_m3)
        for name in ("absorption", "lower95", "upper95")
    )
    return ObjectAreas(volumes, value, lower, upper, identifiable[n:])


class _OfBands:
    """What every band's estimate has by this name, shape (n_bands,)."""

    def __init__(self, name: str) -> None:
        self.name = name

    def __get__(self, result: Result, _owner: type[Result]) -> NDArray[Any]:
        return np.array([getattr(b, self.name) for b in result.estimates])


class _OfWalls(_OfBands):
    """What every band's estimate has of surfaces by this name, shape (n_materials, n_bands)."""

    def __get__(self, result: Result, owner: type[Result]) -> FloatArray:
        return super().__get__(result, owner).T[: len(result.materials)]


@dataclass(frozen=True, slots=True, eq=False)
class Result(Shown):
    """What an identification found: the estimate of every band, and what the bands share.

    Examples
    --------
    ``print(result)`` shows what the command line prints; a notebook shows a table.
    """

    described_in: ClassVar[str] = "answer"
    drawn: ClassVar[str] = "absorption"
    scene: Scene  # what was measured, as it was fitted
    bands: Bands
    priors: tuple[MaterialPrior, ...]  # one a material of the room, those of objects last
    estimates: tuple[BandEstimate, ...]  # one a band, of walls and objects
    determined: tuple[Determined, ...]  # by band, what data determine of groups of walls
    identifiable: BoolArray  # (n_materials, n_bands)
    identifiable_by_rule: BoolArray  # likewise, by the rule alone, before findings
    pairs: tuple[ComparedPair, ...]
    findings: tuple[Finding, ...]
    settings: Settings = field(default_factory=Settings)
    evaluations: int = 0  # of every fit, trial, profile and draw: how often data were predicted
    seconds: float = 0.0
    objects: ObjectAreas | None = None  # of what stands in the room; None where nothing does
    # (n_bands,), where decays are predicted by pressures of image sources; None: nowhere
    by_pressures: BoolArray | None = None
    # (n_materials, n_bands), specified, assumed or fitted, that of objects last
    scattering: FloatArray | None = None
    geometry: FittedGeometry | None = None  # None where arrival times were not fitted
    directivities: tuple[FittedDirectivity, ...] = ()  # of the sources for which it was fitted
    # what the trace used: duration_s, n_rays (a source), receiver_radius_m, and scattering_groups
    # of bands; empty where unknown
    trace: Mapping[str, float] = field(default_factory=dict)
    # as `mean_absorption`, of each further state of the room by its name
    state_means: Mapping[str, FloatArray] = field(default_factory=dict)
    # (n_bands,), uniform absorption that Eyring's formula gives of the measured decay; NaN or None
    # where no decay was measured
    eyring_absorption: FloatArray | None = None

    # energy absorption coefficient and its 95 % interval, 0 to 1 where undetermined, each of shape
    # (n_materials, n_bands)
    absorption, lower95, upper95 = (_OfWalls(n) for n in ("absorption", "lower95", "upper95"))
    # (n_bands,), above 2 the model does not fit; whether the fit met its test of convergence
    chi2_reduced, converged = _OfBands("chi2_reduced"), _OfBands("converged")

    @property
    def materials(self) -> tuple[str, ...]:
        """Those of surfaces; objects are in `objects`."""
        from roomfit.room.scene import wall_materials

        return wall_materials(self.scene.room)

    @property
    def areas_m2(self) -> FloatArray:
        """Area of each material, shape (n_materials,)."""
        from roomfit.room.scene import material_areas_m2

        return material_areas_m2(self.scene.room)[: len(self.materials)]

    @property
    def mean_absorption(self) -> FloatArray:
        """Area-weighted mean of the room with its 95 % interval, shape (3, n_bands)."""
        return room_means(self.determined)

    @property
    def cost(self) -> float:
        """Sum over bands of half the squared weighted residuals, priors included."""
        return float(sum(b.cost for b in self.estimates))

    @property
    def models(self) -> tuple[str, ...]:
        """By band, "energy", "coherent", "values", or "prior" alone."""
        return tuple(b.model for b in self.estimates)

    @property
    def model(self) -> str:
        """The first of "coherent", "energy", "values", "prior" that any band has."""
        return next((m for m in ("coherent", "energy", "values") if m in self.models), "prior")

    @property
    def method(self) -> str:
        """What was asked for, least squares for "auto"."""
        method = self.settings.method
        return "least-squares" if method == "auto" else method

    @property
    def interval_kinds(self) -> tuple[tuple[str, ...], ...]:
        """By band and material, "gaussian", "profile", "given", or "none" where undetermined."""
        return tuple(b.kinds[: len(self.materials)] for b in self.estimates)

    @property
    def interval_kind(self) -> str:
        """How the intervals were made, in words."""
        kinds = {kind for b in self.estimates for kind in b.kinds}
        if "profile" not in kinds:
            return "Gaussian, local"
        return "profiles, else Gaussian" if "gaussian" in kinds else "profiles"

    @property
    def seed(self) -> int:
        """Of every random number."""
        return self.settings.seed

    @property
    def speed_of_sound_m_s(self) -> float:
        """In the air of the room."""
        return speed_of_sound_m_s(self.scene.air)

    @property
    def plan(self) -> tuple[str, ...]:
        """Where each source and receiver was taken to stand, in words."""
        from roomfit.room.scene import plan_in_words

        return plan_in_words(self.scene)

    @property
    def combinations(self) -> tuple[tuple[Combination, ...], ...]:
        """By band, means of materials that the data determine, the whole room first."""
        return tuple(d.combinations for d in self.determined)

    @property
    def sentences(self) -> tuple[str, ...]:
        """By band, which groups of materials the data determine."""
        return tuple(d.sentence for d in self.determined)

    @property
    def shares(self) -> FloatArray:
        """Share of each material in the room's absorption, shape (3, n_materials, n_bands)."""
        return np.stack([d.shares for d in self.determined], axis=-1)

    @property
    def prior(self) -> FloatArray:
        """Prior median and 95 % bounds, shape (3, n_materials, n_bands)."""
        return prior_intervals(self.priors)[:, : len(self.materials)]

    @property
    def logit_covariance(self) -> FloatArray:
        """Covariance of logit absorption, shape (n_bands, n_materials, n_materials).

        Misfit included; zeros for what is fixed.
        """
        n = len(self.materials)
        return logit_covariance(self.estimates, self.priors)[:, :n, :n]

    @property
    def costs(self) -> tuple[Mapping[str, FloatArray], ...]:
        """By band, sd of each logit absorption by which term of the uncertainty were left out.

        "" for none (`roomfit.uncertainty.gaussian.sd_without_term`).
        """
        n = len(self.materials)
        return tuple({name: sd[:n] for name, sd in b.costs.items()} for b in self.estimates)

    @property
    def mean_costs(self) -> tuple[Mapping[str, float], ...]:
        """As `costs`, of the mean absorption, not in the logit."""
        return tuple(b.mean_costs for b in self.estimates)

    @property
    def reasons(self) -> tuple[str, ...]:
        """What was chosen, and why, in sentences."""
        sentences, found = [], self.estimates
        if self.settings.method == "auto":
            sentences.append(
                "Least squares from the absorption that the decays suggest: it has exact "
                "derivatives, and the other searches compare the same squares."
            )
        if tried := [b.starts for b in found if b.starts is not None]:
            sentences.append(
                f"Energies were fitted from {tried[0].number} further random starts in each of "
                f"{len(tried)} bands: {sum(s.agreeing for s in tried)} of "
                f"{sum(s.number for s in tried)} ended within the intervals of the answer."
            )
        kinds = [kind for b in found for kind in b.kinds if kind != "given"]
        if "profile" in kinds:
            sentences.append(
                f"Of {len(kinds)} intervals {sum(b.n_profiles for b in found)} are so wide that "
                f"a Gaussian may fail; {kinds.count('profile')} of them were skew and are those of "
                "the profile likelihood."
            )
        return tuple(sentences)

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
        ``chi2_reduced`` have ``band_hz``.
        """
        from roomfit.base.table import optional_package

        both, names = ("material", "band_hz"), ("absorption", "lower95", "upper95", "identifiable")
        own: dict[str, Any] = {name: (both, getattr(self, name)) for name in names}
        own["interval"] = both, np.array(self.interval_kinds).T
        for start, stack in (("prior", self.prior), ("mean_absorption", self.mean_absorption)):
            for name, values in zip(("", "_lower95", "_upper95"), stack, strict=True):
                own[f"{start}{name}"] = both[-values.ndim :], values
        own["area_m2"], own["chi2_reduced"] = (
            ("material", self.areas_m2),
            ("band_hz", self.chi2_reduced),
        )
        return optional_package("xarray", "data sets", "to_xarray").Dataset(
            own,
            coords={"material": list(self.materials), "band_hz": self.bands.centres_hz},
            attrs={"intervals": self.interval_kind, "method": self.method, "model": self.model},
        )


def room_means(determined: Iterable[Determined]) -> FloatArray:
    """Return the mean over the whole room with its interval, shape (3, n_bands)."""
    means = [d.combinations[0] for d in determined]
    return np.array([(c.value, c.lower95, c.upper95) for c in means]).T


def logit_covariance(
    estimates: Sequence[BandEstimate], priors: tuple[MaterialPrior, ...]
) -> FloatArray:
    """Return the covariance of logit absorption, whatever the bounds of the fit.

    Shape (n_bands, n_materials, n_materials).
    """
    names = [k.name for k in priors]
    leaders = [priors[names.index(k.tied_to or k.name)] for k in priors]
    return posterior.plain_logit_covariance(
        np.stack([b.logit_covariance for b in estimates]),
        np.stack([b.absorption for b in estimates], axis=1),
        np.array([k.lower for k in leaders]),
        np.array([k.upper for k in leaders]),
    )


def prior_intervals(priors: tuple[MaterialPrior, ...]) -> FloatArray:
    """Return the prior of absorption as its median and 95 % interval, (3, n_materials, n_bands)."""
    by_name = {k.name: k for k in priors}
    rows = []
    for prior, mean, sd in zip(priors, *prior_logits(priors), strict=True):
        own = by_name[prior.tied_to or prior.name]
        free = mean + np.outer((0.0, -Z95, Z95), sd)
        share = own.lower + (own.upper - own.lower) * expit(free)
        rows.append(share if own.known is None else np.tile(own.known, (3, 1)))
    return np.stack(rows, axis=1)


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


def absorption_posterior(answer: Result) -> posterior.AbsorptionPosterior:
    """Return the absorption of an answer with its posterior, as predictions and designs take it.

    Objects are the last of its materials.

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
    estimates, priors = answer.estimates, answer.priors
    value, lower, upper = (
        np.stack([getattr(b, name) for b in estimates], axis=1)
        for name in ("absorption", "lower95", "upper95")
    )
    from roomfit.room.scene import material_areas_m2

    mean, law = plain_logit_law(priors)
    is_shared = any(k.product is not None or k.tied_to is not None for k in priors)
    draws = [b.draws for b in estimates if b.draws is not None]
    return posterior.AbsorptionPosterior(
        answer.scene.room.materials,
        answer.bands,
        value,
        lower,
        upper,
        logit_covariance(estimates, priors),
        prior_logit_mean=mean,
        prior_logit_sd=np.sqrt(np.diagonal(law, axis1=1, axis2=2)).T,
        prior_logit_covariance=law if is_shared else None,
        scattering=answer.scattering,
        by_pressures=answer.by_pressures,
        directivities={n: p for d in answer.directivities for n, p in d.patterns().items()},
        prior_specified=are_specified(priors),
        chi2_reduced=answer.chi2_reduced,
        draws=np.stack(draws, axis=2) if draws else None,
        fitted=tuple(
            fitted_pair(
                (p.source, p.receiver, p.state, p.distance_m),
                {n: (c.measured, c.predicted) for n, c in p.parameters.items()},
                answer.bands,
            )
            for p in answer.pairs
            if p.use == "fit"
        ),
        areas_m2=material_areas_m2(answer.scene.room),
        result_findings=answer.findings,
        objects=object_volumes_m3(priors),
    )


def fitted_pair(
    place: tuple[str, str, str, float], table: Mapping[str, Sequence[Any]], bands: Bands
) -> posterior.FittedPair:
    """Return a fitted pair from its names, distance, and (measured, predicted) by parameter."""
    unknown = np.full((2, len(bands)), np.nan)
    rows = np.array([table.get(name, unknown) for name in VALUE_NAMES], dtype=np.float64)
    return posterior.FittedPair(*place, rows[:, 0], rows[:, 1])


def result_doubts(
    absorption: posterior.AbsorptionPosterior,
    others: Iterable[Finding] = (),
    what: str = "prediction",
) -> tuple[Finding, ...]:
    """Return what doubts the result that an absorption comes from, to stand in what rests on it.

    First one sentence, where findings of the result void identifiability or its reduced chi-square
    is above 2 in one of these bands; then its findings that are serious or void identifiability,
    without those that concern other materials or bands alone, or stand among `others` already.
    `what` rests on the result: a prediction, a design.
    """
    from roomfit.uncertainty.gaussian import LARGEST_CHI2_REDUCED

    known, bands = {(f.code, f.about) for f in others}, absorption.bands
    serious = [
        f
        for f in absorption.result_findings
        if (f.severity == "serious" or f.code.voids_identifiability)
        and (not f.about.materials or set(f.about.materials) & set(absorption.materials))
        and any(f.about.in_band(float(centre)) for centre in bands.centres_hz)
    ]
    voids = list(dict.fromkeys(f.code for f in serious if f.code.voids_identifiability))
    chi2 = np.zeros(len(bands)) if absorption.chi2_reduced is None else absorption.chi2_reduced
    misfit, at_hz = (x[chi2 > LARGEST_CHI2_REDUCED].tolist() for x in (chi2, bands.centres_hz))
    repeated = tuple(f for f in serious if (f.code, f.about) not in known)
    reasons = [f"no wall of it counts as identifiable ({', '.join(voids)})"] if voids else []
    if misfit:
        where = ", ".join(f"{f:g}" for f in at_hz)
        reasons.append(f"its reduced chi-square is up to {max(misfit):.1f} at {where} Hz")
    if not reasons:
        return repeated
    text = f"The {what} rests on a doubted result: {', and '.join(reasons)}."
    about = About(bands_hz=() if voids else at_hz)
    evidence = {"codes": [c.value for c in voids], "chi2_reduced": [round(x, 2) for x in misfit]}
    return (Finding(Code.RESULT_DOUBTED, about, text, evidence), *repeated)
