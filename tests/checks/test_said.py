"""What checks say of numbers that are written down here, and from where on they say it."""

from __future__ import annotations

from roomfit.base.findings import Code
from roomfit.checks import positions
from roomfit.fit.fits import Freed
from seen import of_tests


def test_delays_and_positions_that_were_excluded_are_told_by_what_they_gain():
    """15 units; of fixed positions one more for each unknown, or a tenth of one a window."""
    for gain, n in ((15.1, 1), (14.9, 0)):
        found = list(positions.check_delays(of_tests(freed_delays=Freed(gain, 3, 100))))
        assert len(found) == n
    for freed, n in (
        (Freed(27.1, 12, 100), 1),
        (Freed(26.9, 12, 100), 0),
        (Freed(40.1, 12, 400), 1),
        (Freed(39.9, 12, 400), 0),
    ):
        found = list(positions.check_fixed(of_tests(freed_positions=freed)))
        assert len(found) == n
        if found:
            assert found[0].code is Code.POSITION_INCONSISTENT
            assert found[0].evidence["n_windows"] == freed.n_windows
    assert not list(positions.check_delays(of_tests()))
    assert not list(positions.check_fixed(of_tests()))
    (finding,) = positions.check_inflated(of_tests(position_sd_scale=2.04))
    assert "positions are off 2.0 times as far" in finding.sentence
    assert not list(positions.check_inflated(of_tests(position_sd_scale=1.0)))
