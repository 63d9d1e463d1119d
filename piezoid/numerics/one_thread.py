"""Linear algebra by one thread.

Our matrices are small: the threads of a linear algebra library spend their time waiting for each
other (a fit takes 2.3 times as long on two idle cores, 40 times on two busy ones), and how a sum
is shared among them changes its last bits. Whoever wants several cores asks the verb for
``threads`` of ours.
"""

from collections.abc import Callable
from functools import wraps
from typing import ParamSpec, TypeVar

from threadpoolctl import threadpool_limits

Arguments = ParamSpec("Arguments")
Found = TypeVar("Found")


def on_one_thread(compute: Callable[Arguments, Found]) -> Callable[Arguments, Found]:
    """Return the function with linear algebra held to one thread while it runs.

    The limit is the process's, as the libraries have it, and is lifted at the end.
    """

    @wraps(compute)
    def held(*args: Arguments.args, **kwargs: Arguments.kwargs) -> Found:
        with threadpool_limits(limits=1, user_api="blas"):
            return compute(*args, **kwargs)

    return held
