"""Which effects of a round are refitted; stand-ins for the fits."""

from types import SimpleNamespace

import pytest

from piezoid.diagnosis import forward_selection
from piezoid.numerics.executor import SERIAL


def found(name: str, total: float, sound: bool = True) -> SimpleNamespace:
    trial = SimpleNamespace(free={})
    held = SimpleNamespace(gain=total, coefficient=[1.0])
    effect = SimpleNamespace(name=name)
    return SimpleNamespace(
        effect=effect, trial=trial, cv=held, placebo=None, total_gain=total, physical=sound
    )


def refitted(monkeypatch, screenings, evidence: str = "", left=lambda _: 1.0) -> list[str]:
    """Return what is refitted where one effect is evidence once it is.

    left  (name) -> error before its refinement
    """

    def judged(one, *_, **__) -> SimpleNamespace:
        held = SimpleNamespace(rms=0.5)
        name = one.effect.name
        return SimpleNamespace(name=name, is_significant=name == evidence, cv=held, selected=one)

    stand_ins = {
        "initial_guess": lambda effect, *_: SimpleNamespace(effect=effect),
        "extended": lambda _, selected: SimpleNamespace(rms=left(selected[-1].effect.name)),
        "refined": lambda one, *_: (one, None),
        "judged": judged,
        "_refined_together": lambda alone, *_: alone,
    }
    for name, what in stand_ins.items():
        monkeypatch.setattr(forward_selection, name, what)
    beside = forward_selection.SelectionContext(clean=None, selected=(), view=None)
    return [one.name for one in forward_selection.refit_shortlist(screenings, beside, SERIAL)]


SCREENED = [
    found("large", 0.4),
    found("small", 0.03),
    found("tiny", 0.01),
    found("mad", 0.3, False),
]


@pytest.mark.parametrize(
    ("evidence", "tried"),
    [("large", ["large"]), ("", ["large", "small"]), ("small", ["large", "small"])],
)
def test_small_ones_are_refitted_where_no_large_one_is_evidence(
    monkeypatch, evidence, tried
) -> None:
    assert refitted(monkeypatch, SCREENED, evidence) == tried
