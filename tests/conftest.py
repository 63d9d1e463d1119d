"""Fixtures shared by every folder: a seeded generator, and other people's recordings."""

import os
from pathlib import Path

# As the command line does, before numpy is loaded: small matrices, one thread, the same bits.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
import pytest

REALDATA = Path(__file__).resolve().parents[2] / "shared" / "realdata"


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(20150401)


@pytest.fixture
def realdata() -> Path:
    if not REALDATA.is_dir():
        pytest.skip("recordings made by other people are not on this machine (shared/realdata)")
    return REALDATA
