"""A prediction from files to files."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from roomfit.app.changes import Change
from roomfit.app.predicting.predict import predict_campaign
from roomfit.app.predicting.scene import PairChoice
from roomfit.app.progress import part
from roomfit.files.cache import cache_of
from roomfit.files.campaign.campaign import input_files, read_campaign
from roomfit.files.predictions import write_predicted
from roomfit.files.result_reader import read_result
from roomfit.files.store import check_output_folder, whole_output_folder, write_bytes_atomically
from roomfit.typing import Progress
from roomfit.uncertainty.prediction import Predicted

# What the command writes, and so may remove when it writes over an earlier prediction.
OWN_FILES = ("predicted.json", "predicted.csv", "predicted_[0-9]*.png")
_MOST_PICTURES = 24


def predict_to_folder(
    campaign_file: Path,
    absorption_file: Path,
    out: Path,
    changes: Sequence[Change] = (),
    *,
    pairs: PairChoice = "all",
    overwrite: bool = False,
    use_cache: bool = True,
    progress: Progress | None = None,
) -> Predicted:
    """Predict a campaign and write predicted.json, predicted.csv and pictures into a folder.

    Pictures of the first 24 pairs; the files hold all. A run that was killed continues from its
    last finished step, unless `use_cache` is false.

    Raises
    ------
    InputError
        Something in the campaign, the room, the absorption or the output folder is not as needed.
    StoreError
        The disk refuses.
    """
    from roomfit.report.pictures import png
    from roomfit.report.predict_pictures import predicted_decay_figure

    check_output_folder(out, overwrite=overwrite)
    campaign = read_campaign(campaign_file, to_fit=False)
    predicted = predict_campaign(
        campaign,
        read_result(absorption_file),
        changes,
        pairs=pairs,
        cache=cache_of(out) if use_cache else None,
        progress=part(progress, 0.0, 0.95),
    )
    inputs = (*input_files(campaign), Path(absorption_file))
    with whole_output_folder(out, overwrite=overwrite, own=OWN_FILES) as folder:
        write_predicted(folder, predicted, inputs)
        shown = predicted.pairs[:_MOST_PICTURES]
        for number, pair in enumerate(shown, start=1):
            name = f"predicted_{number:02d}_{_safe(pair.source)}_{_safe(pair.receiver)}.png"
            write_bytes_atomically(folder / name, png(predicted_decay_figure(predicted, pair)))
            if progress is not None:
                progress(0.95 + 0.05 * number / len(shown))
    return predicted


def _safe(name: str) -> str:
    """Return a name without what a path gives a meaning to."""
    return "".join(c if c.isalnum() or c in "-_." else "_" for c in name)[:60]
