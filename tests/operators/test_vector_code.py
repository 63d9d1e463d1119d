"""The loops written for AVX2 against the portable ones: the same bits, whatever comes in."""

import ctypes
from pathlib import Path

import numpy as np
import pytest

import piezoid.operators
from piezoid.numerics.arrays import Array
from piezoid.operators.dead_zone import DeadZones
from piezoid.operators.library import KERNELS, address
from tests.runtime.compiler import found, run

SOURCE = Path(piezoid.operators.__file__).parent
TRIALS = 400
STRANGE = np.array([0.0, -0.0, np.inf, -np.inf, np.nan, 5e-324, -1e308])
Outputs = list[Array]


@pytest.fixture(scope="module")
def portable(tmp_path_factory: pytest.TempPathFactory) -> ctypes.CDLL:
    """The same sources with nothing but plain loops."""
    place = tmp_path_factory.mktemp("portable") / "kernels.so"
    flags = ("-std=c99", "-O3", "-ffp-contract=off", "-DPK_PORTABLE", "-shared", "-fPIC")
    sources = map(str, sorted(SOURCE.glob("*.c")))
    run(found("gcc", "cc"), *flags, *sources, "-o", str(place), "-lm")
    library = ctypes.CDLL(str(place))
    for name in ("pk_play_columns", "pk_play_sum", "pk_mapped_plays", "pk_polynomials"):
        getattr(library, name).argtypes = getattr(KERNELS, name).argtypes
        getattr(library, name).restype = None
    return library


def drive(rng: np.random.Generator) -> Array:
    """A walk on a grid, so that plays meet their thresholds, of any length around a stretch."""
    samples = int(
        rng.choice([rng.integers(0, 40), rng.integers(120, 140), rng.integers(1000, 1100)])
    )
    walk = np.cumsum(rng.integers(-8, 9, samples)) / 16.0
    if rng.random() < 0.5:
        walk += rng.normal(size=samples)
    strange = rng.random(samples) < rng.choice([0.0, 0.0, 0.05])
    strange[-1:] = rng.random() < 0.1  # what ends in the memory
    walk[strange] = rng.choice(STRANGE, strange.sum())
    return walk


def bank(rng: np.random.Generator) -> tuple[Array, Array, Array]:
    """Thresholds, weights and memory of none to 40 plays; the first often has threshold 0."""
    plays = int(rng.integers(0, 41))
    threshold = np.sort(rng.integers(0, 200, plays)) / 16.0
    if plays and rng.random() < 0.5:
        threshold[0] = 0.0
    return threshold, rng.normal(size=plays), rng.integers(-50, 50, plays) / 16.0


def columns(library: ctypes.CDLL, seed: int) -> Outputs:
    rng = np.random.default_rng(seed)
    u, (threshold, _, state) = drive(rng), bank(rng)
    made = np.zeros((len(u) + 3, len(state)), order="F")
    library.pk_play_columns(
        *(len(u), address(u), len(state), address(threshold), address(state)),
        *(len(made), address(made)),
    )
    return [made, state]


def summed(library: ctypes.CDLL, seed: int) -> Outputs:
    rng = np.random.default_rng(seed)
    u, (threshold, weight, state) = drive(rng), bank(rng)
    made = np.empty_like(u)
    library.pk_play_sum(
        *(len(u), address(u), len(state), address(threshold), address(weight)),
        *(address(state), address(made)),
    )
    return [made, state]


def mapped(library: ctypes.CDLL, seed: int) -> Outputs:
    rng = np.random.default_rng(seed)
    u, (threshold, weight, state) = drive(rng), bank(rng)
    zones = DeadZones(threshold=np.arange(-3.0, 4.0), weight=rng.uniform(0.5, 1.0, 7))
    before, after = zones.kernel_map(), zones.inverse().kernel_map()
    made = np.empty_like(u)
    library.pk_mapped_plays(
        *(len(u), address(u), 0.25, ctypes.addressof(before)),
        *(len(state), address(threshold), address(weight), address(state)),
        *(ctypes.addressof(after), 0.125, address(made)),
    )
    return [made, state]


def polynomials(library: ctypes.CDLL, seed: int) -> Outputs:
    rng = np.random.default_rng(seed)
    u, width = drive(rng), int(rng.integers(0, 20))
    states = np.asfortranarray(rng.normal(size=(len(u), width)))
    made = np.zeros_like(u)
    scale, power, bias = (
        rng.normal(size=width),
        rng.normal(size=4 * width),
        rng.normal(size=3 * width),
    )
    library.pk_polynomials(
        *(len(u), address(u), width, len(u), address(states)),
        *(address(scale), address(power), address(bias), address(made)),
    )
    return [made]


@pytest.mark.parametrize("kernel", [columns, summed, mapped, polynomials])
def test_vector_code_gives_the_bits_of_plain_loops(kernel, portable: ctypes.CDLL) -> None:
    for seed in range(TRIALS):
        for wide, plain in zip(kernel(KERNELS, seed), kernel(portable, seed), strict=True):
            assert wide.tobytes() == plain.tobytes(), f"seed {seed}"


def test_the_portable_library_has_no_vector_code(portable: ctypes.CDLL) -> None:
    assert not hasattr(portable, "pk_play_columns_avx2")
