"""Audio objects of the ITA-Toolbox, and what structures and objects of MAT files hold."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import scipy.io

from roomfit.base.errors import InputError
from roomfit.files.responses import read_response
from roomfit.files.schema import ResponseSpec
from roomfit.formats.hdf5 import mat_variables

DATA = Path(scipy.io.__file__).parent / "matlab/tests/data"


def decay(n: int = 2000, seed: int = 1) -> np.ndarray:
    return np.random.default_rng(seed).standard_normal(n) * np.exp(-np.arange(n) / 300.0)


def audio(columns: np.ndarray, **changes: object) -> dict[str, object]:
    """Return what `itaAudio.saveobj` puts into a structure, as far as scipy can write it."""
    entries = {"classname": "itaAudio", "classrevision": np.nan, "comment": "hall"}
    entries |= {"history": np.array(["ita_read"], dtype=object), "userData": np.zeros((0, 0))}
    entries |= {"domain": "time", "data": columns, "dimensions": float(columns.shape[1])}
    entries |= {"channelNames": np.array(["a", "b"], dtype=object), "dataType": "double"}
    entries |= {"dataFactor": 1.0, "samplingRate": 44_100.0, "signalType": "energy"}
    return {k: v for k, v in (entries | changes).items() if v is not None}


def write_ita(path: Path, content: object, *, compressed: bool = True) -> Path:
    with path.open("wb") as stream:
        scipy.io.savemat(stream, {"ITA_TOOLBOX_AUDIO_OBJECT": content}, do_compression=compressed)
    return path


@pytest.mark.parametrize("compressed", [False, True])
def test_a_channel_of_an_audio_object_is_a_response(tmp_path, compressed):
    columns = np.stack([decay(seed=1), decay(seed=2)], axis=1)
    path = write_ita(tmp_path / "a.ita", audio(columns), compressed=compressed)
    response, findings = read_response(ResponseSpec(path, channel=1))
    np.testing.assert_array_equal(response.pressure, columns[:, 1])
    assert (response.sampling_rate_hz, findings) == (44_100.0, ())
    with pytest.raises(InputError, match="several channels"):
        read_response(ResponseSpec(path))


def test_samples_that_were_stored_as_integers_get_their_scale_back(tmp_path):
    """`dataFactor` is that of the class: 1 where the samples are doubles, and may be missing."""
    columns = np.round(3000.0 * decay()[:, None]).astype("i2")
    path = write_ita(tmp_path / "a.ita", audio(columns, dataFactor=1e-4))
    response, _ = read_response(ResponseSpec(path))
    np.testing.assert_allclose(response.pressure, 1e-4 * columns[:, 0], rtol=1e-12)
    path = write_ita(tmp_path / "b.ita", audio(columns, dataFactor=None))
    np.testing.assert_array_equal(read_response(ResponseSpec(path))[0].pressure, columns[:, 0])


@pytest.mark.parametrize(
    ("content", "found"),
    [
        (audio(decay()[:, None], domain="freq"), "freq"),
        (audio(decay()[:, None] + 1j), "complex numbers"),
        (audio(decay()[:, None], samplingRate=None), "dataFactor"),
        (np.array([audio(decay()[:, None]), audio(decay()[:, None])]), "a cell array"),
        (1.0, r"\(1, 1\)"),
    ],
)
def test_what_is_no_single_response_in_time_is_refused_with_what_to_export(
    tmp_path, content, found
):
    path = write_ita(tmp_path / "a.ita", content)
    with pytest.raises(InputError, match=f"audio object(?s:.*){found}(?s:.*)a.timeData") as refused:
        read_response(ResponseSpec(path))
    text = str(refused.value)
    assert all(part in text for part in ("a.ita", "found", "needed", "try"))


def test_fields_of_a_structure_that_matlab_itself_wrote_are_read():
    """MATLAB 7.4's, of scipy's own tests."""
    path = DATA / "teststruct_7.4_GLNX86.mat"
    if not path.exists():
        pytest.skip("scipy came without its tests")
    found = mat_variables(path.read_bytes())
    expected = [[np.sqrt(2.0), np.exp(1.0), np.pi]]
    np.testing.assert_allclose(found["teststruct.doublefield"], expected, rtol=1e-15)
    assert found["teststruct.stringfield"] == "text 'Rats live on no evil star.'"
    assert found["teststruct.complexfield"] == "complex numbers"


def test_a_field_of_a_structure_is_a_variable_of_a_campaign(tmp_path):
    path = tmp_path / "a.mat"
    scipy.io.savemat(path, {"take": {"h": decay()[:, None], "fs": 48_000.0}})
    spec = ResponseSpec(path, variable="take.h", sampling_rate_variable="take.fs")
    response, _ = read_response(spec)
    np.testing.assert_array_equal(response.pressure, decay())
