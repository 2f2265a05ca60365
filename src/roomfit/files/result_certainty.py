"""What result.json tells of how sure an answer is: shares, priors, groups, samples."""

from __future__ import annotations

from typing import Any

from roomfit.files.numbers_json import numbers
from roomfit.typing import FloatArray
from roomfit.uncertainty.answer import Answer


def shares_content(answer: Answer, material: int) -> dict[str, list[float]]:
    """Of the room's absorption, air left out."""
    if answer.shares is None:
        return {}
    names = ("share", "share_lower95", "share_upper95")
    return {name: numbers(part[material]) for name, part in zip(names, answer.shares, strict=True)}


def beforehand_content(answer: Answer, material: int) -> dict[str, Any]:
    """The prior beside the answer, and how each interval was made."""
    content: dict[str, Any] = {}
    if answer.prior is not None:
        names = ("absorption", "lower95", "upper95")
        parts = zip(names, answer.prior, strict=True)
        content["prior"] = {name: numbers(part[material]) for name, part in parts}
    if answer.interval_kinds and all(answer.interval_kinds):
        content["interval"] = [kinds[material] for kinds in answer.interval_kinds]
    return content


def sampling_content(answer: Answer) -> list[dict[str, Any]]:
    """How the samples of each band came about."""
    return [
        {
            "band_hz": float(centre),
            "converged": s.converged,
            "evaluations": s.evaluations,
            "independent": round(s.effective, 1),
            "autocorrelation": round(float(s.autocorrelation.max()), 2),
            "r_hat": round(float(s.r_hat.max()), 4),
            "acceptance": round(s.acceptance, 3),
        }
        for centre, s in zip(answer.bands.centres_hz, answer.sampling, strict=False)
        if s is not None
    ]


def combinations_content(answer: Answer) -> list[dict[str, Any]]:
    """Means over groups of materials that the data determine, the whole room's first."""
    return [
        {
            "band_hz": float(centre),
            "kind": "mean",
            "weights": _weights(answer, c.weights),
            "absorption": c.value,
            "lower95": c.lower95,
            "upper95": c.upper95,
            "determined": c.determined,
            "differences": [
                {
                    "kind": "difference",
                    "weights": _weights(answer, d.weights),
                    "absorption": d.value,
                    "lower95": d.lower95,
                    "upper95": d.upper95,
                    "determined": d.determined,
                }
                for d in c.differences
            ],
            **({"sentence": sentence} if number == 0 and sentence else {}),
        }
        for centre, band, sentence in zip(
            answer.bands.centres_hz, answer.combinations, _sentences(answer), strict=True
        )
        for number, c in enumerate(band)
    ]


def _sentences(answer: Answer) -> tuple[str, ...]:
    return answer.sentences or ("",) * len(answer.combinations)


def _weights(answer: Answer, weights: FloatArray) -> dict[str, float]:
    named = zip(answer.materials, weights, strict=True)
    return {name: round(float(w), 6) for name, w in named if w != 0.0}
