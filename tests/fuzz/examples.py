"""Small valid files of every format that is read, from which the fuzzer makes damaged ones."""

from __future__ import annotations

import io
import json
import tempfile
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import soundfile

from box_files import (
    POINTS,
    QUADS,
    TRIANGLES,
    corners,
    obj,
    planes,
    ply,
    stl,
)
from scans import scan_json

RATE_HZ = 8000


def decay(n: int = 600) -> np.ndarray:
    """Return a short response with an onset."""
    rng = np.random.default_rng(1)
    response = rng.standard_normal(n) * np.exp(-np.arange(n) / 100.0)
    response[:40] = 0.0
    response[40] = 8.0
    return response / 10.0


def stl_text() -> bytes:
    lines = ["solid hall"]
    for triangle in TRIANGLES:
        lines += ["facet normal 0 0 1", "outer loop"]
        lines += [f"vertex {x} {y} {z}" for x, y, z in (POINTS[k] for k in triangle)]
        lines += ["endloop", "endfacet"]
    return "\n".join([*lines, "endsolid hall", ""]).encode()


def glb() -> bytes:
    import trimesh

    scene = trimesh.Scene(trimesh.creation.box((5, 4, 3)))
    scene.add_geometry(trimesh.creation.box((1, 1, 1)), node_name="pillar")
    return bytes(scene.export(file_type="glb"))


def geo() -> bytes:
    lines = [
        "GLOBAL w = 5",
        "LOCAL half = w/2",
        "OFFSETCO 100",
        "ABS plaster = <10 10 10 10 10 10>",
    ]
    lines += ["ABS wood = plaster", "CORNERS"]
    lines += [f"{i + 1} {'w' if x else 0} {y} {z}" for i, (x, y, z) in enumerate(POINTS)]
    lines += ["9 half 0 0", "10 half 4 lock(1 2 3)", "loop(20, i, 0, 3, 1, sin(i), i, x(1)+2)"]
    lines += [
        "PLANES",
        "[1 floor / 1 2 4 3 / (left / 1 9 10 3 / plaster) (right / 9 2 4 10 / wood)]",
    ]
    quads = (*QUADS[:4], QUADS[5])
    for number, quad in enumerate(quads, start=2):
        lines.append(f"[{number} wall / {' '.join(str(c + 1) for c in quad[::-1])} / plaster]")
    return "\r\n".join(lines).encode()


def dxf(binary: bool) -> bytes:
    import ezdxf

    document = ezdxf.new("R2010", units=6)
    block = document.blocks.new("WALLS")
    for quad in QUADS[:4]:
        block.add_3dface([POINTS[c] for c in quad])
    model = document.modelspace()
    model.add_blockref("WALLS", (0, 0, 0))
    model.add_polyline3d([POINTS[c] for c in QUADS[4]], close=True)
    model.add_lwpolyline([(0, 0), (5, 0), (5, 4), (0, 4)], close=True, dxfattribs={"elevation": 3})
    with model.add_mesh().edit_data() as mesh:
        mesh.vertices, mesh.faces = [(1, 1, 1), (2, 1, 1), (2, 2, 1)], [(0, 1, 2)]
    stream: io.IOBase = io.BytesIO() if binary else io.StringIO()
    document.write(stream, fmt="bin" if binary else "asc")
    content = stream.getvalue()  # type: ignore[attr-defined]
    return content if binary else content.encode()


def wav(subtype: str, channels: int = 1, kind: str = "WAV") -> bytes:
    stream = io.BytesIO()
    samples = np.tile(decay()[:, None], (1, channels))
    soundfile.write(stream, samples, RATE_HZ, format=kind, subtype=subtype)
    return stream.getvalue()


def npy() -> bytes:
    stream = io.BytesIO()
    np.save(stream, decay())
    return stream.getvalue()


def mat(compressed: bool) -> bytes:
    from scipy.io import savemat

    stream = io.BytesIO()
    table = {"RIR": np.stack([decay(), decay()], axis=1), "Fs": float(RATE_HZ), "note": "a room"}
    savemat(stream, table, do_compression=compressed)
    return stream.getvalue()


def ita() -> bytes:
    from scipy.io import savemat

    stream = io.BytesIO()
    columns = np.stack([decay(), decay()], axis=1)
    fields = {"comment": "hall", "domain": "time", "data": columns, "dataFactor": 1.0}
    fields |= {"channelNames": np.array(["a", "b"], dtype=object), "userData": {"x": 1.0}}
    content = {**fields, "samplingRate": float(RATE_HZ)}
    savemat(stream, {"ITA_TOOLBOX_AUDIO_OBJECT": content}, do_compression=True)
    return stream.getvalue()


def _hdf5(fill: Callable[[object], None], **options: object) -> bytes:
    import h5py

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "a.h5"
        with h5py.File(path, "w", **options) as file:
            fill(file)
        return path.read_bytes()


def mat73() -> bytes:
    def fill(file):
        samples = np.stack([decay(), decay()])
        response = file.create_dataset("RIR", data=samples, compression="gzip", chunks=(1, 300))
        response.attrs["MATLAB_class"] = np.bytes_("double")
        rate = file.create_dataset("Fs", data=[[float(RATE_HZ)]])
        rate.attrs["MATLAB_class"] = np.bytes_("double")

    head = b"MATLAB 7.3 MAT-file, made for a test".ljust(124) + b"\0\2IM"
    return head.ljust(512, b"\0") + _hdf5(fill, userblock_size=512)[512:]


def sofa(n_receivers: int = 2) -> bytes:
    def fill(file):
        import h5py

        file.attrs["SOFAConventions"], file.attrs["DataType"] = "GeneralFIR", "FIR"
        names = {"M": 1, "R": n_receivers, "N": 600, "I": 1, "C": 3}
        for name, length in names.items():
            file.create_dataset(name, data=np.arange(float(length))).make_scale(name)
        data = file.create_dataset("Data.IR", data=np.tile(decay(), (1, n_receivers, 1)))
        for axis, name in enumerate("MRN"):
            data.dims[axis].attach_scale(file[name])
        file.create_dataset("Data.SamplingRate", data=[float(RATE_HZ)])
        file.create_dataset("Data.Delay", data=np.zeros((1, n_receivers)))
        angles = np.stack(
            [
                np.linspace(0, 330, n_receivers),
                60 * np.sin(np.arange(n_receivers)),
                n_receivers * [1],
            ]
        ).T
        positions = file.create_dataset("ReceiverPosition", data=angles[:, :, None])
        positions.attrs["Type"] = "spherical"
        positions.attrs["Units"] = "degree, degree, metre"
        file.create_dataset("note", data="text", dtype=h5py.string_dtype())

    return _hdf5(fill)


def rew() -> bytes:
    samples = decay()
    lines = ["* Impulse Response data saved by REW V5.20", "* IR is not normalised"]
    lines += [f"{samples.max():.6g} // Peak value before normalisation", "40 // Peak index"]
    lines += [
        f"{len(samples)} // Response length",
        f"{1 / RATE_HZ:.9g} // Sample interval (seconds)",
    ]
    lines += ["-0.005 // Start time (seconds)", "* Data start", *(f"{v:.6g}" for v in samples)]
    return "\n".join(lines).encode()


def npz() -> bytes:
    stream = io.BytesIO()
    f = np.arange(100.0, 140.0, 2.0)
    np.savez_compressed(stream, f=f, tau=0.1, p=np.exp(1j * f), noise=1e-3)
    return stream.getvalue()


def parameters() -> bytes:
    return b"source,receiver,parameter,500,1000\nS,R,T30,0.9,0.8\nS,R,C80,3.1,4\nS,R,T30_sd,.1,.1\n"


def result() -> bytes:
    one = {"absorption": [0.3, 0.4], "lower95": [0.2, 0.3], "upper95": [0.4, 0.5]}
    one |= {"identifiable": [True, False], "scattering": [0.1, 0.1]}
    content = {
        "format": "roomfit-result",
        "format_version": 1,
        "bands_hz": [500.0, 1000.0],
        "materials": {"carpet": one, "plaster": one},
        "posterior": {
            "logit_covariance": [[[0.1, 0.0], [0.0, 0.1]]] * 2,
            "prior_logit_mean": [[-1.0, -1.0]] * 2,
            "prior_logit_sd": [[1.0, 1.0]] * 2,
            "prior_specified": [True, False],
            "draws": [[[0.3, 0.4], [0.3, 0.4]]] * 3,
        },
        "directivity": {"S": {"b": [[0.1, 0.0, 0.0]] * 2, "sd": [[0.1] * 3] * 2}},
        "fit": {"phi": [1.0, 1.0]},
    }
    return json.dumps(content).encode()


def absorption() -> bytes:
    head = "material,band_hz,absorption,lower95,upper95,identifiable"
    rows = [f"{m},{f},0.3,0.25,0.36,true" for m in ("carpet", "plaster") for f in (500, 1000)]
    return "\n".join([head, *rows, ""]).encode()


def campaign() -> bytes:
    return b"""format_version = 1
[room]
shoebox = [5, 4, 3]
[room.materials]
walls = "plaster"
floor = "carpet"
[materials.carpet]
prior = { mean = 0.3, sd = 0.2 }
scattering = { centres_hz = [500, 1000], values = [0.1, 0.2] }
bounds = [0.01, 0.99]
[air]
temperature_c = 20
[sources.S]
position = [1.0, 1.2, 1.1]
position_sd = 0.01
directivity = { aim = [1, 0, 0], b = 0.5, b_sd = 0.1 }
[receivers.R]
position = [2.9, 2.2, 1.3]
[[measurements]]
source = "S"
receiver = "R"
file = "response.wav"
latency_s = 0.001
[[measurements]]
parameters = "parameters.csv"
[identify]
from_hz = 500
to_hz = 1000
[settings]
n_rays = 2000
[impedance]
tau_s = 0.1
[design]
"""


@cache
def examples() -> dict[str, bytes]:
    """Return one valid file of every format by its name."""
    return {
        "box.obj": obj(),
        "text.ply": ply("ascii"),
        "little.ply": ply("binary_little_endian"),
        "big.ply": ply("binary_big_endian"),
        "box.stl": stl(),
        "text.stl": stl_text(),
        "box.glb": glb(),
        "box.geo": geo(),
        "scan.json": scan_json(),
        "text.dxf": dxf(binary=False),
        "binary.dxf": dxf(binary=True),
        "corners.csv": corners(),
        "planes.csv": planes(),
        "response.wav": wav("FLOAT"),
        "pcm.wav": wav("PCM_24", 2),
        "response.flac": wav("PCM_24", kind="FLAC"),
        "response.aiff": wav("PCM_24", kind="AIFF"),
        "response.w64": wav("FLOAT", kind="W64"),
        "response.npy": npy(),
        "packed.mat": mat(compressed=True),
        "plain.mat": mat(compressed=False),
        "audio.ita": ita(),
        "v73.mat": mat73(),
        "response.sofa": sofa(),
        "directivity.sofa": sofa(24),
        "rew.txt": rew(),
        "spectrum.npz": npz(),
        "parameters.csv": parameters(),
        "result.json": result(),
        "absorption.csv": absorption(),
        "campaign.toml": campaign(),
    }
