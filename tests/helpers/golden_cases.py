"""Small rooms as a user has them: a folder with a campaign and recordings, and the commands to run.

The recordings are made here, by image sources of a box that add as pressures, without any function
of roomfit. `python tests/helpers/golden_cases.py [NAME ...]` writes the kept answers anew.
"""

from __future__ import annotations

import itertools
import json
import sys
import tempfile
from collections.abc import Callable, Mapping
from contextlib import chdir, redirect_stderr, redirect_stdout
from dataclasses import dataclass, field
from io import StringIO
from pathlib import Path

import numpy as np
import soundfile

ANSWERS = Path(__file__).parents[1] / "golden" / "answers"
RATE_HZ = 16_000
SIZE_M = (3.9, 3.1, 2.5)
SOURCE_M = (1.0, 1.2, 1.1)
PLACES_M = {"MP1": (2.9, 2.2, 1.3), "MP2": (3.1, 0.9, 1.6), "MP3": (0.7, 2.5, 1.7)}
ABSORPTION = {"walls": 0.15, "carpet": 0.4, "tiles": 0.3}
Recordings = dict[str, np.ndarray]


def recording(
    place_m: tuple[float, ...], absorption: Mapping[str, float] = ABSORPTION
) -> np.ndarray:
    """Return 0.3 s of pressure in the box with frequency-independent walls, noise at -60 dB."""
    c, n_samples, finer = 343.99, 4800, 8
    walls, carpet, tiles = (1.0 - absorption[k] for k in ("walls", "carpet", "tiles"))
    pressure = np.zeros(n_samples * finer)
    reach = [int(c * n_samples / RATE_HZ / size) + 2 for size in SIZE_M]
    n = np.stack(np.meshgrid(*(np.arange(-k, k + 1) for k in reach), indexing="ij"), axis=-1)
    for p in itertools.product((0, 1), repeat=3):
        images = (1 - 2 * np.array(p)) * SOURCE_M + 2 * n * SIZE_M
        r = np.linalg.norm(images - place_m, axis=-1)
        low, high = np.abs(n - p), np.abs(n)
        energy = walls ** (low + high)[..., :2].sum(axis=-1) * carpet ** low[..., 2]
        energy *= tiles ** high[..., 2]
        at = np.round(r / c * RATE_HZ * finer).astype(int)
        heard = at < pressure.size
        np.add.at(pressure, at[heard], (np.sqrt(energy) / (4.0 * np.pi * r))[heard])
    spectrum = np.fft.rfft(pressure)[: n_samples // 2 + 1]
    sampled = np.fft.irfft(spectrum, n_samples)
    noise = np.random.default_rng(round(1e3 * sum(place_m))).standard_normal(sampled.size)
    return sampled + 1e-3 * np.abs(sampled).max() * noise


@dataclass(frozen=True)
class Case:
    """A folder of inputs and commands; `{folder}` stands for it."""

    text: str
    commands: tuple[str, ...] = ("identify campaign.toml --out a",)
    reads: tuple[str, ...] = ("a/result.json",)
    recorded: Callable[[Recordings], Recordings] = dict
    files: Mapping[str, str] = field(default_factory=dict)

    def run(self, folder: Path, *, words: bool = False) -> dict[str, object]:
        """Write the inputs, run the commands, and return what is kept of their files.

        With `words`, also what the commands print.
        """
        from roomfit.cli import main

        folder.mkdir(parents=True, exist_ok=True)
        (folder / "campaign.toml").write_text(self.text)
        for name, content in self.files.items():
            (folder / name).write_text(content)
        recordings = self.recorded({n: recording(p) for n, p in PLACES_M.items()})
        for name, pressure in recordings.items():
            if f"{name}.wav" in self.text:
                soundfile.write(
                    folder / f"{name}.wav", pressure.astype(np.float32), RATE_HZ, subtype="FLOAT"
                )
        printed = {}
        for command in self.commands:
            with chdir(folder), redirect_stdout(StringIO()) as out, redirect_stderr(out):
                code = main(command.split())
            if code:
                raise RuntimeError(f"{command}: exit code {code}\n{out.getvalue()}")
            printed[command] = out.getvalue()
        found = {name: kept(json.loads((folder / name).read_text())) for name in self.reads}
        return {**found, **printed} if words else found


_LEFT_OUT = """
    provenance settings trace evaluations seconds format format_version plan sentence sentences
    evidence text severity files_sha256 content_sha256 sd_without mean_sd_without posterior
    noise draws reasons costs
"""
LEFT_OUT = frozenset(_LEFT_OUT.split())


def kept(found: object) -> object:
    """Return numbers, names and codes of a file; neither its words nor the details of a run."""
    if isinstance(found, dict):
        return {k: kept(v) for k, v in found.items() if k not in LEFT_OUT}
    if isinstance(found, list):
        return [kept(v) for v in found]
    return float(f"{found:.9g}") if isinstance(found, float) else found


def campaign(
    *,
    places: tuple[str, ...] = tuple(PLACES_M),
    size_m: tuple[float, ...] = SIZE_M,
    known: Mapping[str, str] = {},
    identify: str = "from_hz = 500\nto_hz = 1000",
    measurement: str = "",
    scattering: str = "scattering = 0.0",
    more: str = "",
    places_m: Mapping[str, tuple[float, ...]] = PLACES_M,
) -> str:
    """Return the text of a campaign of the box."""
    lines = ["[room]", f"shoebox = {list(size_m)}", "[room.materials]"]
    lines += ['walls = "walls"', 'floor = "carpet"', 'ceiling = "tiles"']
    for name in ABSORPTION:
        lines += [f"[materials.{name}]", scattering, known.get(name, "")]
    lines += ["[sources.LS1]", f"position = {list(SOURCE_M)}", "position_sd = 0.005"]
    for name in places:
        lines += [
            f"[receivers.{name}]",
            f"position = {list(places_m[name])}",
            "position_sd = 0.005",
        ]
        lines += ["[[measurements]]", 'source = "LS1"', f'receiver = "{name}"']
        lines += [f'file = "{name}.wav"', measurement]
    return "\n".join([*lines, more, "[identify]", identify]) + "\n"


VALUES = """source,receiver,parameter,500,1000
LS1,MP1,EDT,0.33,0.31
LS1,MP1,T20,0.36,0.35
LS1,MP1,C80,10.1,10.6
LS1,MP2,EDT,0.32,0.30
LS1,MP2,T20,0.37,0.34
LS1,MP2,C80,10.6,11.2
"""
BY_VALUES = """[room]
shoebox = [3.9, 3.1, 2.5]
materials = {walls = "walls", floor = "carpet", ceiling = "tiles"}
[sources.LS1]
position = [1.0, 1.2, 1.1]
[receivers.MP1]
position = [2.9, 2.2, 1.3]
[receivers.MP2]
position = [3.1, 0.9, 1.6]
[[measurements]]
parameters = "values.csv"
[identify]
from_hz = 500
to_hz = 1000
"""
COVERED = """
[[states]]
name = "covered"
materials = {floor = "rug"}
[materials.rug]
scattering = 0.0
[objects.people]
prior = {mean = 1.0, sd = 0.5}
states = ["covered"]
[receivers.MP4]
position = [2.2, 1.5, 0.7]
position_sd = 0.005
[[measurements]]
source = "LS1"
receiver = "MP4"
file = "covered.wav"
state = "covered"
"""
DECAY_TIMES = """[room]
shoebox = [8, 6, 3]
[room.materials]
walls = "walls"
floor = "floor"
ceiling = "ceiling"
[materials.ceiling]
absorption = 0.1
[reverberation]
file = "t30.csv"
formula = "Fitzroy"
"""
TREATMENT = """probability = 0.7
[surfaces.CEILING]
free_m2 = 9
[products.panel]
absorption = 0.9
sd = 0.02
piece_m2 = 0.6
cost_per_m2 = 60
[products.foil]
absorption = 0.5
piece_m2 = 1.0
cost_per_m2 = 30
[[targets]]
at_most = LIMIT
bands_hz = [1000]
"""
ENERGY = 'from_hz = 500\nto_hz = 1000\nmodel = "energy"'
IDENTIFY = "identify campaign.toml --out a"
PREDICT = "predict campaign.toml --absorption a/result.json --out p"


def only(
    name: str, change: Callable[[np.ndarray], np.ndarray]
) -> Callable[[Recordings], Recordings]:
    """Return the recordings of which one is changed."""
    return lambda r: {**r, name: change(r[name])}


def each(change: Callable[[np.ndarray], np.ndarray]) -> Callable[[Recordings], Recordings]:
    """Return the recordings, all of them changed."""
    return lambda r: {name: change(x) for name, x in r.items()}


def late(n: int) -> Callable[[np.ndarray], np.ndarray]:
    """Return a recording that begins n samples later."""
    return lambda x: np.concatenate([np.zeros(n), x[:-n]])


CASES: dict[str, Case] = {
    "pressures": Case(
        campaign(), (IDENTIFY, PREDICT + " --set carpet=0.2"), ("a/result.json", "p/predicted.json")
    ),
    "energies": Case(
        campaign(identify=ENERGY),
        (
            IDENTIFY,
            PREDICT + " --set carpet=0.2+-0.05",
            "treat campaign.toml treatment.toml --absorption a/result.json --out t",
            "design campaign.toml --candidates 40 --choose 1 --result a/result.json --out d",
        ),
        ("a/result.json", "p/predicted.json", "t/treatment.json", "d/design.json"),
        files={"treatment.toml": TREATMENT.replace("CEILING", "tiles").replace("LIMIT", "0.25")},
    ),
    "quick": Case(campaign(), ("identify campaign.toml --quick --out a",)),
    "scattering-unspecified": Case(
        campaign(scattering="", identify=ENERGY + '\npositions = "fixed"')
    ),
    "known-and-priors": Case(
        campaign(
            identify=ENERGY,
            known={"tiles": "prior = {mean = 0.3, sd = 0.1}", "carpet": "absorption = 0.4"},
        )
    ),
    "validated": Case(
        campaign(identify=ENERGY).replace('file = "MP3.wav"', 'file = "MP3.wav"\nuse = "validate"')
    ),
    "unknown-time": Case(
        campaign(identify=ENERGY, measurement='time_zero = "direct"\nlevel = "per-file"')
    ),
    "simplex": Case(
        campaign(
            identify='from_hz = 1000\nto_hz = 1000\nmethod = "simplex"',
            known={"walls": "absorption = 0.15"},
        )
    ),
    "directed-source": Case(
        campaign(identify=ENERGY).replace(
            "[sources.LS1]", "[sources.LS1]\ndirectivity = {aim = [1, 0, 0], b = 0.1}"
        )
    ),
    "states": Case(
        campaign(identify=ENERGY, more=COVERED),
        (IDENTIFY, PREDICT + " --state covered --doubted"),
        ("a/result.json", "p/predicted.json"),
        lambda r: {**r, "covered": recording((2.2, 1.5, 0.7), {**ABSORPTION, "carpet": 0.7})},
    ),
    "values": Case(BY_VALUES, files={"values.csv": VALUES}),
    "decay-times": Case(
        DECAY_TIMES,
        (
            "reverberation campaign.toml --out r",
            "predict campaign.toml --set ceiling=0.5+-0.05 --out p",
            "treat campaign.toml treatment.toml --out t",
        ),
        ("r/result.json", "p/predicted.json", "t/treatment.json"),
        files={
            "t30.csv": "place,500,1000\nfront,1.12,1.08\nback,1.08,1.12\n",
            "treatment.toml": TREATMENT.replace("CEILING", "ceiling").replace("LIMIT", "0.8"),
        },
    ),
    "fault-late": Case(campaign(identify=ENERGY), recorded=each(late(48))),
    "fault-exchanged": Case(
        campaign(identify=ENERGY), recorded=lambda r: {**r, "MP1": r["MP2"], "MP2": r["MP1"]}
    ),
    "fault-copy": Case(campaign(identify=ENERGY), recorded=lambda r: {**r, "MP2": r["MP1"]}),
    "fault-moved": Case(campaign(places_m={**PLACES_M, "MP1": (2.5, 2.2, 1.3)})),
    "fault-louder": Case(campaign(identify=ENERGY), recorded=only("MP2", lambda x: 3.0 * x)),
    "fault-polarity": Case(campaign(identify=ENERGY), recorded=only("MP2", np.negative)),
    "fault-clipped": Case(
        campaign(identify=ENERGY),
        recorded=each(lambda x: np.clip(x, -0.3 * np.abs(x).max(), 0.3 * np.abs(x).max())),
    ),
    "fault-longer-room": Case(campaign(size_m=(4.3, 3.1, 2.5), identify=ENERGY)),
}


def main() -> None:
    """Write the kept answers of all cases, or of those that are named."""
    for name in sys.argv[1:] or CASES:
        with tempfile.TemporaryDirectory() as folder:
            found = CASES[name].run(Path(folder) / name)
        text = json.dumps(found, separators=(",", ":"))
        (ANSWERS / f"{name}.json").write_text(text + "\n", encoding="utf-8")
        print(name, len(text))


if __name__ == "__main__":
    main()
