"""A verb limits linear algebra to a single thread in any session."""

import pytest
from threadpoolctl import threadpool_info, threadpool_limits

import piezoid
from tests.reports.known_stage import recording


class StopFitError(Exception):
    """Raised to stop a fit at its first report."""


def blas_threads() -> set[int]:
    return {
        library["num_threads"] for library in threadpool_info() if library["user_api"] == "blas"
    }


@pytest.mark.parametrize("verb", [piezoid.fit, piezoid.diagnose])
def test_a_verb_limits_linear_algebra_to_a_thread_and_restores_the_session(verb):
    counts: list[set[int]] = []

    def interrupt(_: str) -> None:
        counts.append(blas_threads())
        raise StopFitError

    with threadpool_limits(limits=2, user_api="blas"):
        original = blas_threads()  # a library without threads always has 1
        assert 2 in original
        with pytest.raises(StopFitError):
            verb([recording()], progress=interrupt)
        assert blas_threads() == original
    assert counts == [{1}]
