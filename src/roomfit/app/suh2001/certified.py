"""A proof for every problem of the paper: where its error function can be lowest, and how low."""

from __future__ import annotations

from collections.abc import Mapping

from roomfit.identification.certified.certificate import Certificate, certify
from roomfit.identification.certified.questions import squares_question
from roomfit.identification.certified.search import SearchSettings
from roomfit.testproblems.paper_problems import PaperProblem
from roomfit.typing import Progress

# In the paper's unit of energy squared, where black walls err by hundreds: data that the model's
# own rays have made have an error of 0 at the truth.
DELTA = 1e-8
_MAX_SECONDS = 120.0


def certificates_of(
    problems: Mapping[str, PaperProblem], walls_apart: PaperProblem, progress: Progress | None
) -> dict[str, Certificate]:
    """Return a certificate for each problem by its name, and for case 1 with its walls apart.

    Parameters
    ----------
    problems : mapping of name to PaperProblem
    walls_apart : PaperProblem
        With mirror-symmetric rays: its two answers are equally right.
    progress : callable or None
    """
    asked = {**problems, "walls_apart": walls_apart}
    found = {}
    for number, (name, problem) in enumerate(asked.items(), start=1):
        settings = SearchSettings(DELTA, max_seconds=_MAX_SECONDS)
        found[name] = certify(squares_question(problem.squares), settings)
        if progress is not None:
            progress(number / len(asked))
    return found
