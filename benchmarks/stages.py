"""What each stage of the demo costs: evaluations and processor seconds.

    python benchmarks/stages.py [--seed 1] [--box SEED] [--campaign FILE]

The demo's campaign, a box of another program or any campaign is identified twice, the second time
counted, so that no kernel is compiled meanwhile. Each stage is charged with what happens in it and
in no other stage that it calls. A prediction comes with its derivative, an expectation does not.
One thread.
"""

from __future__ import annotations

import argparse
import functools
import tempfile
import time
from collections import defaultdict
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numba
import numpy as np

import roomfit.fit.bands as bands
import roomfit.fit.directivity as directivity
import roomfit.fit.displacement as displacement
import roomfit.fit.solve as solve
import roomfit.identify as whole
import roomfit.pressures.fit as coherent
import roomfit.pressures.sequential as sequential
import roomfit.uncertainty.intervals as intervals
from _other_box import write_other_box
from roomfit.demo.boxes import demo_plan, write_measured_box
from roomfit.files.inputs import load_campaign
from roomfit.identify import identify
from roomfit.model.problem import Objective
from roomfit.solver.least_squares import BandFit

STAGES = (
    ("traces", whole, "traced_paths"),
    ("energies, before pressures", coherent, "initialise"),
    ("energies, with outliers", coherent, "rebuild"),
    ("pressures, low to high", coherent, "forward_pass"),
    ("pressures, what is fixed set free", coherent, "freed_parameters"),
    ("pressures, each under all others", coherent, "leave_one_out_pass"),
    ("energies, where they decide", coherent, "fit_band"),
    ("score tests of the chain", coherent, "chain_scores"),
    ("errors that windows share", coherent, "with_shared_errors"),
    ("energies, without pressures", solve, "fitted_band"),
    ("profiles", intervals, "profiled"),
    ("mirror images", intervals, "_mirrored"),
    ("displacements", whole, "_outline"),
    ("displacements", displacement, "located"),
    ("displacements", whole, "located"),
    ("answer, prediction of pairs", whole, "combine"),
    ("checks", whole, "examine"),
)
COUNTED = ("fits", "converged", "predict", "expected", "variance")
FITS = ("fit_band", "score_band")
Count = dict[str, float]


class Stages:
    """Evaluations and processor seconds by stage, what an inner stage does not counted twice."""

    def __init__(self) -> None:
        self.open = ["everything else"]
        self.found: dict[str, Count] = defaultdict(lambda: defaultdict(float))
        self.since = time.process_time()

    def _charge(self) -> None:
        now = time.process_time()
        self.found[self.open[-1]]["seconds"] += now - self.since
        self.since = now

    def stage(self, name: str, function: Callable[..., Any]) -> Callable[..., Any]:
        @functools.wraps(function)
        def run(*args: Any, **kwargs: Any) -> Any:
            self._charge()
            self.open.append(name)
            try:
                return function(*args, **kwargs)
            finally:
                self._charge()
                self.open.pop()

        return run

    def settling(self, fit: Callable[..., BandFit]) -> Callable[..., BandFit]:
        @functools.wraps(fit)
        def run(*args: Any, **kwargs: Any) -> BandFit:
            found = fit(*args, **kwargs)
            self.found[self.open[-1]]["fits"] += 1
            self.found[self.open[-1]]["converged"] += found.converged
            return found

        return run

    def counted(self, name: str, function: Callable[..., Any]) -> Callable[..., Any]:
        @functools.wraps(function)
        def run(*args: Any, **kwargs: Any) -> Any:
            self.found[self.open[-1]][name] += 1
            return function(*args, **kwargs)

        return run


def watched() -> Stages:
    """Put stages and counters round the functions; the caller identifies within them."""
    stages = Stages()
    for name, module, function in STAGES:
        setattr(module, function, stages.stage(name, getattr(module, function)))
    for name in COUNTED[2:]:
        setattr(Objective, name, stages.counted(name, getattr(Objective, name)))
    for module in (coherent, sequential, bands, directivity, displacement, intervals):
        for name in FITS:
            if hasattr(module, name):
                setattr(module, name, stages.settling(getattr(module, name)))
    return stages


def main() -> None:
    """Identify twice and print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, default=1, help="of the demo")
    parser.add_argument("--box", type=int, help="seed of a box of another program instead")
    parser.add_argument("--campaign", type=Path, help="a campaign file instead")
    options = parser.parse_args()
    numba.set_num_threads(1)
    with tempfile.TemporaryDirectory() as folder:
        if options.campaign is not None:
            campaign = options.campaign
        elif options.box is None:
            rng = np.random.default_rng(options.seed)
            campaign = write_measured_box(demo_plan(), Path(folder), rng)
        else:
            campaign = write_other_box(options.box, Path(folder)).campaign
        identify(**load_campaign(campaign))
        stages = watched()
        answer = identify(**load_campaign(campaign))
        stages._charge()
    titles = ("fits", "converged", "predictions", "expectations", "variances")
    print(f"{'':36s}" + "".join(f"{t:>14s}" for t in titles) + f"{'CPU s':>8s}")
    together: Count = defaultdict(float)
    for found in stages.found.values():
        for key, value in found.items():
            together[key] += value
    for name, found in (*stages.found.items(), ("together", together)):
        row = "".join(f"{found[k]:14.0f}" for k in COUNTED)
        print(f"{name:36s}{row}{found['seconds']:8.2f}")
    print(f"bands that converged: {answer.converged.sum()} of {answer.converged.size}")


if __name__ == "__main__":
    main()
