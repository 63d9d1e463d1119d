"""A verb holds linear algebra to one thread, in whatever session it is called from."""

import pytest
from threadpoolctl import threadpool_info, threadpool_limits

import piezoid
from tests.reports.known_stage import recording


class EnoughError(Exception):
    """What ends a fit after its first words."""


def blas_threads() -> set[int]:
    return {one["num_threads"] for one in threadpool_info() if one["user_api"] == "blas"}


@pytest.mark.parametrize("verb", [piezoid.fit, piezoid.diagnose])
def test_a_session_with_many_threads_lends_one_to_a_verb_and_has_them_back(verb):
    seen: list[set[int]] = []

    def interrupt(_: str) -> None:
        seen.append(blas_threads())
        raise EnoughError

    with threadpool_limits(limits=2, user_api="blas"):
        held = blas_threads()  # of a library that was built for one thread it is 1 for ever
        assert 2 in held
        with pytest.raises(EnoughError):
            verb([recording()], progress=interrupt)
        assert blas_threads() == held
    assert seen == [{1}]
