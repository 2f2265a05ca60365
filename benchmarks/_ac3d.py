"""The room of BRAS CR2, which is published as AC3D, as OBJ."""

from __future__ import annotations

import tempfile
from pathlib import Path


def as_obj(path: Path) -> Path:
    """Return an OBJ file of the surfaces of an AC3D file without transforms, in a new folder."""
    materials, out, n_before, n_after = list[str](), list[str](), 0, 0
    lines = iter(path.read_text(encoding="latin-1").splitlines())
    for words in (line.split() for line in lines):
        match words:
            case ["MATERIAL", name, *_]:
                materials.append(name.strip('"'))
            case ["name", name]:
                out.append("o " + name.strip('"'))
            case ["loc" | "rot", *_]:
                raise ValueError(f"{path} has transforms")
            case ["numvert", count]:
                n_before, n_after = n_after, n_after + int(count)
                out += [f"v {next(lines)}" for _ in range(int(count))]
            case ["mat", number]:
                out.append(f"usemtl {materials[int(number)]}")
            case ["refs", count]:
                corners = [1 + n_before + int(next(lines).split()[0]) for _ in range(int(count))]
                out.append("f " + " ".join(map(str, corners)))
    file = Path(tempfile.mkdtemp()) / f"{path.stem}.obj"
    file.write_text("\n".join(out), encoding="utf-8")
    return file
