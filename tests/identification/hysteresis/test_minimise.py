"""Where a search ends: at a step worth nothing, or where many are worth next to nothing."""

from types import SimpleNamespace

import numpy as np
import pytest

from piezoid.identification.hysteresis import gauss_newton
from piezoid.identification.hysteresis.gauss_newton import Minimum, minimise


@pytest.fixture
def search(monkeypatch):
    """A search whose steps lower the cost by given shares, the last one again and again."""

    def searched(*shares, iterations=30):
        def stepped(state, *others):
            share = shares[min(state.iterations, len(shares) - 1)]
            rms, done = state.rms * np.sqrt(1.0 - share), share < gauss_newton.CONVERGED
            count = state.iterations + 1
            return Minimum(
                theta=state.theta, rms=rms, iterations=count, gradient=0.0, converged=done
            ), others[-1]

        monkeypatch.setattr(gauss_newton, "rms_of", lambda *_: 1.0)
        monkeypatch.setattr(gauss_newton, "factor_of", lambda *_: None)
        monkeypatch.setattr(gauss_newton, "_iterate", stepped)
        bounds = (np.zeros(2), np.ones(2))
        task = SimpleNamespace(
            coordinates=SimpleNamespace(bounds=lambda _: bounds),
            longest_lag_s=0.0,
            held=(),
            roughness=lambda _: 0.0,
        )
        return minimise(np.full(2, 0.5), task, iterations=iterations)

    return searched


def test_steps_that_go_on_and_on_for_next_to_nothing_end_in_a_converged_search(search) -> None:
    found = search(0.5, 0.1, 1.5e-4)
    assert found.converged
    assert found.iterations == 2 + gauss_newton.CRAWL


def test_steady_steps_that_add_up_go_on_to_the_limit_which_is_no_convergence(search) -> None:
    found = search(0.5, 1e-3, iterations=20)
    assert not found.converged
    assert found.iterations == 20


def test_a_search_that_finds_its_stride_again_is_not_ended_by_a_few_small_steps(search) -> None:
    found = search(0.5, 1e-4, 1e-4, 1e-4, 1e-4, 0.3, 1e-6)
    assert found.converged
    assert found.iterations == 7
