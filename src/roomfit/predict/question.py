"""What is asked of a room: its scene, what is known of its walls, and what is to be changed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from dataclasses import field as of_fields

import numpy as np

from roomfit.base.bands import Bands
from roomfit.base.errors import InputError, InsufficientDataError
from roomfit.base.findings import About, Code, Finding
from roomfit.base.typing import BoolArray, FloatArray
from roomfit.checks.verdict import voids_walls
from roomfit.fit.traced_room import check_scene
from roomfit.predict.changes import Change, values_per_band
from roomfit.predict.diffuse_field import DiffuseField
from roomfit.room.scene import Scene, pair_names
from roomfit.settings import Settings
from roomfit.signals.iso3382 import MeasuredValues
from roomfit.signals.measurement import Measurement
from roomfit.uncertainty.posterior import AbsorptionPosterior


@dataclass(frozen=True, slots=True, eq=False)
class Question:
    """A room to be predicted, and what is known of it.

    Parameters
    ----------
    scene : Scene
        Room, sources, receivers and air, and the pairs to predict. Nothing in it is fitted.
    absorption : AbsorptionPosterior, optional
        Of exactly the room's materials, in their order; in the bands to predict, 0 to 1,
        dimensionless. Scattering coefficients and directivities of sources come with it. A result
        of another room is brought to this form by `roomfit.question_of`. Left out of a diffuse
        field: by its decay times, or by its priors where there are none.
    changes : sequence of Change
        What if: materials with another absorption, from `roomfit.read_change`.
    measurements : sequence of Measurement or MeasuredValues
        Of pairs of the scene, to stand beside the prediction; nothing is fitted to them.
    settings : Settings
        `Settings.n_draws` draws of the absorption stand behind the intervals.
    speech_db : float array, shape (2, 7), optional
        Octave levels from 125 Hz to 8 kHz of speech at 1 m in the free field, and of noise at the
        listeners; left out: the speech transmission index is that of the room, without noise,
        masking and threshold.
    field : DiffuseField, optional
        In place of paths, where no position is known; the scene is without sources and receivers.
    """

    scene: Scene
    absorption: AbsorptionPosterior | None = None
    changes: Sequence[Change] = ()
    measurements: Sequence[Measurement | MeasuredValues] = ()
    settings: Settings = of_fields(default_factory=Settings)
    speech_db: FloatArray | None = None
    field: DiffuseField | None = None

    @property
    def known(self) -> AbsorptionPosterior:
        """The absorption, which must be given where paths are weighed."""
        if self.absorption is None:
            needed, hint = "an absorption of every material", "take that of a result"
            raise InputError("no absorption is given", found="none", needed=needed, hint=hint)
        return self.absorption

    def check(self) -> None:
        """Refuse other materials than the room's, and a measurement of what is not predicted."""
        self.known.check_materials(self.scene.room.materials)
        check_scene(self.scene)
        pairs = pair_names(self.scene)
        for m in self.measurements:
            if m.pair_name not in pairs:
                raise InputError(
                    "a measurement of a pair that is not predicted",
                    found=" to ".join(m.pair_name[:2]) + (f" ({m.state})" if m.state else ""),
                    needed="a pair of the scene, in its state of the room",
                    hint="leave it out, or add the pair to the scene",
                )


def undoubted(
    absorption: AbsorptionPosterior, bands: Bands, changes: Sequence[Change], state: str
) -> tuple[Bands, Sequence[Change], tuple[Finding, ...]]:
    """Return the bands in which other walls can be predicted, changes there, and what is left out.

    All of them where the room is as it was fitted. Elsewhere not those in which a serious finding
    says that all absorptions are wrong: intervals hold every split of the sum that was measured,
    but the sum itself may be wrong. Of a finding about some materials the split is.
    """
    if not changes and state in (absorption.fitted_states or (state,)):
        return bands, changes, ()
    void = [
        f
        for f in absorption.result_findings
        if f.severity == "serious" and voids_walls(f) and not f.about.materials
    ]
    centres_hz = bands.centres_hz.tolist()
    kept = np.array([not any(f.about.in_band(c) for f in void) for c in centres_hz])
    if kept.all():
        return bands, changes, ()
    codes = ", ".join(dict.fromkeys(f.code.value for f in void))
    if not kept.any():
        raise InsufficientDataError(
            "other walls are not predicted from a result whose walls are seriously doubted",
            found=f"{codes}, in every band",
            needed="in some band, absorptions that no serious finding calls wrong",
            hint="put right what the findings name, and identify again; or add --doubted (in "
            "Python doubted=True), whose intervals hold less than they say",
        )
    own = tuple(_at(c, bands, kept) if len(c.values) > 1 else c for c in changes)
    left_out = bands.centres_hz[~kept].tolist()
    text = (
        f"With other walls nothing is predicted at {', '.join(f'{f:g}' for f in left_out)} Hz: the "
        f"result is seriously doubted there ({codes}). With --doubted it is, by intervals that "
        "hold less than they say."
    )
    finding = Finding(Code.RESULT_DOUBTED, About(bands_hz=left_out), text)
    return Bands(bands.kind, bands.centres_hz[kept]), own, (finding,)


def _at(change: Change, bands: Bands, kept: BoolArray) -> Change:
    """Return a change, which has one value a band, with those of some bands."""
    values, sds = (tuple(of[kept].tolist()) for of in values_per_band(change, bands, np.inf))
    return replace(change, values=values, sds=sds)
