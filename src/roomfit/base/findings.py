"""Every doubt that roomfit can report, and the record of one that came up.

A doubt stops nothing: report, command line and result file show it alike. All kinds of doubt are
members of `Code`, so that nothing that depends on one hangs on the spelling of a string.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from types import MappingProxyType
from typing import Any, Literal, Self

from roomfit.base.errors import InputError

Severity = Literal["info", "warning", "serious"]


# For codes that leave the description of the room in doubt as a whole.
_VOIDS: Literal["everything"] = "everything"


class Code(StrEnum):
    """The kinds of finding; docs/findings.md says what each means and what to do.

    A member is the text that stands in result.json, in kebab case.

    Attributes
    ----------
    severity : {"info", "warning", "serious"}
        info: good to know; warning: look at it; serious: do not use the numbers it concerns.
    severities : tuple of severities
        Two where a finding is graded by its size: the usual one first.
    voids_identifiability : bool
        Whether the description of the room is then in doubt as a whole, so that no absorption
        counts as identifiable but those that the campaign fixes: any other compensates for what
        is described wrongly.
    voids_its_own : bool
        Whether the absorptions that a finding is about, and no others, are not identifiable; of a
        code that is graded, in its gravest form only.

    Examples
    --------
    >>> Code.MODEL_DOES_NOT_FIT.value, Code.MODEL_DOES_NOT_FIT.severity
    ('model-does-not-fit', 'warning')
    >>> Code.SCATTERING_UNDERESTIMATED.voids_identifiability
    True
    """

    _value_: str
    severities: tuple[Severity, ...]
    voids_identifiability: bool
    voids_its_own: bool

    def __new__(
        cls,
        text: str,
        severity: Severity | tuple[Severity, ...],
        voids: Literal["", "everything", "its own"] = "",
    ) -> Self:
        """Make the member that stands in files as `text`."""
        member = str.__new__(cls, text)
        member._value_ = text
        member.severities = (severity,) if isinstance(severity, str) else severity
        member.voids_identifiability = voids == _VOIDS
        member.voids_its_own = voids == "its own"
        return member

    @property
    def severity(self) -> Severity:
        """The usual severity."""
        return self.severities[0]

    # The answer.

    MODEL_DOES_NOT_FIT = "model-does-not-fit", "warning"
    MODEL_MISFIT_ALL_BANDS = "model-misfit-all-bands", "serious", _VOIDS
    DECAY_NOT_REPRODUCED = "decay-not-reproduced", "serious", "its own"
    REFLECTION_DISAGREES = "reflection-disagrees", ("warning", "serious"), "its own"
    FIT_NOT_CONVERGED = "fit-not-converged", "warning"
    MULTIPLE_MINIMA_MULTISTART = "multiple-minima-multistart", "warning"
    PRIOR_DOMINATED = "prior-dominated", "warning"
    BAND_NOT_FITTED = "band-not-fitted", "warning"
    MATERIAL_NOT_REACHED = "material-not-reached", "warning"
    MATERIALS_NOT_SEPARABLE = "materials-not-separable", "warning"
    MIRROR_AMBIGUITY = "mirror-ambiguity", "warning", "its own"
    BELOW_SCHROEDER_FREQUENCY = "below-schroeder-frequency", "warning"

    # Positions, walls, sources and scattering as they were specified.

    REFLECTION_DELAY_DETECTED = "reflection-delay-detected", "serious", _VOIDS
    POSITION_INCONSISTENT = "position-inconsistent", "serious", _VOIDS
    POSITION_UNCERTAINTY_INFLATED = "position-uncertainty-inflated", "warning"
    POSITION_UNCERTAINTY_ASSUMED = "position-uncertainty-assumed", "info"
    GEOMETRY_SHIFT_IMPLAUSIBLE = "geometry-shift-implausible", "warning"
    WALL_POSITION_MISMATCH = "wall-position-mismatch", "warning", _VOIDS
    DISPLACEMENT_DETECTED = "displacement-detected", "serious", _VOIDS
    SOURCE_NOT_OMNIDIRECTIONAL = "source-not-omnidirectional", "serious", _VOIDS
    SOURCE_PATTERN_FITTED = "source-pattern-fitted", "warning"
    SCATTERING_UNDERESTIMATED = "scattering-underestimated", "serious", _VOIDS
    DECAY_BENT = "decay-bent", "serious", _VOIDS
    NOISE_GATED = "noise-gated", "serious", _VOIDS
    SCATTERING_FITTED = "scattering-fitted", "info"
    FIRST_ANSWER = "first-answer", "info"
    SCATTERING_ASSUMED = "scattering-assumed", "info"
    BROAD_PRIOR_ASSUMED = "broad-prior-assumed", "info"
    PRODUCT_ASSUMED = "product-assumed", "info"
    FEW_CANDIDATES = "few-candidates", "info"
    ON_SYMMETRY_PLANE = "on-symmetry-plane", "warning"

    # Recordings and room parameters.

    RECORDINGS_LATE = "recordings-late", "serious", _VOIDS
    COORDINATES_SCALED = "coordinates-scaled", "serious", _VOIDS
    EXCHANGED = "exchanged", "serious", _VOIDS
    LEVELS_APART = "levels-apart", "serious", _VOIDS
    POLARITY_DIFFERS = "polarity-differs", "warning"
    RECORDING_UNUSABLE = "recording-unusable", "serious"
    TIME_ZERO_MISMATCH = "time-zero-mismatch", ("warning", "serious")
    DECAY_RANGE_TOO_SMALL = "decay-range-too-small", "warning"
    RECORDING_BELOW_NOISE = "recording-below-noise", "warning"
    MEASUREMENT_OUTLIER = "measurement-outlier", "warning"
    RECORDINGS_UNUSED = "recordings-unused", "warning"
    RECORDING_COUNTED_ONCE = "recording-counted-once", "warning"
    RECORDING_OF_TWO_PAIRS = "recording-of-two-pairs", "serious", _VOIDS
    REPEATED_RESPONSES_DIFFER = "repeated-responses-differ", "warning"
    REPEATED_VALUES_DIFFER = "repeated-values-differ", ("info", "warning")
    ROOM_PARAMETERS_INCONSISTENT = "room-parameters-inconsistent", "warning"
    TIME_ZERO_AT_PEAK = "time-zero-at-peak", "warning"
    LEVEL_UNKNOWN = "level-unknown", "warning"
    WINDOW_APPLIED = "window-applied", "warning"
    DECONVOLVED = "deconvolved", "info"
    RESPONSE_CLIPPED = "response-clipped", "serious"
    DC_OFFSET = "dc-offset", "info"
    WAV_LENGTH_UNKNOWN = "wav-length-unknown", "warning"
    TABLE_PARTLY_READ = "table-partly-read", "info"

    # The trace.

    IMPORTANCE_WEIGHTS_DEGENERATE = "importance-weights-degenerate", "warning"
    FEW_RAYS = "few-rays", "warning"
    RECEIVER_SPHERE_SHRUNK = "receiver-sphere-shrunk", ("info", "warning")
    RAYS_ESCAPED = "rays-escaped", ("warning", "serious")

    # The room.

    AIR_REACHED = "air-reached", ("info", "warning")
    SEVERAL_SPACES = "several-spaces", ("info", "warning")
    FACES_CROSS = "faces-cross", "serious"
    SMALL_LEAK = "small-leak", "warning"
    LEAK = "leak", "serious"
    NO_VOLUME = "no-volume", "serious"
    UNUSUAL_SIZE = "unusual-size", "warning"
    SELF_INTERSECTING_POLYGON = "self-intersecting-polygon", "warning"
    WARPED_POLYGON = "warped-polygon", "info"
    POLYGON_NOT_PLANAR = "polygon-not-planar", "serious"
    NO_MATERIAL = "no-material", "serious"
    CORNERS_DIFFER = "corners-differ", "info"
    PLANES_REPLACED = "planes-replaced", "info"
    STATED_AREA_MISMATCH = "stated-area-mismatch", "warning"
    MATERIAL_NAMES_SIMILAR = "material-names-similar", "warning"
    ENTITIES_IGNORED = "entities-ignored", ("info", "warning")
    ROOM_COMPLETED = "room-completed", ("info", "warning")
    LAYERS_IGNORED = "layers-ignored", "warning"
    MATERIALS_JOINED = "materials-joined", "info"
    AUDIENCE_AREA = "audience-area", "info"
    AXES_EXCHANGED = "axes-exchanged", "warning"
    POSITION_IN_WALL = "position-in-wall", "serious"
    POSITION_OUTSIDE = "position-outside", "serious"
    SOURCE_AT_RECEIVER = "source-at-receiver", "serious"
    POSITIONS_MISREAD = "positions-misread", "serious"

    # Predictions.

    RESULT_EDITED = "result-edited", "serious"
    RESULT_WITHOUT_DIGEST = "result-without-digest", "info"
    RESULT_DOUBTED = "result-doubted", "serious"
    MATERIALS_CHANGED = "materials-changed", "info"
    FROM_DECAY_TIMES = "from-decay-times", "info"
    FROM_TABLES_ALONE = "from-tables-alone", "warning"
    FIELD_NOT_DIFFUSE = "field-not-diffuse", "warning"
    CHANGE_PRIOR_DOMINATED = "change-prior-dominated", "warning"
    ABSORPTION_CLIPPED = "absorption-clipped", "warning"
    BAND_NOT_PREDICTED = "band-not-predicted", "warning"
    DECAY_NOT_FOLLOWED = "decay-not-followed", "warning"
    DIRECTIVITY_NOT_KNOWN = "directivity-not-known", "warning"
    TARGET_NOT_MET = "target-not-met", "warning"
    SURFACE_COVERED_IN_PART = "surface-covered-in-part", "info"
    STANDARD_NOT_CHECKED = "standard-not-checked", "warning"

    # Exports.

    EXPORT_NOT_IDENTIFIABLE = "export-not-identifiable", "warning"
    EXPORT_BANDS_FILLED = "export-bands-filled", "info"
    EXPORT_SCATTERING_ASSUMED = "export-scattering-assumed", "info"
    EXPORT_WITHOUT_SCATTERING = "export-without-scattering", "info"
    EXPORT_NAMES_CHANGED = "export-names-changed", "info"

    # Impedances.

    IMPEDANCE_DOES_NOT_FIT = "impedance-does-not-fit", "serious"
    IMPEDANCE_NOT_IDENTIFIABLE = "impedance-not-identifiable", "serious"
    TOO_FEW_DATA = "too-few-data", "serious"
    LEVELS_ONLY = "levels-only", "warning"
    NOISE_ESTIMATED = "noise-estimated", "warning"


def code_of(text: object, where: str) -> Code:
    """Return the code that stands in a file."""
    code = next((code for code in Code if code == text), None)
    if code is None:
        what, found = "a finding has an unknown code", repr(text)
        needed = f"a code of docs/findings.md, such as {Code.MODEL_DOES_NOT_FIT.value!r}"
        hint = "the file is of another version of roomfit: make it again with this one"
        raise InputError(what, where=where, found=found, needed=needed, hint=hint)
    return code


@dataclass(frozen=True, slots=True)
class About:
    """What a finding concerns; each field that is empty sets no limit, all of them: everything.

    A finding about two bands and one material concerns that material in these bands; where not
    every material in every band is concerned, `entries` says which. Sequences of any kind are
    taken, and kept as tuples.

    Examples
    --------
    >>> About(materials=["carpet"], bands_hz=[1000]).concerns("carpet", 1000.0)
    True
    >>> About(materials=["carpet"]).concerns("plaster", 1000.0)
    False
    """

    materials: Sequence[str] = ()
    bands_hz: Sequence[float] = ()  # nominal centres
    pairs: Sequence[tuple[str, str]] = ()  # source and receiver
    files: Sequence[str] = ()  # as the campaign names them
    points_m: Sequence[tuple[float, float, float]] = ()  # places in the room's frame
    entries: Sequence[tuple[str, float]] = ()  # materials, each in one band

    def __post_init__(self) -> None:
        for name in ("materials", "files"):
            object.__setattr__(self, name, tuple(str(x) for x in getattr(self, name)))
        object.__setattr__(self, "bands_hz", tuple(float(f) for f in self.bands_hz))
        object.__setattr__(self, "pairs", tuple((str(a), str(b)) for a, b in self.pairs))
        object.__setattr__(self, "entries", tuple((str(m), float(f)) for m, f in self.entries))
        points = tuple((float(x), float(y), float(z)) for x, y, z in self.points_m)
        object.__setattr__(self, "points_m", points)

    def concerns(self, material: str, band_hz: float) -> bool:
        """Return whether the absorption of a material in a band is concerned."""
        return (
            (not self.materials or material in self.materials)
            and self.in_band(band_hz)
            and (not self.entries or (material, band_hz) in self.entries)
        )

    def in_band(self, band_hz: float) -> bool:
        """Return whether a band is concerned, of whichever materials."""
        return (not self.bands_hz or band_hz in self.bands_hz) and (
            not self.entries or any(own == band_hz for _, own in self.entries)
        )


@dataclass(frozen=True, slots=True)
class Edit:
    """One key of one table of a campaign file, and what it is to be.

    Of a finding, ``("measurements", FILE)`` is a recording as `About` names it, with ``"*"`` in
    place of a name those that the finding is about, or every source or receiver.
    """

    table: tuple[str | int, ...]  # ("sources", "LS1"), or ("measurements", 3), counted from 1
    key: str
    value: Any  # as TOML has it, or a tuple; None takes the key out, and what is below it
    how: Literal["set", "add", "scale"] = "set"  # the last two: what the campaign says, changed
    now: Sequence[Any] = ()  # it is advised where the campaign says one of these; empty: whatever


@dataclass(frozen=True, slots=True)
class Remedy:
    """What somebody who follows a finding writes into the campaign file."""

    edits: Sequence[Edit]
    words: str = ""  # after "Set" or as a button; empty: those of the edits
    # whether it counts from what the campaign said when the finding was raised: it is no remedy of
    # a campaign that was changed since
    once: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class Finding:
    """Something that a user must know before trusting a number.

    Raises
    ------
    InputError
        The code does not have the severity that was given.
    """

    code: Code  # for programs, with its severity and whether it voids identifiability
    about: About  # what is doubted; programs read this, never the sentence or the evidence
    sentence: str  # one or two sentences for a person, with the place and the numbers
    # the numbers behind the sentence, ready for JSON
    evidence: Mapping[str, Any] = field(default_factory=dict)
    graded: Severity | None = None  # given where its size decides and the code has two severities
    error: InputError | None = None  # that is raised where the finding stops what was asked for
    # several where somebody who has seen the room must choose, the likeliest first
    remedies: Sequence[Remedy] = ()

    def __post_init__(self) -> None:
        if self.graded is not None and self.graded not in self.code.severities:
            raise InputError(
                "a finding has a severity that its code does not have",
                where=self.code.value,
                found=self.graded,
                needed=" or ".join(self.code.severities),
                hint="leave it out, or give the code both severities in roomfit.base.findings",
            )
        object.__setattr__(self, "evidence", MappingProxyType(dict(self.evidence)))

    def __reduce__(self) -> tuple[Any, ...]:
        """Return what pickles a finding: evidence is a view that cannot be kept as it is."""
        own = (self.code, self.about, self.sentence, dict(self.evidence), self.graded, self.error)
        return Finding, (*own, self.remedies)

    @property
    def severity(self) -> Severity:
        """The severity of the code, or the one it was graded with."""
        return self.code.severity if self.graded is None else self.graded
