"""The answer of an identification: numbers, their intervals, and every doubt about them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from roomfit.bands import Bands
from roomfit.findings import Finding
from roomfit.objective.coherent import FittedGeometry
from roomfit.objective.directivity import FittedDirectivity
from roomfit.response.directivity import FirstOrderBands
from roomfit.solvers.certificate import Certificate
from roomfit.typing import BoolArray, FloatArray
from roomfit.uncertainty.combinations import Combination
from roomfit.uncertainty.posterior import AbsorptionPosterior, covariance_from_intervals
from roomfit.uncertainty.profile import Profile
from roomfit.uncertainty.sampling import Sampled

Use = Literal["fit", "validate"]


@dataclass(frozen=True, slots=True, eq=False)
class Compared:
    """One room-acoustic parameter of one pair in every band, measured and predicted.

    Attributes
    ----------
    measured, predicted : float arrays, shape (n_bands,)
        NaN where it cannot be determined.
    null : float array, shape (n_bands,)
        The mean of this parameter over the other measurements that were fitted: what one would
        guess without any model of the room. NaN where there is no other.
    jnd : float array, shape (n_bands,)
        Predicted minus measured in just noticeable differences of ISO 3382-1.
    """

    measured: FloatArray
    predicted: FloatArray
    null: FloatArray
    jnd: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Decay:
    """Energy decay curves of one pair, for looking at.

    Attributes
    ----------
    time_s : float array, shape (n_times,)
        After emission.
    measured_db, predicted_db : float arrays, shape (n_bands, n_times)
        Relative to the whole; NaN beyond the usable part.
    """

    time_s: FloatArray
    measured_db: FloatArray
    predicted_db: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class ComparedPair:
    """Measured against predicted for one source and receiver.

    Attributes
    ----------
    source, receiver : str
    use : {"fit", "validate"}
        "validate": this pair was predicted without having been fitted.
    parameters : mapping of "T20_s", "T30_s", "EDT_s", "C50_dB", "C80_dB", "D50_percent", "TS_ms"
        and "G_dB", those that are known.
    decay : Decay or None
        None where room parameters were measured and no response.
    """

    source: str
    receiver: str
    use: Use
    parameters: Mapping[str, Compared]
    decay: Decay | None


@dataclass(frozen=True, slots=True, eq=False)
class Answer:
    """What an identification found.

    Attributes
    ----------
    bands : Bands
    materials : tuple of str
    areas_m2 : float array, shape (n_materials,)
    absorption, lower95, upper95 : float arrays, shape (n_materials, n_bands)
        Energy absorption and its 95 % interval; 0 to 1 where the data tell nothing.
    identifiable : bool array, shape (n_materials, n_bands)
    mean_absorption : float array, shape (3, n_bands)
        Area-weighted mean absorption of the room, its lower and its upper 95 % bound.
    chi2_reduced : float array, shape (n_bands,)
        Pearson's chi-square over degrees of freedom; above 2 the model does not fit.
    cost : float
        Sum over bands of half the squared weighted residuals, priors included.
    evaluations : int
    converged : bool array, shape (n_bands,)
    pairs : tuple of ComparedPair
    findings : tuple of Finding
    method, model : str
    interval_kind : str
        How the intervals were made, in words.
    speed_of_sound_m_s : float
    seed : int
    seconds : float
    logit_covariance : float array, shape (n_bands, n_materials, n_materials), or None
        Covariance of logit absorption, misfit included; zeros for what is held. None where only
        the intervals are known.
    logit_prior : float array, shape (2, n_materials, n_bands), or None
        Mean and standard deviation of logit absorption before anything was measured.
    prior_specified : bool array, shape (n_materials,), or None
        Whether the campaign specifies that prior, or it is the broad default.
    combinations : tuple of tuples of Combination, one a band
        Means over groups of materials that the data determine, that of the whole room first.
    models : tuple of str, one a band
        "energy", "coherent", "values", or "prior" where nothing could be fitted.
    scattering : float array, shape (n_materials, n_bands), or None
        What the walls were taken to scatter, told, assumed or fitted.
    geometry : FittedGeometry or None
        None where arrival times were not fitted.
    directivities : tuple of FittedDirectivity
        Of the sources whose directivity was fitted.
    certificates : tuple of Certificate or None, one a band
        What was proven of the lowest cost of energies with their weights held; empty where nobody
        asked.
    sentences : tuple of str, one a band
        What the data know of groups of materials and what they leave open; "" where nothing is.
    shares : float array, shape (3, n_materials, n_bands), or None
        Share of each material in the room's absorption, its lower and its upper 95 % bound.
    interval_kinds : tuple of tuples of str, one a band, one a material
        "gaussian", "profile", "sampled", "given", or "none" where the data tell nothing.
    profiles : tuple of tuples of Profile, one a band
        `entry` counts materials.
    samples : tuple of float arrays, shape (n_draws, n_materials), or None, one a band
        Absorption drawn from the posterior.
    sampling : tuple of Sampled or None, one a band
    prior : float array, shape (3, n_materials, n_bands), or None
        Median of absorption beforehand, its lower and its upper 95 % bound.
    reasons : tuple of str
        What was chosen, and why.
    """

    bands: Bands
    materials: tuple[str, ...]
    areas_m2: FloatArray
    absorption: FloatArray
    lower95: FloatArray
    upper95: FloatArray
    identifiable: BoolArray
    mean_absorption: FloatArray
    chi2_reduced: FloatArray
    cost: float
    evaluations: int
    converged: BoolArray
    pairs: tuple[ComparedPair, ...]
    findings: tuple[Finding, ...]
    method: str
    model: str
    interval_kind: str
    speed_of_sound_m_s: float
    seed: int
    seconds: float
    logit_covariance: FloatArray | None = None
    logit_prior: FloatArray | None = None
    combinations: tuple[tuple[Combination, ...], ...] = ()
    models: tuple[str, ...] = ()
    scattering: FloatArray | None = None
    geometry: FittedGeometry | None = None
    directivities: tuple[FittedDirectivity, ...] = ()
    certificates: tuple[Certificate | None, ...] = ()
    sentences: tuple[str, ...] = ()
    shares: FloatArray | None = None
    interval_kinds: tuple[tuple[str, ...], ...] = ()
    profiles: tuple[tuple[Profile, ...], ...] = ()
    samples: tuple[FloatArray | None, ...] = ()
    sampling: tuple[Sampled | None, ...] = ()
    prior: FloatArray | None = None
    reasons: tuple[str, ...] = ()
    prior_specified: BoolArray | None = None


def absorption_posterior(answer: Answer) -> AbsorptionPosterior:
    """Return the absorption of an answer with its posterior, as predictions and designs take it.

    Where the answer has no covariance, the intervals are taken as independent.

    Examples
    --------
    ``roomfit.predict(scene, roomfit.absorption_posterior(roomfit.identify(scene, measurements)))``
    """
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
        scattering=answer.scattering,
        directivities={d.source: FirstOrderBands(d.b) for d in answer.directivities},
        chi2_reduced=answer.chi2_reduced,
    )


def certificate_distance(answer: Answer, band: int) -> float:
    """Return the largest difference of any absorption from the certified minimiser's.

    An answer from pressures is not the minimiser of energies: this is how far apart they are.

    Parameters
    ----------
    band : int
        One with a certificate.
    """
    proof = answer.certificates[band]
    assert proof is not None  # noqa: S101 - the caller's promise
    best = dict(zip(proof.coordinates, proof.clusters[0].minimiser, strict=True))
    return max(
        abs(float(best[name]) - float(answer.absorption[i, band]))
        for i, name in enumerate(answer.materials)
        if name in best
    )
