"""Readers of measured responses: good files exactly, bad ones with one clear message."""

from __future__ import annotations

import struct
from pathlib import Path

import h5py
import numpy as np
import pytest
import scipy.io
import scipy.sparse
import soundfile
from scipy.signal import hilbert

from roomfit.base.errors import InputError
from roomfit.base.findings import Code
from roomfit.files.responses import read_response
from roomfit.files.responses.sofa import read_sofa_variables
from roomfit.files.schema import ResponseSpec
from roomfit.formats.hdf5 import mat_variables

RATE_HZ = 8000


def decay(n: int = 4000, seed: int = 1) -> np.ndarray:
    """A noisy decay between -0.9 and 0.9 without anything doubtful about it."""
    rng = np.random.default_rng(seed)
    samples = rng.standard_normal(n) * np.exp(-np.arange(n) / 500.0)
    return 0.9 * samples / np.abs(samples).max()


def write_wav(path: Path, samples: np.ndarray, subtype: str = "FLOAT") -> Path:
    soundfile.write(path, samples, RATE_HZ, subtype=subtype)
    return path


def left(pressure: np.ndarray) -> np.ndarray:
    """Schroeder's curve, 1 at its beginning."""
    return np.cumsum(pressure[::-1] ** 2)[::-1] / np.sum(pressure**2)


def codes(findings) -> list[str]:
    return [finding.code for finding in findings]


@pytest.mark.parametrize(
    ("subtype", "step"),
    [
        ("PCM_16", 2.0**-15),
        ("PCM_24", 2.0**-23),
        ("PCM_32", 2.0**-31),
        ("FLOAT", 2.0**-24),
        ("DOUBLE", 2.0**-53),
    ],
)
def test_every_encoding_returns_its_samples_to_the_last_bit_it_has(tmp_path, subtype, step):
    samples = decay()
    path = write_wav(tmp_path / "a.wav", samples, subtype)
    response, findings = read_response(ResponseSpec(path))
    np.testing.assert_allclose(response.pressure, samples, rtol=0, atol=step)
    assert response.sampling_rate_hz == RATE_HZ
    assert findings == ()


SOUNDS = [("flac", "PCM_24"), ("aiff", "PCM_32"), ("aiff", "FLOAT"), ("w64", "FLOAT")]


@pytest.mark.parametrize(("ending", "subtype"), SOUNDS)
def test_flac_aiff_and_wave64_return_the_samples_of_the_same_wav(tmp_path, ending, subtype):
    both = np.stack([decay(), decay(seed=2)], axis=1)
    read = []
    for name in ("a.wav", f"a.{ending}"):
        soundfile.write(tmp_path / name, both, RATE_HZ, subtype=subtype)
        response, findings = read_response(ResponseSpec(tmp_path / name, channel=1))
        assert (response.sampling_rate_hz, findings) == (RATE_HZ, ())
        read.append(response.pressure)
    np.testing.assert_allclose(*read, rtol=0.0, atol=2.0**-23)  # as their writers round
    with pytest.raises(InputError, match="several channels"):
        read_response(ResponseSpec(tmp_path / f"a.{ending}"))


@pytest.mark.parametrize(("ending", "subtype"), SOUNDS)
@pytest.mark.parametrize("share", [0.01, 0.4, 0.9, 0.999])
def test_a_sound_file_that_was_cut_off_is_refused(tmp_path, ending, subtype, share):
    path = tmp_path / f"a.{ending}"
    soundfile.write(path, decay(), RATE_HZ, subtype=subtype)
    content = path.read_bytes()
    path.write_bytes(content[: int(share * len(content))])
    with pytest.raises(InputError, match=r"cut off|not a FLAC"):
        read_response(ResponseSpec(path))


@pytest.mark.parametrize("kind", ["f4", "f8", "i2", ">f4"])
def test_a_column_of_an_npy_file_is_a_response(tmp_path, kind):
    both = (1000 * np.stack([decay(), decay(seed=2)], axis=1)).astype(kind)
    path = tmp_path / "a.npy"
    np.save(path, both)
    response, _ = read_response(ResponseSpec(path, channel=1, sampling_rate_hz=RATE_HZ))
    # but for a constant offset, which is subtracted where it is large
    np.testing.assert_allclose(np.diff(response.pressure), np.diff(both[:, 1].astype(float)), 1e-9)
    np.save(path, both[:, 0])
    alone, _ = read_response(ResponseSpec(path, sampling_rate_hz=RATE_HZ))
    assert alone.pressure.shape == (4000,)


def test_an_npy_file_of_objects_is_never_unpickled(tmp_path):
    path = tmp_path / "a.npy"
    np.save(path, np.array([{}], dtype=object), allow_pickle=True)
    with pytest.raises(InputError, match="not an NPY file"):
        read_response(ResponseSpec(path, sampling_rate_hz=RATE_HZ))


def test_latency_is_the_time_of_emission_on_the_files_clock(tmp_path):
    path = write_wav(tmp_path / "a.wav", decay())
    response, _ = read_response(ResponseSpec(path, latency_s=0.0228))
    assert response.time_zero_s == 0.0228


def test_a_file_of_several_channels_needs_one_to_be_chosen(tmp_path):
    samples = np.stack([decay(seed=1), decay(seed=2)], axis=1)
    path = write_wav(tmp_path / "two.wav", samples)
    response, _ = read_response(ResponseSpec(path, channel=1))
    np.testing.assert_array_equal(response.pressure, samples[:, 1].astype(np.float32))
    with pytest.raises(InputError, match="several channels") as caught:
        read_response(ResponseSpec(path))
    assert "2 channels, 0 to 1" in str(caught.value)
    with pytest.raises(InputError, match="no such channel"):
        read_response(ResponseSpec(path, channel=2))


def test_a_truncated_wav_is_refused_though_other_readers_take_it(tmp_path):
    path = write_wav(tmp_path / "a.wav", decay(), "PCM_16")
    cut = tmp_path / "cut.wav"
    cut.write_bytes(path.read_bytes()[:-1000])
    assert len(soundfile.read(cut)[0]) == 3500  # passes there without a word
    with pytest.raises(InputError, match="cut off") as caught:
        read_response(ResponseSpec(cut))
    assert "8000, by its own header" in str(caught.value)


def test_a_streamed_wav_without_lengths_is_read_to_its_end_with_a_finding(tmp_path):
    length = 0xFFFFFFFF
    content = bytearray(write_wav(tmp_path / "a.wav", decay(), "PCM_16").read_bytes())
    at = content.index(b"data") + 4
    content[at : at + 4] = struct.pack("<I", length)
    content[4:8] = struct.pack("<I", length)
    streamed = tmp_path / "streamed.wav"
    streamed.write_bytes(bytes(content))
    response, findings = read_response(ResponseSpec(streamed))
    np.testing.assert_allclose(response.pressure, decay(), atol=2.0**-15)
    assert codes(findings) == [Code.WAV_LENGTH_UNKNOWN]


@pytest.mark.parametrize("name", [b"RF64", b"BW64"])
def test_a_wav_of_more_than_four_gigabytes_form_is_read_and_checked(tmp_path, name):
    """RF64 keeps its lengths in a chunk of its own; BW64 of ITU-R BS.2088 is the same by name."""
    path = tmp_path / "a.wav"
    with soundfile.SoundFile(path, "w", RATE_HZ, 1, "PCM_24", format="RF64") as file:
        file.write(decay())
    assert path.read_bytes()[:4] == b"RF64"
    path.write_bytes(name + path.read_bytes()[4:])
    response, findings = read_response(ResponseSpec(path))
    np.testing.assert_allclose(response.pressure, decay(), atol=2.0**-23)
    assert findings == ()
    path.write_bytes(path.read_bytes()[:-600])
    with pytest.raises(InputError, match="cut off"):
        read_response(ResponseSpec(path))


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (lambda p: p * 0.0, "silent"),
        (lambda p: p * 0.0 + 0.25, "silent"),
        (lambda p: np.where(np.arange(len(p)) == 17, np.nan, p), "the first at sample 17"),
        (lambda p: np.where(np.arange(len(p)) >= 3999, np.inf, p), "1 of 4000"),
        (lambda p: p * 1e30, "no pressure has"),
        (lambda p: p[:70], "too short"),
        (lambda p: p[:0], "too short|no samples|not a WAV"),
        (lambda p: p**2, "does not swing"),
        (lambda p: np.abs(hilbert(p)), "does not swing"),
        (left, "does not swing"),
        (lambda p: 10.0 * np.log10(left(p) + 1e-9), "does not swing"),
        (lambda p: 60.0 + 20.0 * np.log10(np.abs(hilbert(p))), "does not swing"),
        (lambda p: 20.0 * np.log10(np.abs(p) + 1e-9), "does not swing"),
    ],
)
def test_a_file_that_holds_no_response_is_refused(tmp_path, spoil, words):
    path = write_wav(tmp_path / "bad.wav", spoil(decay()))
    with pytest.raises(InputError, match=words):
        read_response(ResponseSpec(path))


def test_clipping_is_found_and_a_normalised_peak_is_not_taken_for_it(tmp_path):
    loud = np.clip(30.0 * np.convolve(decay(), np.ones(8) / 8, "same"), -1.0, 1.0)
    _, findings = read_response(ResponseSpec(write_wav(tmp_path / "loud.wav", loud, "PCM_16")))
    assert codes(findings) == [Code.RESPONSE_CLIPPED]
    assert findings[0].severity == "serious"
    peak = decay() / np.abs(decay()).max()
    _, findings = read_response(ResponseSpec(write_wav(tmp_path / "peak.wav", peak)))
    assert findings == ()


def test_a_constant_offset_is_reported_and_subtracted(tmp_path):
    path = write_wav(tmp_path / "offset.wav", 0.5 * decay() + 0.01)
    response, findings = read_response(ResponseSpec(path))
    np.testing.assert_allclose(response.pressure, 0.5 * decay(), atol=1e-4)
    assert codes(findings) == [Code.DC_OFFSET]
    assert findings[0].evidence["offset"] == pytest.approx(0.01, rel=1e-2)
    # so large that no sample is negative, which energy has in common
    whole = read_response(ResponseSpec(write_wav(tmp_path / "high.wav", 0.5 * decay() + 3.0)))[0]
    np.testing.assert_allclose(whole.pressure, 0.5 * decay(), atol=1e-4)


def test_an_encoding_that_loses_the_decay_is_refused(tmp_path):
    path = write_wav(tmp_path / "coarse.wav", decay(), "ULAW")
    with pytest.raises(InputError, match="encoding") as caught:
        read_response(ResponseSpec(path))
    assert "ULAW" in str(caught.value)


def test_a_key_that_the_file_cannot_obey_is_refused(tmp_path):
    path = write_wav(tmp_path / "a.wav", decay())
    with pytest.raises(InputError, match="does not belong"):
        read_response(ResponseSpec(path, variable="RIR"))
    with pytest.raises(InputError, match="two sampling rates"):
        read_response(ResponseSpec(path, sampling_rate_hz=44_100.0))
    assert read_response(ResponseSpec(path, sampling_rate_hz=8000.0))[0].sampling_rate_hz == 8000.0


def write_mat(path: Path, **table) -> Path:
    scipy.io.savemat(path, table)
    return path


def test_a_column_of_a_mat_file_is_a_response(tmp_path):
    columns = np.stack([decay(seed=1), decay(seed=2), decay(seed=3)], axis=1)
    path = write_mat(tmp_path / "a.mat", RIR=columns, Fs=np.uint16(48_000))
    spec = ResponseSpec(path, variable="RIR", channel=2, sampling_rate_variable="Fs")
    response, findings = read_response(spec)
    np.testing.assert_array_equal(response.pressure, columns[:, 2])
    assert response.sampling_rate_hz == 48_000.0
    assert findings == ()


def test_a_single_response_may_stand_in_a_row_of_a_mat_file(tmp_path):
    path = write_mat(tmp_path / "a.mat", ir=decay()[None, :])
    response, _ = read_response(ResponseSpec(path, variable="ir", sampling_rate_hz=44_100.0))
    np.testing.assert_array_equal(response.pressure, decay())


def test_what_a_mat_file_leaves_open_is_asked_for_by_name(tmp_path):
    path = write_mat(tmp_path / "a.mat", RIR=np.stack([decay(), decay()], 1), Fs=48_000, note="hi")
    with pytest.raises(InputError, match=r"which variable.*\n.*\n.*\n.*RIR \(4000, 2\)"):
        read_response(ResponseSpec(path, sampling_rate_hz=48_000.0))
    with pytest.raises(InputError, match="did you mean 'RIR'"):
        read_response(ResponseSpec(path, variable="RIRs", sampling_rate_hz=48_000.0))
    with pytest.raises(InputError, match="several responses"):
        read_response(ResponseSpec(path, variable="RIR", sampling_rate_hz=48_000.0))
    with pytest.raises(InputError, match="single numbers in the file: Fs"):
        read_response(ResponseSpec(path, variable="RIR", channel=0))
    with pytest.raises(InputError, match="no such variable"):
        read_response(ResponseSpec(path, variable="RIR", channel=0, sampling_rate_variable="nota"))
    with pytest.raises(InputError, match="holds no array"):
        read_response(ResponseSpec(path, variable="note", channel=0, sampling_rate_hz=48_000.0))


def test_responses_in_rows_of_a_mat_file_are_not_taken_for_columns(tmp_path):
    path = write_mat(tmp_path / "a.mat", RIR=np.stack([decay(), decay()]))
    with pytest.raises(InputError, match="stand in rows"):
        read_response(ResponseSpec(path, variable="RIR", channel=0, sampling_rate_hz=48_000.0))


def test_an_array_of_sources_receivers_and_samples_is_refused_with_how_to_save_it(tmp_path):
    """And so saved its columns are the responses, those of the last axis but one in turn."""
    each = np.stack([decay() * (1.0 + k) for k in range(6)]).reshape(2, 3, -1)
    np.save(tmp_path / "a.npy", each)
    spec = ResponseSpec(tmp_path / "a.npy", channel=4, sampling_rate_hz=8000.0)
    mat = write_mat(tmp_path / "a.mat", RIR=each)
    for own in (spec, ResponseSpec(mat, variable="RIR", channel=4, sampling_rate_hz=8000.0)):
        with pytest.raises(
            InputError, match=r"have 3 axes(.*\n)*.*a\.reshape\(-1, a\.shape\[-1\]\)"
        ):
            read_response(own)
    np.save(tmp_path / "a.npy", each.reshape(-1, each.shape[-1]).T)
    np.testing.assert_array_equal(read_response(spec)[0].pressure, each[1, 1])


def write_mat73(path: Path, compression: str | None = None) -> np.ndarray:
    """Write what MATLAB writes with -v7.3: axes reversed, a class by each variable, a header."""
    columns = np.stack([decay(seed=1), decay(seed=2)], axis=1)
    phasors = np.zeros((1, 1), dtype=[("real", "f8"), ("imag", "f8")])
    table = {
        "RIR": (columns, "double"),
        "short": (np.round(1000.0 * columns).astype("i2"), "int16"),
        "row": (decay(seed=3)[None, :].astype("f4"), "single"),
        "Fs": (np.array([[48_000.0]]), "double"),
        "note": (np.array([[104, 105]], dtype="u2"), "char"),
        "phasors": (phasors, "double"),
    }
    with h5py.File(path, "w", userblock_size=512) as file:
        for name, (values, kind) in table.items():
            stored = file.create_dataset(name, data=values.T, compression=compression)
            stored.attrs["MATLAB_class"] = np.bytes_(kind)
        empty = file.create_dataset("empty", data=np.array([0, 3], dtype="u8"))
        empty.attrs["MATLAB_class"], empty.attrs["MATLAB_empty"] = np.bytes_("double"), np.uint8(1)
        cells = file.create_dataset("cells", (1, 1), dtype=h5py.ref_dtype)
        cells[0, 0] = file.create_group("#refs#").ref
        cells.attrs["MATLAB_class"] = np.bytes_("cell")
        record = file.create_group("room")
        record.attrs["MATLAB_class"] = np.bytes_("struct")
        record["h"] = columns.T
        sparse = file.create_group("sparse")
        sparse.attrs["MATLAB_class"], sparse.attrs["MATLAB_sparse"] = np.bytes_("double"), 3
        file["elsewhere"] = h5py.ExternalLink("other.mat", "/RIR")
    with path.open("r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM")
    return columns


@pytest.mark.parametrize("compression", [None, "gzip"])
def test_a_column_of_a_mat_file_of_version_7_3_is_a_response(tmp_path, compression):
    path = tmp_path / "new.mat"
    columns = write_mat73(path, compression)
    spec = ResponseSpec(path, variable="RIR", channel=1, sampling_rate_variable="Fs")
    response, findings = read_response(spec)
    np.testing.assert_array_equal(response.pressure, columns[:, 1])
    assert (response.sampling_rate_hz, findings) == (48_000.0, ())
    row, _ = read_response(ResponseSpec(path, variable="row", sampling_rate_hz=48_000.0))
    np.testing.assert_array_equal(row.pressure, decay(seed=3).astype("f4"))
    whole, _ = read_response(
        ResponseSpec(path, variable="short", channel=0, sampling_rate_hz=48_000.0)
    )
    np.testing.assert_array_equal(whole.pressure, np.round(1000.0 * columns[:, 0]))


def test_what_a_mat_file_of_version_7_3_holds_besides_numbers_is_refused_by_its_kind(tmp_path):
    path = tmp_path / "new.mat"
    write_mat73(path)
    kinds = {
        "note": "text",
        "phasors": "complex numbers",
        "empty": r"\(0, 0\)",
        "cells": r"a cell array.*as a variable of its own",
        "room": r"a structure.*as a variable of its own",
        "sparse": "a sparse array",
    }
    for name, kind in kinds.items():
        with pytest.raises(InputError, match=f"(?s)holds no array.*{kind}"):
            read_response(ResponseSpec(path, variable=name, channel=0, sampling_rate_hz=8000.0))
    for name in ("#refs#", "elsewhere"):
        with pytest.raises(InputError, match="no such variable") as caught:
            read_response(ResponseSpec(path, variable=name, channel=0, sampling_rate_hz=8000.0))
        assert f"{name} (" not in str(caught.value)


def test_a_file_that_matlab_itself_wrote_as_hdf5_is_read():
    """MATLAB 7.4's, of scipy's own tests: a row of nine doubles from 0 to 2 pi, too short."""
    path = Path(scipy.io.__file__).parent / "matlab/tests/data/testhdf5_7.4_GLNX86.mat"
    if not path.exists():
        pytest.skip("scipy came without its tests")
    found = mat_variables(path.read_bytes())
    np.testing.assert_allclose(found["testdouble"], [np.linspace(0.0, 2.0 * np.pi, 9)], rtol=1e-15)


def write_sofa(path: Path, responses: np.ndarray, delay: float = 0.0) -> Path:
    sofar = pytest.importorskip("sofar")
    sofa = sofar.Sofa("GeneralFIR")
    sofa.Data_IR = responses
    sofa.Data_SamplingRate = 48_000
    sofa.Data_Delay = np.full((1, responses.shape[1]), delay)
    sofa.ReceiverPosition = np.zeros((responses.shape[1], 3))
    sofa.SourcePosition = np.ones((responses.shape[0], 3))
    sofar.write_sofa(str(path), sofa)
    return path


def test_measurement_and_receiver_of_a_sofa_file_are_chosen(tmp_path):
    responses = np.stack([[decay(seed=i), decay(seed=10 + i)] for i in range(3)])
    path = write_sofa(tmp_path / "a.sofa", responses)
    response, findings = read_response(ResponseSpec(path, measurement=2, receiver_index=1))
    np.testing.assert_array_equal(response.pressure, responses[2, 1])
    assert response.sampling_rate_hz == 48_000.0
    assert findings == ()
    with pytest.raises(InputError, match="several measurements"):
        read_response(ResponseSpec(path, receiver_index=1))
    with pytest.raises(InputError, match="no such receiver"):
        read_response(ResponseSpec(path, measurement=0, receiver_index=2))


def test_the_delay_that_a_sofa_file_tells_comes_before_its_first_sample(tmp_path):
    """480 samples of delay at 48 kHz: sample 0 lies 10 ms after emission."""
    path = write_sofa(tmp_path / "a.sofa", decay()[None, None, :], delay=480.0)
    response, _ = read_response(ResponseSpec(path))
    assert response.time_zero_s == pytest.approx(-0.01)


def test_every_measurement_of_a_sofa_file_has_its_own_delay(tmp_path):
    """One receiver, three measurements: 0, 48 and 96 samples at 48 kHz."""
    sofar = pytest.importorskip("sofar")
    sofa = sofar.Sofa("SingleRoomSRIR")
    sofa.Data_IR = np.stack([decay(seed=i) for i in range(3)])[:, None, :]
    sofa.Data_SamplingRate, sofa.Data_Delay = 48_000, np.array([[0.0], [48.0], [96.0]])
    sofa.SourcePosition = sofa.ListenerPosition = np.ones((3, 3))
    sofa.MeasurementDate = np.zeros(3)
    path = tmp_path / "a.sofa"
    sofar.write_sofa(str(path), sofa)
    for i in range(3):
        response, _ = read_response(ResponseSpec(path, measurement=i))
        np.testing.assert_array_equal(response.pressure, decay(seed=i))
        assert response.time_zero_s == pytest.approx(-0.001 * i, abs=1e-15)


@pytest.mark.parametrize("convention", ["GeneralFIR", "SimpleFreeFieldHRIR"])
def test_a_sofa_file_is_read_as_sofar_reads_it(tmp_path, convention):
    """Every array of numbers, the texts beside the positions, and the type of data."""
    sofar = pytest.importorskip("sofar")
    sofa = sofar.Sofa(convention)
    sofa.Data_IR = np.stack([[decay(seed=i), decay(seed=10 + i)] for i in range(3)])
    sofa.Data_SamplingRate, sofa.Data_Delay = 44_100, np.array([[3.0, 4.0]])
    sofa.ReceiverPosition = np.arange(6.0).reshape(2, 3)
    sofa.SourcePosition = np.arange(9.0).reshape(3, 3)
    path = tmp_path / "a.sofa"
    sofar.write_sofa(str(path), sofa)
    theirs = sofar.read_sofa(str(path), verify=False, verbose=False)
    ours, data_type = read_sofa_variables(path.read_bytes())
    assert data_type == theirs.GLOBAL_DataType == "FIR"
    names = ["Data.IR", "Data.SamplingRate", "Data.Delay", "ReceiverPosition", "SourcePosition"]
    for name in [*names, "ListenerPosition", "EmitterPosition"]:
        values = np.squeeze(getattr(theirs, name.replace(".", "_")))
        np.testing.assert_array_equal(np.squeeze(ours[name].values), values)
    for name in ("SourcePosition", "ReceiverPosition"):
        beside = ours[name].attributes
        assert beside["Type"] == getattr(theirs, f"{name}_Type")
        assert beside["Units"] == getattr(theirs, f"{name}_Units")


@pytest.mark.parametrize("order", ["MRNE", "MREN"])
def test_the_one_emitter_of_a_sofa_file_may_stand_before_the_samples(tmp_path, order):
    """Written by netCDF4: the dimensions' names tell which axis is which; two are refused."""
    netcdf = pytest.importorskip("netCDF4")
    for n_emitters in (1, 2):
        path = tmp_path / f"{n_emitters}.sofa"
        lengths = {"M": 2, "R": 3, "N": 400, "E": n_emitters, "I": 1}
        with netcdf.Dataset(path, "w", format="NETCDF4") as file:
            file.Conventions, file.SOFAConventions, file.DataType = "SOFA", "GeneralFIR-E", "FIR-E"
            for axis, length in lengths.items():
                file.createDimension(axis, length)
            values = np.random.default_rng(1).standard_normal((2, 3, 400, n_emitters))
            axes = ["MRNE".index(axis) for axis in order]
            file.createVariable("Data.IR", "f8", tuple(order))[:] = values.transpose(axes)
            file.createVariable("Data.SamplingRate", "f8", ("I",))[:] = 8000.0
            delay = file.createVariable("Data.Delay", "f8", ("M", "R", "E"))
            delay[:] = np.arange(6.0 * n_emitters).reshape(2, 3, n_emitters)
        spec = ResponseSpec(path, measurement=1, receiver_index=2)
        if n_emitters == 1:
            response, _ = read_response(spec)
            np.testing.assert_array_equal(response.pressure, values[1, 2, :, 0])
            assert response.time_zero_s == pytest.approx(-5.0 / 8000.0)
        else:
            with pytest.raises(InputError, match="several emitters"):
                read_response(spec)


def test_what_is_no_sofa_file_is_refused_for_what_it_is(tmp_path):
    path = tmp_path / "a.sofa"
    for content, found in ((b"CDF\x01" + bytes(99), "netCDF-3"), (b"anything", "OSError")):
        path.write_bytes(content)
        with pytest.raises(InputError, match=f"not a SOFA file that can be read(?s:.*){found}"):
            read_response(ResponseSpec(path))
    with h5py.File(path, "w") as file:
        file["Data.IR"] = np.zeros((1, 1, 400))
    with pytest.raises(InputError, match="without the attribute SOFAConventions"):
        read_response(ResponseSpec(path))
    with h5py.File(path, "a") as file:
        file.attrs["SOFAConventions"] = "SimpleFreeFieldHRTF"  # a str, not bytes
        file.attrs["DataType"] = np.bytes_("TF")
        file["SourcePosition"] = ["not", "numbers"]
    with pytest.raises(InputError, match=r"no impulse responses(?s:.*)data type 'TF'"):
        read_response(ResponseSpec(path))
    with h5py.File(path, "a") as file:
        file["Data.IR"].attrs["scale_factor"] = 0.5
    with pytest.raises(InputError, match="packed numbers"):
        read_response(ResponseSpec(path))


def test_a_sofa_file_whose_numbers_lie_in_another_file_is_refused(tmp_path):
    """It would read any file of the machine as numbers."""
    path, other = tmp_path / "a.sofa", tmp_path / "other.bin"
    other.write_bytes(decay().tobytes())
    with h5py.File(path, "w") as file:
        file.attrs["SOFAConventions"] = "GeneralFIR"
        file.create_dataset("Data.IR", (1, 1, 4000), "f8", external=[(str(other), 0, 32_000)])
        file["Data.SamplingRate"] = [8000.0]
    with pytest.raises(InputError, match="lie in other files"):
        read_response(ResponseSpec(path))


def test_a_sofa_file_that_claims_more_numbers_than_memory_is_refused(tmp_path):
    path = tmp_path / "a.sofa"
    with h5py.File(path, "w") as file:
        file.attrs["SOFAConventions"] = "GeneralFIR"
        file.create_dataset("Data.IR", (10**6, 10**3, 10**6), "f8", chunks=(1, 1, 10**3))
    with pytest.raises(InputError, match="bytes of numbers"):
        read_response(ResponseSpec(path))


def test_the_limit_that_a_refusal_of_many_numbers_names_lets_the_file_in(tmp_path, monkeypatch):
    path = tmp_path / "a.sofa"
    response = np.exp(-np.arange(48_000) / 4000.0) * np.random.default_rng(0).normal(size=48_000)
    with h5py.File(path, "w") as file:
        file.attrs["SOFAConventions"] = "GeneralFIR"
        shape, chunks = (200, 1, 48_000), (1, 1, 48_000)
        data = file.create_dataset("Data.IR", shape, "f8", chunks=chunks, compression="gzip")
        data[0, 0, :4800] = response[:4800].round(2)
        file["Data.SamplingRate"] = [48_000.0]
    spec = ResponseSpec(path, measurement=0)
    with pytest.raises(InputError, match='ROOMFIT_LIMITS="unpacked_times=NUMBER"'):
        read_response(spec)
    monkeypatch.setenv("ROOMFIT_LIMITS", "unpacked_times=100000")
    assert len(read_response(spec)[0].pressure) == 48_000
