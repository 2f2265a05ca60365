"""The report: a whole answer as one HTML file that needs nothing beside it."""

from __future__ import annotations

import base64
import gzip
from collections.abc import Mapping
from importlib.metadata import version
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined

from roomfit.geometry.measures import surface_area_m2, volume_m3
from roomfit.report.html.absorption_picture import absorption_plot
from roomfit.report.html.absorption_tables import (
    absorption_tables,
    area_tables,
    fit_tables,
    prior_tables,
    share_tables,
)
from roomfit.report.html.certainty_plots import (
    corner_plot,
    identifiability_plot,
    profile_plot,
)
from roomfit.report.html.certificate_tables import certificate_tables
from roomfit.report.html.decay_picture import decay_plot
from roomfit.report.html.error_tables import error_tables
from roomfit.report.html.pair_tables import overview_table, pair_sections
from roomfit.report.html.plots import page_json
from roomfit.report.html.room_picture import material_table, position_table, room_plot
from roomfit.report.html.room_plan import room_plan
from roomfit.report.html.source_tables import source_tables
from roomfit.report.html.summary import finding_groups, summary_sentences, told_in_words
from roomfit.report.html.wording import area, number
from roomfit.scene.scene import Scene
from roomfit.uncertainty.answer import Answer


def report_html(
    answer: Answer,
    scene: Scene,
    *,
    title: str,
    campaign: str | None = None,
    inputs_sha256: Mapping[str, str] | None = None,
) -> str:
    """Return the report of an identification as the text of one HTML file, 2 to 5 MB.

    It holds, in this order: the answer in words, findings, the room, absorption with its
    intervals, absorption areas, predictions beside measurements and beside the null model, and
    where everything comes from. The file asks nothing of any network: the script that draws
    (plotly.js) is inside, and the page's own content security policy forbids requests. Tables,
    findings and the plan can be read without a script. Equal arguments give equal text.

    Parameters
    ----------
    answer : Answer
    scene : Scene
        That the answer was found in: room, positions and air.
    title : str
    campaign : str, optional
        Name of the campaign file, for provenance.
    inputs_sha256 : mapping of str to str, optional
        SHA-256 of every input file by its name.

    Returns
    -------
    str
        Write it as UTF-8.
    """
    drawn = decay_plot(answer)
    decay, curves = drawn if drawn else (None, [])
    room, absorption = room_plot(scene), absorption_plot(answer)
    sure, bent, corner = identifiability_plot(answer), profile_plot(answer), corner_plot(answer)
    drawn_here = (room, absorption, sure, bent, corner, decay)
    plots = [plot for plot in drawn_here if plot is not None]
    text: str = _template().render(
        title=title,
        summary=summary_sentences(answer),
        findings=finding_groups(answer.findings),
        room=room,
        plan=room_plan(scene),
        materials=material_table(scene.room),
        positions=position_table(scene),
        absorption=absorption,
        certainty=[plot for plot in (sure, bent, corner) if plot is not None],
        prior_tables=prior_tables(answer),
        reasons=answer.reasons,
        absorption_tables=absorption_tables(answer),
        fit_tables=(*fit_tables(answer), *source_tables(answer), *certificate_tables(answer)),
        area_tables=(*area_tables(answer, scene), *share_tables(answer)),
        told=told_in_words(answer),
        error_tables=error_tables(answer),
        overview=overview_table(answer),
        decay=decay,
        curves=curves,
        without_curve=len(answer.pairs) - len(curves),
        pairs=pair_sections(answer),
        provenance=_provenance(answer, scene, campaign),
        inputs=tuple((inputs_sha256 or {}).items()),
        page_data=page_json(_page_data(plots, curves)),
        plotly_js=_packed_plotly_js(),
    )
    return text


def _page_data(plots: list[Any], curves: list[dict[str, Any]]) -> dict[str, Any]:
    return {
        "plots": [{"name": p.name, "height": p.height_px, "alt": p.alt, **p.figure} for p in plots],
        "curves": curves,
    }


def _provenance(answer: Answer, scene: Scene, campaign: str | None) -> tuple[tuple[str, str], ...]:
    mesh, air = scene.room.mesh, scene.air
    return (
        ("roomfit", version("roomfit")),
        ("campaign", campaign or "not told"),
        ("method, model", f"{answer.method}, {answer.model}"),
        ("intervals", answer.interval_kind),
        ("seed", str(answer.seed)),
        ("time", f"{number(answer.seconds, 1)} s"),
        ("evaluations", str(answer.evaluations)),
        ("cost", f"{number(answer.cost, 2)} (half the sum of squared weighted residuals)"),
        ("room", f"V = {area(volume_m3(mesh))} m³, S = {area(surface_area_m2(mesh))} m²"),
        (
            "air",
            f"{number(air.temperature_c, 1)} °C, {number(air.humidity_percent, 0)} % relative "
            f"humidity, {number(air.pressure_kpa, 1)} kPa; attenuation "
            f"{'by ISO 9613-1' if air.attenuation == 'iso9613' else 'none'}",
        ),
        ("speed of sound", f"{number(answer.speed_of_sound_m_s, 2)} m/s"),
    )


def _template() -> Any:
    environment = Environment(
        loader=PackageLoader("roomfit.report.html"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    return environment.get_template("report.html.j2")


def _packed_plotly_js() -> str:
    """Return plotly.js, compressed to 2 of its 5 MB, in base64; a browser unpacks it."""
    from plotly.offline import get_plotlyjs

    packed = gzip.compress(get_plotlyjs().encode("utf-8"), mtime=0)
    return base64.b64encode(packed).decode("ascii")
