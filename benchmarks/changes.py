"""A known change of a measured room: PTB's studio, fitted with open curtains and predicted closed.

    python benchmarks/changes.py FOLDER

FOLDER holds `ptb_studio`, which does not come with roomfit. The studio is fitted to the values
measured with its curtains open, and predicted with these made of the cloth stated of the closed.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

import room_values
from roomfit.base.bands import Bands, bands_between
from roomfit.identify import identify
from roomfit.materials.catalogue import material_prior
from roomfit.materials.priors import MaterialPrior
from roomfit.predict.changes import Change
from roomfit.predict.predict import predict
from roomfit.predict.question import Question
from roomfit.result import absorption_posterior
from roomfit.settings import Settings

CLOTH = {False: "curtain(open)", True: "curtain (closed)"}
STATED_LOGIT_SD = 0.5
CHANGE_SD = 0.25  # relative, of the ratio of the two states of the cloth
STUDIO_SETTINGS = Settings(n_rays=5000, n_random_starts=0, n_draws=64)


def studio_priors(
    folder: Path, materials: tuple[str, ...], bands: Bands, scattering: np.ndarray, *, broad: bool
) -> tuple[MaterialPrior, ...]:
    """Return the stated absorption with a logit sd of 0.5, or nothing but the scattering."""
    found = []
    for name, s in zip(materials, scattering, strict=True):
        a = np.clip(stated_absorption(folder, name, bands), 0.01, 0.99)
        prior = None if broad else (a, STATED_LOGIT_SD * a * (1.0 - a))
        found.append(material_prior(name, bands, prior=prior, scattering=float(s)))
    return tuple(found)


def stated_absorption(folder: Path, name: str, bands: Bands) -> np.ndarray:
    """Return the absorption that the participants were given, (n_bands,)."""
    at = np.isin(room_values.BANDS.centres_hz, bands.centres_hz)
    return np.asarray(room_values.stated(folder, name)[0][at])


def studio_measured(folder: Path) -> None:
    """Print what is said of the studio's curtains closed where only its open state was measured."""
    case = room_values.studio(folder)
    bands = bands_between("octave", 500, 2000)
    new = stated_absorption(folder, CLOTH[True], bands)
    for broad in (False, True):
        priors = studio_priors(
            folder, case.scene.room.materials, bands, case.scattering, broad=broad
        )
        answer = identify(case.scene, case.values, priors, bands, settings=STUDIO_SETTINGS)
        changes = [Change(CLOTH[False], "value", tuple(new), tuple(CHANGE_SD * new * (1 - new)))]
        found = predict(
            Question(
                case.scene,
                absorption_posterior(answer),
                changes,
                case.values,
                settings=STUDIO_SETTINGS,
            )
        )
        label = "broad" if broad else "stated"
        print(f"\nmeasured, open; cloth as stated of the closed one; {label} priors")
        print(found)


def main() -> None:
    """Run what was asked for."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("folder", type=Path)
    studio_measured(parser.parse_args().folder / "ptb_studio")


if __name__ == "__main__":
    main()
