"""p-values as ranks among healthy stages: of a systematic residual, and of evidence for an effect.

Hysteresis of another law than the nuisance class causes a systematic residual, which no shuffling
distinguishes from an effect outside the catalogue. Its score is therefore compared with the
scores of healthy stages of all laws of the zoo. Its rank among n scores is a p-value,

    p = (1 + #{s_i >= s}) / (n + 1),

exactly uniform for a healthy stage that is exchangeable with the stages of the table, whatever the
score is. An effect is compared in the same way with the strongest evidence in the diagnosis of a
healthy stage, named or dismissed: the rms of the effect over that of the structure of the
residual. That p-value applies to any finding of a diagnosis, so it needs no factor for the number
of effects. Limitation: the drives of these stages have unknown histories, so the table contains no
evidence of initial states, and an initial state is ranked among evidence of other effects.
``python -m benchmarks.zoo.healthy`` makes the table.

Source: Vovk, Gammerman & Shafer, Algorithmic Learning in a Random World (2005), conformal p.
"""

import json
from collections.abc import Iterable
from functools import cache
from importlib.resources import files

ALPHA = 0.05  # of the rank among 52 healthy stages, whose smallest p-value is 1/53


def structure_score(gain: float, rms: float, noise: float) -> float:
    """Return the power that one coordinate explains, in units of the noise power.

        gain rms^2 / min(noise^2, (1 - gain) rms^2)

    gain  share of the residual's power that the coordinate explains on left-out blocks

    A residual that repeats within a few samples increases the estimate of the noise, so the noise
    power is at most the unexplained power.
    """
    gain = min(max(gain, 0.0), 1.0)
    noise_power = min(noise**2, (1.0 - gain) * rms**2)
    return gain * rms**2 / max(noise_power, 1e-300)


def rank_p_value(value: float, null_values: Iterable[float]) -> float:
    """Return the p-value of a statistic by its rank among values of the null distribution.

    >>> rank_p_value(3.0, [0.1, 0.5, 4.0])
    0.5
    """
    values = list(null_values)
    return (1.0 + sum(value <= null for null in values)) / (len(values) + 1.0)


def structure_p_value(gain: float, rms: float, noise: float) -> float:
    """Return the probability that a healthy stage has a residual as systematic as this."""
    return rank_p_value(structure_score(gain, rms, noise), _healthy("scores"))


def smallest_structure_p_value() -> float:
    """Return the p-value of a residual more systematic than that of every healthy stage."""
    return rank_p_value(float("inf"), _healthy("scores"))


def evidence_p_value(strength: float) -> float:
    """Return the probability that a healthy stage shows evidence as strong for any effect.

    The strength of a healthy stage without evidence is 0.
    """
    return rank_p_value(strength, _healthy("strengths"))


@cache
def _healthy(statistic: str) -> tuple[float, ...]:
    table = json.loads(files(__package__).joinpath("healthy_scores.json").read_text("utf-8"))
    return tuple(value for of_law in table[statistic].values() for value in of_law)
