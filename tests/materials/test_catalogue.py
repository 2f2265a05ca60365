"""The catalogue: facts with sources, spreads that hold, and the same values in another book."""

from __future__ import annotations

import json
import statistics
import tomllib
from importlib.resources import files

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from roomfit.base.bands import bands_between
from roomfit.materials.catalogue import (
    HIGH_WIDENING,
    LOW_WIDENING,
    OCTAVES_HZ,
    catalogue,
    catalogue_from,
    catalogue_prior,
    common_spread,
    distinct,
    find_material,
    typical_logit,
)
from roomfit.materials.catalogue import table_logit as logit

# Names in the table of Vorlaender, "Auralization" (Springer 2008), as pyroomacoustics spells them.
SAME_MATERIAL = {
    "rough_concrete": "concrete-rough",
    "unpainted_concrete": "concrete-smooth",
    "smooth_brickwork_flush_pointing": "brick-painted",
    "smooth_brickwork_10mm_pointing": "brick-deep-joints",
    "ceramic_tiles": "tile-or-marble",
    "marble_floor": "tile-or-marble",
    "brickwork": "plaster-on-masonry",
    "limestone_wall": "plaster-on-masonry",
    "plasterboard": "plasterboard-double-layer",
    "wooden_lining": "wood-panelling-10-mm",
    "glass_3mm": "glass-3-4-mm",
    "glass_window": "glass-3-4-mm",
    "double_glazing_30mm": "glazing-double",
    "double_glazing_10mm": "glazing-double",
    "plywood_thin": "plywood-thin-with-cavity",
    "wood_16mm": "wood-panelling-20-mm",
    "stage_floor": "wood-floor-on-joists",
    "audience_floor": "wood-floor-on-joists",
    "wooden_door": "door-wood-solid",
    "linoleum_on_concrete": "linoleum-on-concrete",
    "carpet_tufted_9.5mm": "carpet-on-underlay",
    "carpet_thin": "carpet-thin-on-concrete",
    "carpet_6mm_closed_cell_foam": "carpet-tight-backing",
    "carpet_6mm_open_cell_foam": "carpet-on-underlay",
    "carpet_tufted_9m": "carpet-on-underlay",
    "felt_5mm": "carpet-thin-on-concrete",
    "carpet_soft_10mm": "carpet-heavy-on-concrete",
    "carpet_1.35_kg_m2": "carpet-on-underlay",
    "curtains_cotton_0.33": "curtain-slightly-folded",
    "curtains_velvet": "curtain-heavy-flat",
    "chairs_medium_upholstered": "seats-heavy-empty",
    "chairs_heavy_upholstered": "seats-heavy-empty",
    "chairs_upholstered_cloth": "seats-heavy-empty",
    "chairs_upholstered_leather": "seats-leather-empty",
    "audience_orchestra_choir": "audience-upholstered",
    "audience_wooden_chairs_1_m2": "audience-wood-chairs-sparse",
    "audience_wooden_chairs_2_m2": "audience-wood-chairs",
    "orchestra_1.5_m2": "orchestra",
    "acoustical_plaster_25mm": "acoustic-plaster",
    "rockwool_50mm_80kgm3": "mineral-wool-50-mm",
    "rockwool_50mm_40kgm3": "mineral-wool-50-mm",
    "mineral_wool_50mm_40kgm3": "mineral-wool-50-mm",
    "mineral_wool_50mm_70kgm3": "mineral-wool-with-air-space",
    "ceiling_fissured_tile": "ceiling-tile-suspended",
}
# The same table by classes: all of it but blinds and absorbers that hang in the room.
SAME_CLASS = {
    "plaster-or-concrete": (
        "hard_surface brickwork rough_concrete unpainted_concrete rough_lime_wash "
        "brick_wall_rough concrete_floor"
    ),
    "brick": "smooth_brickwork_flush_pointing smooth_brickwork_10mm_pointing",
    "stone-or-tiles": "ceramic_tiles limestone_wall marble_floor",
    "plasterboard": "plasterboard ceiling_plasterboard",
    "wood-on-battens": "wooden_lining wood_1.6cm plywood_thin wood_16mm",
    "glass": (
        "glass_3mm glass_window lead_glazing double_glazing_30mm double_glazing_10mm "
        "double_glazing_inside"
    ),
    "wood-floor": "audience_floor stage_floor",
    "door": "wooden_door",
    "linoleum-or-parquet": "linoleum_on_concrete",
    "carpet-thick": (
        "carpet_cotton carpet_tufted_9.5mm carpet_6mm_open_cell_foam carpet_tufted_9m "
        "carpet_soft_10mm carpet_hairy carpet_1.35_kg_m2 cocos_fibre_roll_29mm"
    ),
    "carpet-thin": "carpet_thin carpet_6mm_closed_cell_foam felt_5mm carpet_rubber_5mm",
    "curtain-heavy": "curtains_cotton_0.5 curtains_velvet curtains_fabric_folded studio_curtains",
    "curtain-light": (
        "curtains_0.2 curtains_cotton_0.33 curtains_densely_woven curtains_fabric "
        "curtains_glass_mat"
    ),
    "seats-wooden": "chairs_wooden chairs_unoccupied_plastic",
    "seats-upholstered": (
        "chairs_medium_upholstered chairs_heavy_upholstered chairs_upholstered_cloth "
        "chairs_upholstered_leather chairs_upholstered_moderate"
    ),
    "people": (
        "audience_orchestra_choir audience_wooden_chairs_1_m2 audience_wooden_chairs_2_m2 "
        "orchestra_1.5_m2 audience_0.72_m2 audience_1_m2 audience_1.5_m2 audience_2_m2 "
        "audience_upholstered_chairs_1 audience_upholstered_chairs_2"
    ),
    "porous-panel-thick": (
        "panel_fabric_covered_6pcf panel_fabric_covered_8pcf rockwool_50mm_80kgm3 "
        "rockwool_50mm_40kgm3 mineral_wool_50mm_40kgm3 mineral_wool_50mm_70kgm3 "
        "ceiling_melamine_foam"
    ),
    "porous-panel-thin": "acoustical_plaster_25mm fibre_absorber_1 fibre_absorber_2",
    "perforated-panel": (
        "gypsum_board perforated_veneered_chipboard ceiling_perforated_gypsum_board "
        "ceiling_metal_panel microperforated_foil_kaefer microperforated_glass_sheets"
    ),
    "suspended-ceiling": "ceiling_fibre_absorber ceiling_fissured_tile",
}


def kinds():
    """Return the entries that are no classes."""
    return [e for e in catalogue().entries if e.name not in catalogue().classes]


def test_every_value_has_a_source_and_every_source_is_used():
    content = catalogue()
    assert len(content.entries) >= 60
    assert len({entry.name for entry in content.entries}) == len(content.entries)
    for entry in content.entries:
        assert entry.readings
        for reading in entry.readings:
            printed = reading.absorption[~np.isnan(reading.absorption)]
            assert len(printed) >= 6
            assert np.all((printed > 0.0) & (printed < 1.3))
            assert len(reading.source) > 20
            assert reading.row
    assert len({r.source for e in content.entries for r in e.readings}) == 13


def test_the_common_spread_is_the_pooled_variance_of_names_with_several_readings():
    pooled, freedom = 0.0, 0
    for entry in kinds():
        rows = distinct(np.array([r.absorption for r in entry.readings]))
        for band in range(1, 7):
            values = [float(v) for v in logit(rows[:, band])]
            if len(values) > 1:
                pooled += (len(values) - 1) * statistics.variance(values)
                freedom += len(values) - 1
    found = common_spread(np.array([r.absorption for r in e.readings]) for e in kinds())
    assert found == pytest.approx((pooled / freedom) ** 0.5, rel=1e-12)


def test_a_single_reading_has_the_common_spread():
    content = {
        "sources": {"a": "a source"},
        "materials": {
            "one": {"group": "g", "what": "w", "readings": [["a", "r", [0.3] * 6]]},
            "two": {
                "group": "g",
                "what": "w",
                "readings": [["a", "r", [0.2] * 6], ["a", "s", [0.5] * 6], ["a", "t", [0.2] * 6]],
            },
        },
    }
    one, two = catalogue_from(content).entries
    # logit 0.5 - logit 0.2 = log 4, two distinct readings: standard deviation log(4) / sqrt(2)
    spread = np.log(4.0) / np.sqrt(2.0)
    np.testing.assert_allclose(one.logit_sd[1:7], spread, rtol=1e-12)
    np.testing.assert_allclose(two.logit_sd[1:7], spread, rtol=1e-12)
    np.testing.assert_allclose(one.absorption, 0.3, rtol=1e-12)
    np.testing.assert_allclose(two.logit_mean[1:7], -np.log(4.0) / 2.0, rtol=1e-12)
    np.testing.assert_allclose(one.logit_sd[0], np.hypot(spread, LOW_WIDENING), rtol=1e-12)
    np.testing.assert_allclose(one.logit_sd[7], np.hypot(spread, HIGH_WIDENING), rtol=1e-12)


@pytest.mark.parametrize(
    ("at_125", "at_250", "step"),
    [(-1.0, -1.4, 0.3), (-1.4, -1.0, -0.3), (-2.0, -0.5, -0.7), (-0.5, -2.0, 0.7)],
)
def test_where_no_table_prints_63_hz_three_quarters_of_the_step_are_made_again(
    at_125, at_250, step
):
    """At most 0.7 either way, in logits; a printed value stands as it is, and so does 8 kHz."""
    logits = np.array([np.nan, at_125, at_250, -1.0, -1.1, -1.2, -1.3, np.nan])
    middle, _ = typical_logit(1.0 / (1.0 + np.exp(-logits[None])), 0.5)
    np.testing.assert_allclose(middle[1:7], logits[1:7], atol=1e-9)
    assert middle[0] == pytest.approx(at_125 + step, abs=1e-9)
    assert middle[7] == pytest.approx(-1.3, abs=1e-9)
    logits[[0, 7]] = -1.7, -0.9
    middle, _ = typical_logit(1.0 / (1.0 + np.exp(-logits[None])), 0.5)
    np.testing.assert_allclose(middle[[0, 7]], [-1.7, -0.9], atol=1e-9)


@pytest.mark.parametrize("common", [0.5, 0.9])
@pytest.mark.parametrize("n", [1, 2, 5])
def test_the_common_spread_weighs_as_four_readings_more(n, common):
    """Readings evenly about logit 0: their squares and 4 c^2, over n - 1 and 4."""
    logits = np.linspace(-0.8, 0.8, n) if n > 1 else np.zeros(1)
    table = np.full((n, 8), np.nan)
    table[:, 1:7] = 1.0 / (1.0 + np.exp(-logits[:, None]))
    _, sd = typical_logit(table, common)
    wanted = (4.0 * common**2 + np.sum(logits**2)) / (4.0 + n - 1.0)
    np.testing.assert_allclose(sd[1:7], np.sqrt(wanted), rtol=1e-12)


@given(
    st.lists(st.lists(st.floats(0.0, 1.2), min_size=6, max_size=6), min_size=1, max_size=6).filter(
        bool
    ),
    st.data(),
)
def test_order_and_reprints_change_nothing(rows, data):
    table = np.full((len(rows), 8), np.nan)
    table[:, 1:7] = rows
    again = data.draw(st.permutations([*range(len(rows)), 0]))
    for got, expected in zip(
        typical_logit(table[again], 0.5), typical_logit(table, 0.5), strict=True
    ):
        # sums of at most seven numbers below 6, in another order
        np.testing.assert_allclose(got, expected, rtol=0, atol=1e-12)


def test_octaves_correlate_in_the_tables_by_powers_of_what_neighbours_do():
    """Off the mean of each class, pooled: one octave apart to five, means over octaves."""
    off = []
    for entry in (find_material(name) for name in catalogue().classes):
        rows = logit(distinct(np.array([r.absorption for r in entry.readings]))[:, 1:7])
        off.append(rows - rows.mean(axis=0))
    found = np.corrcoef(np.concatenate(off).T)
    apart = np.abs(np.subtract.outer(np.arange(6), np.arange(6)))
    one = find_material("carpet").octave_correlation
    mean = [found[apart == d].mean() for d in range(6)]
    np.testing.assert_allclose(mean, one ** np.arange(6), atol=0.06)


def test_a_reading_left_out_lies_where_the_others_said():
    """95 % intervals of an entry hold a further table.

    Readings come in six bands that move together: 948 values, some 300 independent ones, so that
    chance alone moves a share of .95 by .025 (two standard deviations). Nothing is random here:
    the limits only fail when the catalogue or the rule changes.
    """
    tables = [np.array([r.absorption for r in e.readings]) for e in kinds()]
    inside, common = [], common_spread(tables)
    for entry in kinds():
        rows = distinct(np.array([r.absorption for r in entry.readings]))
        for i in range(len(rows) if len(rows) > 2 else 0):
            middle, sd = typical_logit(np.delete(rows, i, axis=0), common)
            inside += list(np.abs(logit(rows[i])[1:7] - middle[1:7]) < 1.96 * sd[1:7])
    assert len(inside) > 600
    assert 0.925 <= np.mean(inside) <= 0.975


def test_a_class_has_all_readings_of_its_kinds_and_the_spread_of_one_more():
    """Squares pooled over both classes, in 2 + 1 degrees of freedom, weigh as four readings."""
    material = {"group": "g", "what": "w"}
    content = {
        "sources": {"a": "a source"},
        "materials": {
            "one": material | {"readings": [["a", "r", [0.2] * 6], ["a", "s", [0.3] * 6]]},
            "two": material | {"readings": [["a", "t", [0.3] * 6], ["a", "u", [0.2] * 6]]},
            "three": material | {"readings": [["a", "t", [0.5] * 6]]},
        },
        "classes": {
            "any": {"what": "x", "of": ["three", "one"]},
            "none": {"what": "", "of": ["two"]},
        },
    }
    found = {e.name: e for e in catalogue_from(content).entries}
    assert [*found][:2] == ["any", "none"] and catalogue_from(content).classes == ("any", "none")
    assert [r.row for r in found["any"].readings] == ["three: t", "one: r", "one: s"]
    logits = np.log([0.5 / 0.5, 0.2 / 0.8, 0.3 / 0.7])
    own = np.sum((logits - logits.mean()) ** 2)
    common = (own + 0.5 * (logits[1] - logits[2]) ** 2) / 3.0
    wanted = (4.0 * common + own) / (4.0 + 2.0) * (1.0 + 1.0 / 3.0)
    np.testing.assert_allclose(found["any"].logit_mean[1:7], logits.mean(), rtol=1e-12)
    np.testing.assert_allclose(found["any"].logit_sd[1:7] ** 2, wanted, rtol=1e-12)


def test_a_table_left_out_lies_where_classes_of_all_others_said():
    """Values of single octaves, the whole of each table of the catalogue left out in turn.

    What another table reprints is not counted. 1,590 values of 265 rows in six bands that move
    together: chance alone moves a share of .95 by .03. Nothing is random here.
    """
    text = files("roomfit.materials").joinpath("catalogue.toml").read_text(encoding="utf-8")
    content, inside = tomllib.loads(text), []
    for source in content["sources"]:
        own = {n: m["readings"] for n, m in content["materials"].items()}
        left = {n: [r for r in rows if r[0] != source] for n, rows in own.items()}
        materials = content["materials"]
        known = {n: materials[n] | {"readings": rows} for n, rows in left.items() if rows}
        classes = {
            n: c | {"of": of}
            for n, c in content["classes"].items()
            if (of := [k for k in c["of"] if k in known])
        }
        learned = catalogue_from(content | {"materials": known, "classes": classes})
        for entry in (e for e in learned.entries if e.name in classes):
            printed = {tuple(r[2][-6:]) for k in classes[entry.name]["of"] for r in left[k]}
            rows = {
                tuple(r[2][-6:])
                for k in content["classes"][entry.name]["of"]
                for r in own[k]
                if r[0] == source
            }
            for row in rows - printed:
                z = (logit(np.array(row)) - entry.logit_mean[1:7]) / entry.logit_sd[1:7]
                inside += list(np.abs(z) < 1.96)
    assert len(inside) > 1500
    assert 0.90 <= np.mean(inside) <= 0.98


def test_the_rules_for_the_ends_miss_by_as_much_as_they_widen():
    """125 Hz predicted from the next two octaves, and 4 kHz from 2 kHz, over all entries."""
    m = np.array([e.logit_mean for e in kinds()])
    low = m[:, 1] - m[:, 2] - np.clip(0.75 * (m[:, 2] - m[:, 3]), -0.7, 0.7)
    high = m[:, 6] - m[:, 5]
    assert np.sqrt(np.mean(low**2)) == pytest.approx(LOW_WIDENING, abs=0.05)
    assert np.sqrt(np.mean(high**2)) == pytest.approx(HIGH_WIDENING, abs=0.05)


def test_another_book_lies_within_the_spread(real_data):
    """Vorlaender's table was not used for the catalogue; it shares ancestors with it, however."""
    table = json.loads((real_data / "tables/pyroomacoustics_materials.json").read_text())
    found = {
        name: material["coeffs"]
        for group in table["absorption"].values()
        for name, material in group.items()
    }
    distances = []
    for theirs, ours in SAME_MATERIAL.items():
        entry = find_material(ours)
        values = logit(np.array(found[theirs]))
        places = slice(1, 1 + len(values))
        distances.append((values - entry.logit_mean[places]) / entry.logit_sd[places])
    every = np.concatenate(distances)
    assert np.mean(np.abs(every) < 1.96) > 0.95
    assert np.std(every) < 1.0
    inside = []
    for name, theirs in SAME_CLASS.items():
        entry = find_material(name)
        for values in (logit(np.array(found[n][:6])) for n in theirs.split()):
            inside += list(np.abs(values - entry.logit_mean[1:7]) < 1.96 * entry.logit_sd[1:7])
    assert len(inside) == 504
    assert 0.90 <= np.mean(inside) <= 0.98
    at_8k = np.array([d[6] for d in distances if len(d) == 7])
    assert np.mean(np.abs(at_8k) < 1.96) > 0.9


def test_between_octaves_an_entry_is_interpolated_in_logit_and_beyond_them_held_and_widened():
    """By the logarithm of frequency; every octave beyond adds its variance."""
    entry = find_material("brick-unglazed")
    bands = bands_between("third-octave", 20, 20_000)
    mean, sd = catalogue_prior("brick-unglazed", bands)
    at, known = np.log2(bands.centres_hz), np.log2(OCTAVES_HZ)
    for band, x in enumerate(at):
        k = int(np.clip(np.searchsorted(known, x) - 1, 0, 6))
        t = float(np.clip((x - known[k]) / (known[k + 1] - known[k]), 0.0, 1.0))
        middle = (1.0 - t) * entry.logit_mean[k] + t * entry.logit_mean[k + 1]
        spread = (1.0 - t) * entry.logit_sd[k] + t * entry.logit_sd[k + 1]
        variance = spread**2 + 0.36 * max(known[0] - x, 0.0) + 0.16 * max(x - known[7], 0.0)
        alpha = 1.0 / (1.0 + np.exp(-middle))
        assert mean[band] == pytest.approx(alpha, rel=1e-9)
        assert sd[band] == pytest.approx(np.sqrt(variance) * alpha * (1.0 - alpha), rel=1e-9)
    assert at[0] < known[0] - 1.0 and at[-1] > known[7] + 1.0
