"""Fixed-point iteration on a whole signal, damped where it would diverge."""

from collections.abc import Callable

import numpy as np

from piezoid.numerics.arrays import Array


def damped_iteration(
    start: Array,
    evaluate: Callable[[Array], tuple[Array, Array]],
    *,
    share: float,
    iterations: int,
) -> Array:
    """Correct a signal repeatedly, and return the signal with the smallest rms error.

        x <- x + s c(x),   s halved whenever the error e(x) increases

    start       (samples,)
    evaluate    x -> error e and correction c, (samples,) each
    share       s at first
    iterations  number of evaluations

    >>> double = damped_iteration(
    ...     np.zeros(1), lambda x: (3.0 - 2.0 * x, 3.0 - 2.0 * x), share=0.8, iterations=40
    ... )
    >>> double.round(6).tolist()
    [1.5]
    """
    signal, best, best_correction, smallest = start, start, np.zeros(0), np.inf
    for _ in range(iterations):
        error, correction = evaluate(signal)
        power = float(np.mean(error**2))
        if power < smallest:
            best, best_correction, smallest = signal, correction, power
        else:
            share *= 0.5
        signal = best + share * best_correction
    return best
