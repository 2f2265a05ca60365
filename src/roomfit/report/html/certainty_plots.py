"""How sure the answer is, to be looked at: what is identifiable, profiles, a posterior's corner."""

from __future__ import annotations

import numpy as np

from roomfit.report.html.absorption_tables import given
from roomfit.report.html.plots import (
    ACCENT,
    INK,
    SECOND,
    Figure,
    Plot,
    base_layout,
    label,
    outer_titles,
    panel_axes,
    panel_layout,
    panel_title,
    rounded,
)
from roomfit.report.html.wording import hertz, number
from roomfit.uncertainty.answer import Answer
from roomfit.uncertainty.choice import most_tied_band, shown_profiles
from roomfit.uncertainty.profile import RISE95, Profile, profile_curve

_MOST_MATERIALS, _MOST_DRAWS = 6, 500
_ROW_PX = 26


def identifiability_plot(answer: Answer) -> Plot:
    """Return a matrix of materials by bands: the darker, the narrower the 95 % interval."""
    width, held = answer.upper95 - answer.lower95, given(answer)
    names = [label(name, 22) for name in answer.materials]
    bands = [hertz(float(f)) for f in answer.bands.centres_hz]
    height_px = 150 + _ROW_PX * len(names)
    layout = base_layout(height_px)
    layout["margin"] |= {"l": 150, "t": 20}
    layout["xaxis"] = {"title": {"text": "band centre"}, "type": "category", "ticks": ""}
    layout["yaxis"] = {"type": "category", "autorange": "reversed", "ticks": ""}
    marks = np.where(held, "given", np.where(answer.identifiable, "\N{CHECK MARK}", ""))
    data = {
        "type": "heatmap",
        "x": bands,
        "y": names,
        "z": [rounded(row, 3) for row in width],
        "text": marks.tolist(),
        "texttemplate": "%{text}",
        "zmin": 0.0,
        "zmax": 1.0,
        "colorscale": [[0.0, "#08306b"], [0.2, "#2f7fbc"], [0.5, "#a6cde4"], [1.0, "#f7fbff"]],
        "colorbar": {"title": {"text": "width"}, "thickness": 14},
        "xgap": 2,
        "ygap": 2,
        "hovertemplate": "%{y}, %{x}: interval %{z} wide %{text}<extra></extra>",
    }
    return Plot(
        "identifiable",
        {"data": [data], "layout": layout},
        height_px,
        "Matrix of materials by bands: width of the 95 % interval; the tables hold every number.",
        "Width of the 95 % interval of every coefficient, dark where it is narrow. A tick marks "
        "what is identifiable.",
    )


def profile_plot(answer: Answer) -> Plot | None:
    """Return the profiles that took the place of Gaussian intervals; None where there are none."""
    shown = shown_profiles(answer)
    if not shown:
        return None
    x_axis: Figure = {"rangemode": "tozero"}
    layout, height_px = panel_layout(len(shown), x_axis, {"range": [0.0, 5.0]})
    for key in layout:
        if key.startswith("xaxis"):
            layout[key].pop("matches", None)
    layout["annotations"] = [
        *(
            panel_title(
                layout,
                i,
                f"<b>{label(answer.materials[line.entry], 20)}</b>, "
                f"{hertz(float(answer.bands.centres_hz[band]))}",
            )
            for i, (band, line) in enumerate(shown)
        ),
        *outer_titles("absorption coefficient", "rise of the cost"),
    ]
    traces = [t for i, s in enumerate(shown) for t in _profile_traces(answer, i, *s)]
    return Plot(
        "profiles",
        {"data": traces, "layout": layout},
        height_px,
        "Profiles of the likelihood of single coefficients; their ends are in the table.",
        "How the cost rises when one coefficient is moved and all else is fitted again, misfit "
        "taken out. The 95 % interval ends where the curve meets the dotted line at 1.92; bands "
        "beside are taken for another standard deviation where absorption changes fast.",
    )


def _profile_traces(answer: Answer, panel: int, band: int, line: Profile) -> list[Figure]:
    free, rise = profile_curve(line, 60)
    at = 0.5 * (1.0 + np.tanh(0.5 * free))
    a, low, high = (
        float(x[line.entry, band]) for x in (answer.absorption, answer.lower95, answer.upper95)
    )
    axes, first = panel_axes(panel), panel == 0
    common = {"type": "scatter", "hoverinfo": "skip", "showlegend": first, **axes}
    return [
        common
        | {
            "mode": "lines",
            "name": "profile",
            "legendgroup": "profile",
            "x": rounded(at, 4),
            "y": rounded(rise, 3),
            "line": {"color": ACCENT, "width": 1.6},
            "hoverinfo": "x+y",
        },
        common
        | {
            "mode": "lines",
            "name": "1.92",
            "legendgroup": "end",
            "x": rounded(np.array([min(low, at.min()), max(high, at.max())]), 4),
            "y": [round(RISE95, 3)] * 2,
            "line": {"color": INK, "width": 1, "dash": "dot"},
        },
        common
        | {
            "mode": "markers",
            "name": "answer and its 95 % interval",
            "legendgroup": "answer",
            "x": [round(a, 4)],
            "y": [0.15],
            "error_x": {
                "type": "data",
                "symmetric": False,
                "array": [round(high - a, 4)],
                "arrayminus": [round(a - low, 4)],
                "color": SECOND,
                "thickness": 2,
            },
            "marker": {"color": SECOND, "size": 7},
            "text": [f"{number(a, 3)} ({number(low, 3)} to {number(high, 3)})"],
            "hoverinfo": "text",
        },
    ]


def corner_plot(answer: Answer) -> Plot | None:
    """Return samples of the band whose materials hang together most; None where there are none."""
    band = most_tied_band(answer.samples)
    draws = None if band is None else answer.samples[band]
    if band is None or draws is None:
        return None
    free = np.flatnonzero(np.ptp(draws, axis=0) > 0.0)[:_MOST_MATERIALS]
    some = draws[:: max(len(draws) // _MOST_DRAWS, 1)]
    height_px = 140 + 110 * len(free)
    layout = base_layout(height_px)
    layout["margin"] |= {"l": 80, "t": 20}
    layout["hovermode"] = False
    data = {
        "type": "splom",
        "dimensions": [
            {"label": label(answer.materials[i], 14), "values": rounded(some[:, i], 4)}
            for i in free
        ],
        "showupperhalf": False,
        "diagonal": {"visible": False},
        "marker": {"size": 3, "color": ACCENT, "opacity": 0.45},
    }
    centre = hertz(float(answer.bands.centres_hz[band]))
    return Plot(
        "corner",
        {"data": [data], "layout": layout},
        height_px,
        f"Samples of the absorption coefficients at {centre}, each material against each other.",
        f"Samples of the posterior at {centre}, the band whose materials hang together most: each "
        "point is one set of absorption coefficients that explains the data. Narrow clouds along a "
        "slope: only a sum is known.",
    )
