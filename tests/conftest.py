"""Shared by every folder: a seeded generator, other people's recordings, how laws are tried."""

import os
import time
from collections.abc import Iterator
from pathlib import Path

# As the command line does, before numpy is loaded: small matrices, one thread, the same bits.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
import pytest
from hypothesis import HealthCheck, settings

from tests.plays_alone import design_briefly, fit_few_rows, fit_one_order, fit_plays_alone

# Laws are tried on the same examples in every run, however slow the machine, and nothing is kept.
settings.register_profile(
    "same_every_run",
    derandomize=True,
    deadline=None,
    database=None,
    max_examples=60,
    suppress_health_check=[HealthCheck.too_slow],
)
settings.load_profile("same_every_run")

BEGAN_s = time.monotonic()
LIMIT_s = float(os.environ.get("PIEZOID_QUICK_S", "inf"))  # of `make quick`

REALDATA = Path(__file__).resolve().parents[2] / "shared" / "realdata"


def pytest_runtest_setup() -> None:
    if time.monotonic() - BEGAN_s > LIMIT_s:
        pytest.skip(f"not begun within {LIMIT_s:g} s: run make test")


@pytest.fixture
def plays_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    fit_plays_alone(monkeypatch)


@pytest.fixture
def one_order(monkeypatch: pytest.MonkeyPatch) -> None:
    fit_one_order(monkeypatch)


@pytest.fixture
def few_rows(monkeypatch: pytest.MonkeyPatch) -> None:
    fit_few_rows(monkeypatch)


@pytest.fixture(scope="module")
def brief_designs() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        design_briefly(patch)
        yield


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(20150401)


@pytest.fixture
def realdata() -> Path:
    if not REALDATA.is_dir():
        pytest.skip("recordings made by other people are not on this machine (shared/realdata)")
    return REALDATA


@pytest.fixture(scope="module", autouse=True)
def drop_cached_stages(request: pytest.FixtureRequest) -> Iterator[None]:
    """Drop what cached functions of a test file hold: a worker kept 2 GB of stages."""
    yield
    for value in list(vars(request.module).values()):
        if getattr(value, "__module__", "") == request.module.__name__:
            getattr(value, "cache_clear", lambda: None)()
