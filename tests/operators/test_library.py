"""Library of kernels: lifetime of its arrays, and equal bits of vector and plain code."""

import ctypes
import weakref
from pathlib import Path

import numpy as np

import piezoid.operators
from piezoid.operators.library import KERNELS, address
from tests.runtime.compiler import require_tool, run

SOURCE = Path(piezoid.operators.__file__).parent


def polynomials(library: ctypes.CDLL, seed: int) -> bytes:
    rng = np.random.default_rng(seed)
    samples, width = int(rng.integers(0, 1100)), int(rng.integers(0, 20))
    drive, states = rng.normal(size=samples), rng.normal(size=(width, samples))
    scale, power, bias = (rng.normal(size=(rows, width)) for rows in (1, 4, 3))
    total = np.zeros(samples)
    library.pk_polynomials(
        *(samples, address(drive), width, samples, address(states), address(scale)),
        *(address(power), address(bias), address(total)),
    )
    return total.tobytes()


def test_vector_code_gives_the_bits_of_plain_loops(tmp_path):
    flags = ("-std=c99", "-O3", "-ffp-contract=off", "-DPK_PORTABLE", "-shared", "-fPIC")
    sources = map(str, sorted(SOURCE.glob("*.c")))
    run(require_tool("gcc", "cc"), *flags, *sources, "-o", str(tmp_path / "kernels.so"), "-lm")
    portable = ctypes.CDLL(str(tmp_path / "kernels.so"))
    portable.pk_polynomials.argtypes = KERNELS.pk_polynomials.argtypes
    for seed in range(60):
        assert polynomials(KERNELS, seed) == polynomials(portable, seed), f"seed {seed}"


def test_a_copy_made_for_a_kernel_lives_until_the_kernel_returns():
    copy = np.array([1.0, 2.0])
    reference = weakref.ref(copy)
    pointer = address(copy)
    del copy
    assert reference() is not None
    del pointer
    assert reference() is None
