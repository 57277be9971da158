"""Files that no robot is made of, by the hundred, for all readers; as a program it reads them, and says how it went."""

import json
import re
import struct
import tempfile
import time
import zlib
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from scipy.io import savemat

from jaxgrity import InputError, load_scene, save_scene
from jaxgrity.formats import read_any, read_ntrt, save_matlab, save_mjcf, save_tables

DATA = Path(__file__).parents[1] / "data" / "ntrt"
ENGINE = Path(__file__).parents[1] / "data" / "engine" / "prism.json"
WORDS = ("nan", "inf", "-1", "1e999", "x", "[]", "{}", "99999999999999999999", "", "true", '"', "\x00", "0", "1e-320")
"""in place of a number"""
BOMBS = 27


def good_files(folder: Path) -> dict[str, list[Path]]:
    """What the bad ones are made of, by their endings: a robot in every kind of file."""
    scene = load_scene("reference")
    save_scene(scene, folder / "a.toml")
    save_mjcf(scene, folder / "a.xml")
    save_matlab(scene, folder / "a.mat")
    save_tables(scene, folder / "a.csv")
    (folder / "a.yaml").write_text((DATA / "prism.yaml").read_text())
    (folder / "vertebra.yaml").write_text((DATA / "vertebra.yaml").read_text())
    (folder / "prism.yaml").write_text((DATA / "prism.yaml").read_text())
    (folder / "b.yaml").write_text((DATA / "spine.yaml").read_text())
    (folder / "c.yaml").write_text((DATA / "docked.yaml").read_text())
    (folder / "a.json").write_text(ENGINE.read_text())
    return {
        ".toml": [folder / "a.toml"],
        ".yaml": [folder / "a.yaml", folder / "b.yaml", folder / "c.yaml"],
        ".xml": [folder / "a.xml"],
        ".mat": [folder / "a.mat"],
        ".csv": [folder / "a.nodes.csv", folder / "a.members.csv"],
        ".json": [folder / "a.json"],
    }


def spoilt(data: bytes, random: np.random.Generator) -> bytes:
    """The same with one thing wrong: cut off, noise in it, a number or a name replaced, a line lost or there twice."""
    lines, words = data.split(b"\n"), data.split()
    at, row = int(random.integers(1, len(data))), int(random.integers(len(lines)))
    word = words[int(random.integers(len(words)))]
    other = WORDS[int(random.integers(len(WORDS)))].encode()
    ways = (
        lambda: data[:at],
        lambda: data[:at] + random.bytes(8) + data[at + 8 :],
        lambda: b"\n".join(lines[:row] + lines[row + 1 :]),
        lambda: b"\n".join([*lines[: row + 1], lines[row], *lines[row + 1 :]]),
        lambda: data.replace(word, b"", 1),
        lambda: data.replace(word, other, 1),
        lambda: data.replace(b"0", other, int(random.integers(1, 4))),
    )
    return ways[int(random.integers(len(ways)))]()


def bombs(folder: Path) -> Iterator[Path]:
    """Files that are small, and grow where one does not look: nesting, circles, counts, packed zeros."""
    deep = 100_000
    texts = {
        "deep.yaml": "[" * deep + "]" * deep,
        "deeper.yaml": "".join(f"{' ' * k}a:\n" for k in range(2000)),
        "laughs.yaml": "a: &a [x]\n" + "".join(f"{b}: &{b} [*{a}, *{a}]\n" for a, b in zip("abcdefgh", "bcdefghi")),
        "circle.yaml": "substructures: {a: {path: circle2.yaml}}",
        "circle2.yaml": "substructures: {a: {path: circle.yaml}}",
        "wide.yaml": "nodes:\n" + "".join(f"  n{k}: [0, 0, {k}]\n" for k in range(15_000)),
        "deep.xml": "<mujoco>" + "<body>" * deep + "</body>" * deep + "</mujoco>",
        "laughs.xml": '<!DOCTYPE l [<!ENTITY a "xxxx"><!ENTITY b "&a;&a;">]><mujoco>&b;</mujoco>',
        "memory.xml": '<mujoco><size memory="900G"/></mujoco>',
        "copies.xml": '<mujoco><worldbody><replicate count="99999999"><body/></replicate></worldbody></mujoco>',
        "composite.xml": '<mujoco><worldbody><composite type="cable" count="99999999 1 1"/></worldbody></mujoco>',
        "deep.json": '{"tensegrity_cfg": ' * deep + "1" + "}" * deep,
        "list.json": "[" * deep + "]" * deep,
        "digits.json": '{"tensegrity_cfg": ' + "9" * 5000 + "}",
        "deep.toml": "a = " + "[" * deep + "]" * deep,
        "keys.toml": ".".join("a" * 20_000) + " = 1",
        "grid.toml": '[structure]\nkind = "grid"\nrows = 10000\ncolumns = 10000\nmass = 1\n',
        "tower.toml": '[structure]\nkind = "tower"\nstruts = 10000\nstages = 10000\nmass = 1\n',
        "prism.toml": '[structure]\nkind = "prism"\nstruts = 999999999\nmass = 1\n',
        "waves.toml": '[structure]\nkind = "prism"\nmass = 1\n[ground]\nstiffness = 1\n'
        'surface = { kind = "bumps", deviation = 1, length = 1, waves = 999999999 }\n',
        "steps.toml": '[structure]\nkind = "prism"\nmass = 1\n[ground]\nstiffness = 1\n'
        'surface = { kind = "stairs", rise = 1, run = 1, steps = 999999999 }\n',
        "long.nodes.csv": "x_m,y_m,z_m\n" + "0,0,0\n" * 100_000,
        "cell.nodes.csv": "x_m,y_m,z_m\n" + "9" * 500_000 + ",0,0\n",
        "empty.nodes.csv": "",
        "large.toml": "#" * 5_000_000,
    }
    for name, text in texts.items():
        (folder / name).write_text(text)
    (folder / "long.members.csv").write_text("kind,first,second,rest_length_m\n")
    savemat(folder / "zeros.mat", {})
    (folder / "zeros.mat").write_bytes((folder / "zeros.mat").read_bytes()[:128] + packed_zeros(300))
    (folder / "hdf5.mat").write_bytes(b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM" + bytes(500))
    yield from (folder / name for name in (*texts, "zeros.mat", "hdf5.mat"))


def packed_zeros(megabytes: int) -> bytes:
    """A compressed variable of a MATLAB file that unpacks to so many megabytes."""
    packer = zlib.compressobj()
    packed = b"".join(packer.compress(bytes(1_000_000)) for _ in range(megabytes)) + packer.flush()
    return struct.pack("<II", 15, len(packed)) + packed


def damaged(folder: Path, ending: str, count: int) -> Iterator[Path]:
    """A robot's files of one kind with one thing wrong each; each is there until the next one is asked for."""
    random, sources = np.random.default_rng(0), good_files(folder)[ending]
    originals = {path: path.read_bytes() for path in sources}
    for number in range(count):
        source = sources[number % len(sources)]
        for other in sources:
            (folder / other.name.replace("a.", "bad.")).write_bytes(originals[other])
        path = folder / source.name.replace("a.", "bad.")
        path.write_bytes(spoilt(originals[source], random))
        yield path


def outcome(path: Path) -> dict:
    """What reading a file comes to: refused, read, or what must not be, and the processor seconds that it takes."""
    began, said = time.process_time(), ""
    try:
        if path.suffix == ".yaml":
            read_ntrt(path, drop=["radius"])
        else:
            read_any(path)
        kind = "read"
    except InputError as error:
        said = str(error)
        kind = "refused" if said.isprintable() and len(said.replace(str(path), path.name)) < 600 else "unclear"
    except Exception as error:
        kind, said = "broken", f"{type(error).__name__}: {error}"
    return {"file": path.name, "kind": kind, "said": said, "seconds": time.process_time() - began}


def main() -> None:
    """Print the outcomes of all bombs as JSON, with what the reading took of memory, bytes."""
    with tempfile.TemporaryDirectory() as name:
        found = [outcome(path) for path in bombs(Path(name))]
    # of this program alone: what getrusage calls the largest may be that of the process that started this one
    status = Path("/proc/self/status").read_text(encoding="ascii")
    peak = 1024 * int(re.search(r"VmHWM:\s+(\d+) kB", status)[1])
    print(json.dumps({"outcomes": found, "peak": peak}))


if __name__ == "__main__":
    main()
