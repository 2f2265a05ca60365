"""The table of what was proven of the lowest cost in each band."""

from __future__ import annotations

from roomfit.report.html.tables import Cell, Row, Table
from roomfit.report.html.wording import hertz, number
from roomfit.uncertainty.answer import Answer, certificate_distance

_STATUS = {"certified": "proven", "stopped": "stopped early", "unresolved": "not resolved"}


def certificate_tables(answer: Answer) -> tuple[Table, ...]:
    """Return one table with a row a band, or none where nothing was to be proven."""
    rows = []
    for band, proof in enumerate(answer.certificates):
        if proof is None:
            continue
        places = [
            ", ".join(
                f"{name} {number(float(value), 2)}"
                for name, value in zip(proof.coordinates, cluster.minimiser, strict=True)
            )
            for cluster in proof.clusters
        ]
        rows.append(
            Row(
                hertz(float(answer.bands.centres_hz[band])),
                (
                    Cell(_STATUS[proof.status]),
                    Cell(number(proof.value, 3)),
                    Cell(number(proof.lower_bound, 3)),
                    Cell(str(len(places)), tuple(places)),
                    Cell(number(certificate_distance(answer, band), 3)),
                ),
            )
        )
    if not rows:
        return ()
    columns = ("status", "lowest cost found", "proven bound", "places", "answer differs by")
    caption = (
        "How low the cost of the energies can be, their weights held, and in how many places "
        "it comes within what other rays would change"
    )
    return (Table(caption, "band", columns, tuple(rows)),)
