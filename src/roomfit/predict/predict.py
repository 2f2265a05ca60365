"""Prediction of a room by its paths, or as a diffuse field where no position is known."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace
from typing import TypeAlias

from roomfit.base.kernels import one_blas_thread
from roomfit.base.typing import Progress
from roomfit.predict.changes import Change, by_variant
from roomfit.predict.diffuse import PreparedField, predict_field, prepare_field
from roomfit.predict.other_walls import PreparedRoom, predict_paths, prepare_paths
from roomfit.predict.prediction import Predicted
from roomfit.predict.question import Question

ChangingRoom: TypeAlias = PreparedRoom | PreparedField


def predict(question: Question, *, progress: Progress | None = None) -> Predicted:
    """Predict the room parameters of every pair of a scene, with 95 % intervals.

    The room is traced once; draws of the absorption weigh the same paths. In a room that was
    fitted, predictions begin with what was measured (`roomfit.predict.measured.anchors`): a pair is
    expected by the other fitted pairs and by what the model says of its place, as far as the model
    has distinguished the fitted pairs; means are those measured. An interval is where a measurement
    is expected, 95 of 100 times, as far as fitted pairs departed from what others say of them.

    With changes, what was measured or is expected before is followed by what the model says that
    they do, with the same draws of all that stays (`PredictedValue.change`): what is not known of
    both states cancels. Where the interval of a change includes none, its direction is not
    determined. In another room than the fitted one predictions are the model's, as wrong as it was
    of the fitted pairs.

    Variants, which some changes name, stand beside each other (`Predicted.variants`).

    Of a diffuse field T30 alone is predicted, by its formula; what was measured is kept, and
    carried over by the change.

    Raises
    ------
    InputError
        Other materials than the room's, a change that cannot be made, a position in a wall or
        outside, or a measurement of a pair that is not predicted.

    See Also
    --------
    prepare, predict_change : the same in two steps, the second in half a second.

    Notes
    -----
    Parameters are those of ISO 3382-1:2009, and the speech transmission index of IEC
    60268-16:2020 where the bands are the octaves from 125 Hz to 8 kHz.

    Examples
    --------
    >>> import roomfit
    >>> room = roomfit.shoebox_room((6.0, 5.0, 3.0), "plaster")
    >>> scene = roomfit.scene_of(room, {"S": (1.5, 1.2, 1.5)}, {"R": (4.0, 3.5, 1.2)})
    >>> measured = roomfit.MeasuredValues("S", "R", [1000.0], {"T20_s": [0.8]})
    >>> octave, few = roomfit.bands_between("octave", 1000, 1000), roomfit.Settings(n_rays=2000)
    >>> result = roomfit.identify(scene, [measured], bands=octave, settings=few)
    >>> known = roomfit.absorption_posterior(result)
    >>> predicted = roomfit.predict(roomfit.Question(scene, known, settings=few))
    >>> time = predicted.pairs[0].parameters["T20_s"]
    >>> bool(time.lower95[0] < time.predicted[0] < time.upper95[0])
    True

    ``roomfit.predict(roomfit.question_of(campaign, result))`` is what the command line does.
    """
    began, groups = time.perf_counter(), by_variant(question.changes)
    room = prepare(question, tuple(groups.values()), progress=progress)
    found, *others = (predict_change(room, changes) for changes in groups.values())
    variants = dict(zip([*groups][1:], others, strict=True))
    return replace(found, variants=variants, seconds=time.perf_counter() - began)


@one_blas_thread
def prepare(
    question: Question,
    alternatives: Sequence[Sequence[Change]] = (),
    *,
    progress: Progress | None = None,
) -> ChangingRoom:
    """Trace and predict a room as it was found, ready for many changes by `predict_change`.

    Decays are followed as long as with the hardest of the alternatives, each some changes that may
    be asked for.
    """
    if question.field is not None:
        return prepare_field(question.field, question.scene, question.absorption, question.settings)
    return prepare_paths(question, alternatives, progress)


@one_blas_thread
def predict_change(room: ChangingRoom, changes: Sequence[Change] = ()) -> Predicted:
    """Predict a prepared room with changes, as `predict` does.

    Bands in which the last change had the same absorption are not evaluated anew.

    Parameters
    ----------
    room : PreparedRoom or PreparedField
        From `prepare`.
    changes : sequence of Change
    """
    if isinstance(room, PreparedField):
        return predict_field(room, changes)
    return predict_paths(room, changes)
