"""Damaged and hostile files are read, or refused with an error of piezoid."""

import hashlib
import io
import pickle
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest

from piezoid.digests import unseal
from piezoid.errors import ParameterFileError, PiezoidError, UnreadableFileError
from piezoid.records.inspection import inspect_files
from piezoid.records.readers import read_table
from tests.records.formats import DESCRIBED, UNDESCRIBED
from tests.records.messy.writers import igor, jpk
from tests.records.responses import write_cells

FUZZED: dict[str, Callable[[Path], object]] = {
    **DESCRIBED,
    **UNDESCRIBED,
    "wave.ibw": igor,
    "curve.jpk-force": jpk,
    "response.csv": lambda path: write_cells(path, ",", "{re:.9g}{im:+.9g}i"),
}
MUTATIONS = 25  # for each of 22 formats


def damage(content: bytes, rng: np.random.Generator) -> bytes:
    """Damage a file: change bytes, cut, repeat, insert large numbers."""
    damaged = bytearray(content)
    offset = int(rng.integers(len(damaged)))
    match int(rng.integers(6)):
        case 0:
            for k in rng.integers(len(damaged), size=int(rng.integers(1, 9))):
                damaged[k] = int(rng.integers(256))
        case 1:
            del damaged[offset:]
        case 2:
            del damaged[offset : offset + int(rng.integers(1, 64))]
        case 3:
            damaged[offset:offset] = damaged[: int(rng.integers(1, 200))]
        case 4:
            damaged[offset : offset + 6] = b"1e308,"
        case _:
            # Damage of headers at the beginning changes sizes and offsets.
            for k in rng.integers(min(512, len(damaged)), size=4):
                damaged[k] = int(rng.choice([0, 1, 0x7F, 0xFF]))
    return bytes(damaged)


@pytest.mark.parametrize("name", FUZZED)
def test_a_damaged_file_is_read_or_refused_and_never_crashes(name, tmp_path):
    path = tmp_path / name
    FUZZED[name](path)
    content = path.read_bytes()
    rng = np.random.default_rng(zlib.crc32(name.encode()))
    for _ in range(MUTATIONS):
        path.write_bytes(damage(content, rng))
        for inspection in inspect_files([path]):
            assert inspection.refusal or inspection.sampling_rate_Hz or inspection.response


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"\n\n\n",
        b"\x00" * 100,
        bytes(range(256)) * 20,
        b"time [s],voltage [V]\n",
        b"one line of prose",
        b"\x93NUMPY",
        b"PK\x03\x04",
        b"\x89HDF\r\n\x1a\n",
        b"MATLAB 5.0 MAT-file",
        b"MATLAB 7.3 MAT-file",
        b"PAR1PAR1",
        b"TDSm",
        b"LabVIEW Measurement\t\n",
        b"Experiment\tx\n[DATA]\n",
        b"Experiment\tx\n[DATA]\nBias (V)\tCurrent (A)\n",
        b"X,CH1,Start,Increment,\n",
        b"X,CH1,Start,Increment,\nSequence,Volt,0,0,\n1,2,\n",
        b"# DIM = 2\n# END_HEADER\n",
        b"\x1f\x8b\x08\x00garbage",
        b"\xff\xfe",
    ],
)
@pytest.mark.parametrize("suffix", [".csv", ".mat"])
def test_a_file_without_a_recording_is_unreadable(content, suffix, tmp_path):
    path = tmp_path / f"file{suffix}"
    path.write_bytes(content)
    with pytest.raises(UnreadableFileError):
        read_table(path)


def test_a_missing_file_and_a_folder_are_unreadable(tmp_path):
    for path in (tmp_path / "nothing.csv", tmp_path):
        with pytest.raises(UnreadableFileError):
            read_table(path)


def test_a_wrong_suffix_does_not_matter(write, tmp_path):
    digests = set()
    for name in DESCRIBED:
        disguised = tmp_path / f"{name}.disguised"
        disguised.write_bytes(write(name).read_bytes())
        table = read_table(disguised)
        assert table.rows == 200
        digests.add(table.digest)
    assert len(digests) == len(DESCRIBED)


def test_declared_sizes_beyond_the_file_are_refused(tmp_path):
    buffer = io.BytesIO()
    np.savez_compressed(buffer, voltage_V=np.zeros(10))
    with zipfile.ZipFile(buffer) as archive:
        true_size = archive.infolist()[0].file_size
    declared = (0xFFFFFFF0).to_bytes(4, "little")
    path = tmp_path / "bomb.npz"
    path.write_bytes(buffer.getvalue().replace(true_size.to_bytes(4, "little"), declared))
    with pytest.raises(UnreadableFileError, match="at most"):
        read_table(path)
    header = {"descr": "<f8", "fortran_order": False, "shape": (10**12, 3)}
    path = tmp_path / "large.npy"
    with path.open("wb") as stream:
        np.lib.format.write_array_header_1_0(stream, header)
        stream.write(bytes(240))
    with pytest.raises(UnreadableFileError, match="24000000000000 bytes"):
        read_table(path)


class Trap:
    def __reduce__(self) -> tuple[object, tuple[str]]:
        return (pytest.fail, ("code of a recording was run",))


@pytest.mark.parametrize("name", ["trap.npy", "trap.npz"])
def test_pickled_objects_are_never_run(name, tmp_path):
    path = tmp_path / name
    trap = np.array([Trap()], dtype=object)
    if name.endswith("npz"):
        np.savez(path, voltage_V=trap)
    else:
        np.save(path, trap)
    with pytest.raises(PiezoidError):
        read_table(path)
    assert pickle.dumps(trap)


def test_deeply_nested_groups_are_refused(tmp_path):
    with h5py.File(tmp_path / "deep.h5", "w") as file:
        group = file
        for _ in range(200):
            group = group.create_group("inner")
    with pytest.raises(UnreadableFileError, match="more than 32 deep"):
        read_table(tmp_path / "deep.h5")


@pytest.mark.parametrize("body", ["[" * 100_000 + "]" * 100_000, "9" * 10_000, "9" * 400, "\xff"])
def test_a_sealed_file_without_valid_json_is_refused(body):
    blank = f'{{"schema": "piezoid.model/1", "digest": "sha256:{"0" * 64}", "x": {body}}}'.encode(
        "latin-1"
    )
    digest = hashlib.sha256(blank).hexdigest().encode()
    with pytest.raises(ParameterFileError, match="JSON text in UTF-8"):
        unseal(blank.replace(b"0" * 64, digest, 1), "piezoid.model/1", "model.json")
