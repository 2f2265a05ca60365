"""Every doubt that roomfit can report, and the record of one that came up.

A doubt stops nothing: report, command line and result file show it alike. All kinds of doubt are
members of `Code`, so that nothing that depends on one hangs on the spelling of a string.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from types import MappingProxyType
from typing import Any, Literal, Self

from roomfit.errors import InputError

Severity = Literal["info", "warning", "serious"]


@dataclass(frozen=True, slots=True)
class _Entry:
    text: str  # kebab case, as in result.json
    severity: Severity
    meaning: str  # and what to do; Markdown, for docs/findings.md
    voids_identifiability: bool = False
    graded: Severity | None = None  # the other severity, where its size decides


class Code(StrEnum):
    """The kinds of finding, each with its severity and what it means for the result.

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
    meaning : str
        What it means and what to do, in Markdown.

    Examples
    --------
    >>> Code.MODEL_DOES_NOT_FIT.value, Code.MODEL_DOES_NOT_FIT.severity
    ('model-does-not-fit', 'warning')
    >>> Code.SCATTERING_UNDERESTIMATED.voids_identifiability
    True
    """

    severities: tuple[Severity, ...]
    voids_identifiability: bool
    meaning: str

    def __new__(cls, entry: _Entry) -> Self:
        """Make the member that an entry describes."""
        member = str.__new__(cls, entry.text)
        member._value_ = entry.text
        others = () if entry.graded is None else (entry.graded,)
        member.severities = (entry.severity, *others)
        member.voids_identifiability = entry.voids_identifiability
        member.meaning = entry.meaning
        return member

    @property
    def severity(self) -> Severity:
        """The usual severity."""
        return self.severities[0]

    # The answer.

    MODEL_DOES_NOT_FIT = _Entry(
        "model-does-not-fit",
        "warning",
        "In some band the reduced chi-square `phi` exceeds 2. Nothing is called identifiable in "
        "that band, and its intervals are widened by the misfit. Look at the decay pictures; check "
        "positions, materials and scattering.",
    )
    MODEL_MISFIT_ALL_BANDS = _Entry(
        "model-misfit-all-bands",
        "serious",
        "The median of `phi` over the bands exceeds 1.5: not one band but the description of the "
        "room is at fault, such as a forgotten curtain, an open door, walls of two makes described "
        "as one, or a directional source.",
        voids_identifiability=True,
    )
    FIT_NOT_CONVERGED = _Entry(
        "fit-not-converged",
        "warning",
        "The last round still moved the answer by more than a tenth of its interval. Try another "
        "method.",
    )
    NOT_CERTIFIED = _Entry(
        "not-certified",
        "warning",
        "The search for a better answer was stopped before it was complete; the sentence says by "
        "how much the cost could be lower. Fewer materials, or more time.",
    )
    MULTIPLE_MINIMA_CERTIFIED = _Entry(
        "multiple-minima-certified",
        "warning",
        "The global search proved that absorptions far apart explain the energies within what the "
        "rays can resolve; `fit.certified` holds all of them. Measure more positions.",
    )
    MULTIPLE_MINIMA_MULTISTART = _Entry(
        "multiple-minima-multistart",
        "warning",
        "Least squares of energies from a random start ends in absorptions outside of the "
        "intervals that explain the data alike (log-likelihood lower by less than 2); the "
        "evidence holds them. Measure more positions.",
    )
    SAMPLING_NOT_CONVERGED = _Entry(
        "sampling-not-converged",
        "warning",
        'The samples of `method = "posterior"` did not converge within 6,000 evaluations a band; '
        "the Gaussian intervals stand there.",
    )
    PRIOR_DOMINATED = _Entry(
        "prior-dominated",
        "warning",
        "The answer keeps more than 90 % of the standard deviation of the prior that the campaign "
        "or the catalogue gave: its narrow interval is that prior's.",
    )
    BAND_NOT_FITTED = _Entry(
        "band-not-fitted",
        "warning",
        "Too little decay rises above the noise in this band: its numbers are those of the prior, "
        "with the interval 0 to 1.",
    )
    MATERIAL_NOT_REACHED = _Entry(
        "material-not-reached",
        "warning",
        "No path meets this material: its number is the prior's.",
    )
    MATERIALS_NOT_SEPARABLE = _Entry(
        "materials-not-separable",
        "warning",
        "No material is identifiable by itself, but the mean of the room is known within 10 %.",
    )
    MIRROR_AMBIGUITY = _Entry(
        "mirror-ambiguity",
        "warning",
        "The room is symmetric and every fitted pair stands on that symmetry, so that walls can be "
        "exchanged without changing any response; both answers are reported, and these walls are "
        "not called identifiable. A second fit begins at the exchanged absorptions; the evidence "
        "says by how much it changes the log-likelihood, and bands whose data are likelier by 2 "
        "without the exchange are left out. Measure a pair off the symmetry.",
    )
    BELOW_SCHROEDER_FREQUENCY = _Entry(
        "below-schroeder-frequency",
        "warning",
        "Part of a band lies below 2000 (T/V)^0.5 Hz, where single modes decide, which the model "
        "does not have. Trust its intervals less.",
    )

    # Positions, walls, sources and scattering as they were specified.

    REFLECTION_DELAY_DETECTED = _Entry(
        "reflection-delay-detected",
        "serious",
        "Walls delay what they reflect, and the campaign forbids it (`wall_delays = false`). Allow "
        "it.",
        voids_identifiability=True,
    )
    POSITION_INCONSISTENT = _Entry(
        "position-inconsistent",
        "serious",
        "The data are far likelier if positions, speed of sound and latencies move within their "
        'specified uncertainty, and the campaign forbids it (`positions = "fixed"`). Use '
        '`positions = "fit"`.',
        voids_identifiability=True,
    )
    POSITION_UNCERTAINTY_INFLATED = _Entry(
        "position-uncertainty-inflated",
        "warning",
        "All together, positions had to move farther than their specified standard deviations "
        "allow, by more than happens once in a thousand campaigns; the fit was repeated with "
        "standard deviations so much wider. Measure the positions, or the room, again.",
    )
    POSITION_UNCERTAINTY_ASSUMED = _Entry(
        "position-uncertainty-assumed",
        "info",
        "The campaign specifies no `position_sd` for some points; 2 cm a coordinate was assumed.",
    )
    GEOMETRY_SHIFT_IMPLAUSIBLE = _Entry(
        "geometry-shift-implausible",
        "warning",
        "To explain arrival times the fit moved a position, the speed of sound, a latency or a "
        "wall's delay by more than 3.5 times its specified standard deviation. It is specified "
        "wrongly, or compensates for an error of the model.",
    )
    WALL_POSITION_MISMATCH = _Entry(
        "wall-position-mismatch",
        "warning",
        "The echoes of a wall come from elsewhere than the specified outline has it; the sentence "
        "names the surface and how many metres. Measure the room again.",
        voids_identifiability=True,
    )
    SOURCE_NOT_OMNIDIRECTIONAL = _Entry(
        "source-not-omnidirectional",
        "serious",
        "A source that was taken for omnidirectional is not: the data are likelier if it radiates "
        "more to one side. Walls compensate for it, and intervals are wrong. Specify its "
        'directivity, or let it be fitted (`directivity = "fit"`).',
        voids_identifiability=True,
    )
    SCATTERING_UNDERESTIMATED = _Entry(
        "scattering-underestimated",
        "serious",
        "Walls specified as smooth explain the data better when they scatter: together in the "
        "three highest bands up to 4 kHz, and in none of them worse. They compensate for it by "
        "their absorption. Specify their scattering, or let it be fitted.",
        voids_identifiability=True,
    )
    SCATTERING_FITTED = _Entry(
        "scattering-fitted",
        "info",
        'What `scattering = "fit"` found, with the values that would do as well.',
    )
    SCATTERING_ASSUMED = _Entry(
        "scattering-assumed",
        "info",
        "The campaign specifies no scattering: of 0, 0.05, 0.1, 0.2 and 0.4 the one was taken that "
        "explains the responses best, and 0.1 where there are only room parameters or where it "
        "does as well.",
    )
    FEW_IMAGE_SOURCES = _Entry(
        "few-image-sources",
        "info",
        "The room has too many walls to add early reflections as pressures: energies are compared.",
    )
    FEW_CANDIDATES = _Entry(
        "few-candidates",
        "info",
        "Of `roomfit design`: fewer pairs are allowed than were asked for. Lower the least "
        "distances in `[design]`, or be content.",
    )

    # Recordings and room parameters.

    TIME_ZERO_MISMATCH = _Entry(
        "time-zero-mismatch",
        "warning",
        "The direct sound arrives more than 10 cm (and three samples) from where the geometry has "
        "it; serious from 3 m on. Check positions, `latency_s` and `time_zero`.",
        graded="serious",
    )
    DECAY_RANGE_TOO_SMALL = _Entry(
        "decay-range-too-small",
        "warning",
        "Less than 25 dB of decay before the noise or the end of the file: T20 is not evaluated "
        "there. The windows that are clear of the noise are fitted all the same.",
    )
    RECORDING_BELOW_NOISE = _Entry(
        "recording-below-noise",
        "warning",
        "No decay rises above the noise in this band: this recording is not fitted there.",
    )
    MEASUREMENT_OUTLIER = _Entry(
        "measurement-outlier",
        "warning",
        "One recording fits the room far worse than all others do; it was given that much less "
        "weight. Look at its file, positions and level.",
    )
    REPEATED_RESPONSES_DIFFER = _Entry(
        "repeated-responses-differ",
        "warning",
        "The response of one pair was measured twice with different results: one of them may "
        "belong to another pair, or the room was changed in between.",
    )
    REPEATED_VALUES_DIFFER = _Entry(
        "repeated-values-differ",
        "info",
        "The room parameters of one pair stand more than once in a table, with different values: "
        "their mean is used. A warning where they are more than a just noticeable difference "
        "apart.",
        graded="warning",
    )
    ROOM_PARAMETERS_INCONSISTENT = _Entry(
        "room-parameters-inconsistent",
        "warning",
        "Room parameters of one pair contradict each other.",
    )
    TIME_ZERO_AT_PEAK = _Entry(
        "time-zero-at-peak",
        "warning",
        "A text export of REW has its time zero at the peak, which does not say when the sound "
        'left. Set `time_zero = "direct"`, or measure with a loopback.',
    )
    LEVEL_UNKNOWN = _Entry(
        "level-unknown",
        "warning",
        "A text export of REW was normalised and does not say by how much: its level means nothing "
        "beside that of other files.",
    )
    WINDOW_APPLIED = _Entry(
        "window-applied",
        "warning",
        "A text export of REW was cut by a window, which bends the late decay and hides the noise. "
        "Export it without.",
    )
    DECONVOLVED = _Entry(
        "deconvolved",
        "info",
        "The band in which the excitation has energy enough, and how long the response is.",
    )
    RESPONSE_CLIPPED = _Entry(
        "response-clipped",
        "serious",
        "Samples stand at full scale. Measure again at a lower level.",
    )
    DC_OFFSET = _Entry("dc-offset", "info", "A constant was subtracted.")
    WAV_LENGTH_UNKNOWN = _Entry(
        "wav-length-unknown",
        "warning",
        "The header states no length, as when a program streamed the file; it was read to its end.",
    )

    # The trace.

    IMPORTANCE_WEIGHTS_DEGENERATE = _Entry(
        "importance-weights-degenerate",
        "warning",
        "Scattering differs so much over the bands from what was traced that few rays carry the "
        "energy of some of them. Fit these bands by themselves.",
    )
    CACHE_FILE_DAMAGED = _Entry(
        "cache-file-damaged",
        "info",
        "An intermediate result was damaged and computed anew; the answer is not affected.",
    )
    CACHE_NOT_WRITTEN = _Entry(
        "cache-not-written",
        "info",
        "An intermediate result could not be kept; the answer is not affected.",
    )
    RECEIVER_SPHERE_SHRUNK = _Entry(
        "receiver-sphere-shrunk",
        "info",
        "The sphere that catches rays would have cut a wall or held the source; a smaller one "
        "catches fewer rays. A warning where it catches a quarter of them or fewer.",
        graded="warning",
    )
    RAYS_ESCAPED = _Entry(
        "rays-escaped",
        "warning",
        "Rays left through gaps of the mesh, and the position of the first; serious from a "
        "thousandth of all flights on.",
        graded="serious",
    )

    # The room.

    INSIDE_OUT = _Entry(
        "inside-out",
        "info",
        "The normals of the file point into the room and were turned; nothing to do.",
    )
    FLIPPED_FACES = _Entry(
        "flipped-faces",
        "warning",
        "Some normals were oriented against the rest and were turned. Look whether the right ones "
        "were.",
    )
    SURFACE_NOT_ORIENTABLE = _Entry(
        "surface-not-orientable",
        "warning",
        "The faces cannot be oriented: a surface has one side only, as a Moebius strip.",
    )
    NOT_CLOSED = _Entry(
        "not-closed",
        "warning",
        "Edges that only one face has: the volume is approximate. See `small-leak` and `leak`.",
    )
    SMALL_LEAK = _Entry(
        "small-leak",
        "warning",
        "Sound is lost through gaps of the mesh; how much was measured with rays, and it is "
        "harmless.",
    )
    LEAK = _Entry("leak", "serious", "More than 0.1 % of hits escape through gaps: an error.")
    NO_VOLUME = _Entry("no-volume", "serious", "The mesh encloses no volume: an error.")
    NO_INTERIOR = _Entry("no-interior", "serious", "The mesh has no point inside: an error.")
    UNUSUAL_SIZE = _Entry(
        "unusual-size", "warning", "A volume that rooms seldom have. Is the unit right?"
    )
    ZERO_AREA_FACE = _Entry("zero-area-face", "serious", "Faces without area: an error.")
    SEAM_FACES = _Entry(
        "seam-faces", "info", "Faces without area that only close a seam were left out."
    )
    REPEATED_FACE = _Entry("repeated-face", "warning", "The same face twice; it was kept once.")
    BACK_TO_BACK_FACES = _Entry(
        "back-to-back-faces",
        "warning",
        "The same face twice, with opposite sides; sound meets one of them.",
    )
    SELF_INTERSECTING_POLYGON = _Entry(
        "self-intersecting-polygon",
        "warning",
        "An outline that crosses itself: a part may be covered twice or not at all.",
    )
    WARPED_POLYGON = _Entry(
        "warped-polygon",
        "info",
        "Corners off the plane of their polygon by 10 mm at most; it was cut into flat triangles.",
    )
    POLYGON_NOT_PLANAR = _Entry(
        "polygon-not-planar",
        "serious",
        "Corners off the plane of their polygon by more than 10 mm: an error. Look for a mistyped "
        "corner.",
    )
    SLIVERS = _Entry(
        "slivers",
        "info",
        "Triangles thinner than 0.1 mm: harmless, but the drawing is careless.",
    )
    NO_MATERIAL = _Entry("no-material", "serious", "A surface without a material: an error.")
    CORNERS_DIFFER = _Entry(
        "corners-differ",
        "info",
        "Tables of corners give some corner different coordinates; the last table holds.",
    )
    PLANES_REPLACED = _Entry(
        "planes-replaced", "info", "A table of planes replaces planes of an earlier one."
    )
    STATED_AREA_MISMATCH = _Entry(
        "stated-area-mismatch",
        "warning",
        "An area stated in a table of planes is not that of its corners, which hold.",
    )
    MATERIAL_NAMES_SIMILAR = _Entry(
        "material-names-similar",
        "warning",
        "Names of materials differ in spelling only and are kept apart; give them one name in "
        "`[room.materials]` if they are one.",
    )
    ENTITIES_IGNORED = _Entry(
        "entities-ignored",
        "info",
        "Parts of a DXF drawing that are no faces were passed over; a warning where they are flat "
        "ones, which may have been meant as walls.",
        graded="warning",
    )
    LAYERS_IGNORED = _Entry(
        "layers-ignored",
        "warning",
        "Parts of a DXF drawing on layers that are off or frozen were passed over.",
    )
    MATERIALS_JOINED = _Entry(
        "materials-joined", "info", "Two names of a CATT file stand for one material."
    )
    TWO_SIDED_TAKEN_AS_SHEETS = _Entry(
        "two-sided-taken-as-sheets",
        "warning",
        "Surfaces of an AC3D file that are marked two-sided count on both sides.",
    )
    POSITION_IN_WALL = _Entry(
        "position-in-wall", "serious", "A source or receiver stands in a wall: an error."
    )
    POSITION_OUTSIDE = _Entry(
        "position-outside", "serious", "A source or receiver stands outside the room: an error."
    )
    SOURCE_AT_RECEIVER = _Entry(
        "source-at-receiver", "serious", "A source and a receiver have one position: an error."
    )

    # Predictions.

    MATERIALS_CHANGED = _Entry("materials-changed", "info", "What was asked with `--set`.")
    ABSORPTION_CLIPPED = _Entry(
        "absorption-clipped", "warning", "A change with `--set` led beyond 1, and 1 was taken."
    )
    BAND_NOT_PREDICTED = _Entry(
        "band-not-predicted", "warning", "The absorption is not known in this band."
    )
    DECAY_NOT_FOLLOWED = _Entry(
        "decay-not-followed",
        "warning",
        "The trace ends before the decay has fallen by 35 dB: T30 is not predicted.",
    )
    DIRECTIVITY_NOT_KNOWN = _Entry(
        "directivity-not-known",
        "warning",
        "A directivity was to be fitted, and the absorption comes from a file that has none; "
        "predicted as omnidirectional.",
    )

    # Exports.

    EXPORT_NOT_IDENTIFIABLE = _Entry(
        "export-not-identifiable",
        "warning",
        "Values that the measurement does not determine were written all the same: do not trust "
        "them one by one.",
    )
    EXPORT_BANDS_FILLED = _Entry(
        "export-bands-filled",
        "info",
        "The other program wants bands that were not fitted: the nearest value is repeated, or one "
        "between two neighbours stands there.",
    )
    EXPORT_SCATTERING_ASSUMED = _Entry(
        "export-scattering-assumed",
        "info",
        "The result has no scattering; 0.1, or what `--scattering` says, was written.",
    )
    EXPORT_WITHOUT_SCATTERING = _Entry(
        "export-without-scattering",
        "info",
        "ODEON's library holds no scattering; enter it in its list of materials.",
    )
    EXPORT_NAMES_CHANGED = _Entry(
        "export-names-changed",
        "info",
        "The other program cannot take every name: the new ones.",
    )

    # Impedances.

    IMPEDANCE_DOES_NOT_FIT = _Entry(
        "impedance-does-not-fit",
        "serious",
        "The residual is larger than noise and the model's own error; the likely cause is named, "
        "after fits with positions, gains and spectra of the sources let free. Do not use the "
        "walls.",
    )
    IMPEDANCE_NOT_IDENTIFIABLE = _Entry(
        "impedance-not-identifiable",
        "serious",
        "Other walls explain the data as well, or the intervals of some material are wide: measure "
        "more pairs, or pairs nearer to that wall.",
    )
    TOO_FEW_DATA = _Entry(
        "too-few-data",
        "serious",
        "Fewer numbers than unknowns, or a single frequency with too few pairs or without phase: "
        "nothing was fitted.",
    )
    LEVELS_ONLY = _Entry(
        "levels-only",
        "warning",
        "Without phases other walls may explain the same levels: the verdict is a weaker one.",
    )
    NOISE_ESTIMATED = _Entry(
        "noise-estimated",
        "warning",
        "The noise was unspecified and was taken, smooth over frequency, from the residual: a "
        "model that does not fit cannot be distinguished from noise then.",
    )


_CODES = {code.value: code for code in Code}


def code_of(text: object, where: str) -> Code:
    """Return the code that stands in a file.

    Parameters
    ----------
    text : object
        As read.
    where : str
        The file, for the message.

    Raises
    ------
    InputError
        No finding has this code.
    """
    code = _CODES.get(text) if isinstance(text, str) else None
    if code is None:
        raise InputError(
            "a finding has an unknown code",
            where=where,
            found=repr(text),
            needed="a code of docs/findings.md, such as "
            f"{Code.MODEL_DOES_NOT_FIT.value!r} or {Code.PRIOR_DOMINATED.value!r}",
            hint="the file is of another version of roomfit: make it again with this one",
        )
    return code


@dataclass(frozen=True, slots=True, eq=False)
class Finding:
    """Something that a user must know before trusting a number.
    Raises
    ------
    InputError
        The code does not have the severity that was given.
    """

    code: Code  # for programs, with its severity and whether it voids identifiability
    sentence: str  # one or two sentences for a person, with the place and the numbers
    # the numbers behind the sentence, ready for JSON
    evidence: Mapping[str, Any] = field(default_factory=dict)
    graded: Severity | None = None  # given where its size decides and the code has two severities

    def __post_init__(self) -> None:
        if self.graded is not None and self.graded not in self.code.severities:
            raise InputError(
                "a finding has a severity that its code does not have",
                where=self.code.value,
                found=self.graded,
                needed=" or ".join(self.code.severities),
                hint="leave it out, or give the code both severities in roomfit.findings",
            )
        object.__setattr__(self, "evidence", MappingProxyType(dict(self.evidence)))

    @property
    def severity(self) -> Severity:
        """The severity of the code, or the one it was graded with."""
        return self.code.severity if self.graded is None else self.graded
