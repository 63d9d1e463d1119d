"""What a search keeps, takes back, and says of the rest; stand-ins for the fits."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from types import SimpleNamespace

import pytest

import piezoid.diagnosis.diagnose as diagnose
import piezoid.diagnosis.model_comparison as confounded
import piezoid.diagnosis.search as search
from piezoid.diagnosis.attribution import Simulated
from piezoid.diagnosis.diagnosis import Finding, Size
from piezoid.diagnosis.effect import Effect, Fault
from piezoid.diagnosis.effects import creep, initial_state, non_congruence, thermal_drift
from piezoid.diagnosis.something_else import without_names
from piezoid.numerics.executor import SERIAL

from .bench import healthy_view


@dataclass(frozen=True)
class Cause:
    """A cause that is judged already."""

    name: str
    gain: float
    has_a_name: bool = True
    quiet: float = float("inf")

    @property
    def selected(self) -> str:
        return self.name

    @property
    def effect(self) -> SimpleNamespace:
        return SimpleNamespace(
            name=self.name,
            structural=SimpleNamespace(largest_noise_ratio=self.quiet),
            minimum_gain=0.1,
        )

    @property
    def cv(self) -> SimpleNamespace:
        return SimpleNamespace(gain=self.gain)


def of_noise(times: float) -> SimpleNamespace:
    return SimpleNamespace(rms=times, noise=1.0)


def test_of_causes_that_are_no_evidence_any_more_the_least_goes_first(monkeypatch) -> None:
    asked = []

    def each(_, selected, __):
        asked.append(tuple(selected))
        gains = {"creep": 0.5, "lag": 0.1, "delay": 0.2}
        # the delay is evidence once the lag is gone
        return [
            Cause(name, gains[name], has_a_name=name == "creep" or "lag" not in selected)
            for name in selected
        ], {}

    monkeypatch.setattr(confounded, "_compare_each", each)
    causes, _, dismissed = confounded.compare_models(None, ["creep", "lag", "delay"], SERIAL)
    assert asked == [("creep", "lag", "delay"), ("creep", "delay")]
    assert [cause.name for cause in causes] == ["creep", "delay"]
    assert [cause.name for cause in dismissed] == ["lag"]


@pytest.mark.parametrize(
    ("gain", "left", "stands"),
    [
        (0.2, 1.4, True),  # little is left: what it takes off is known
        (0.2, 1.7, False),  # much is left that nothing here follows
        (0.5, 1.7, True),  # but it takes off what nothing else looks like
        (0.3, 2.6, False),  # half of what is no noise: something else is there as well
        (0.5, 2.6, True),
        (0.19, 1.1, True),
    ],
)
def test_structure_is_named_where_hardly_anything_else_is_left(gain, left, stands) -> None:
    structure = Cause("initial_state", gain, quiet=1.6)
    assert search._stands(structure, of_noise(left)) is stands


def test_structure_that_is_held_back_is_a_rival_of_what_it_may_be() -> None:
    found = search._with_confounded({"asymmetry": (), "creep": ("lag",)}, non_congruence.EFFECT)
    assert found == {"asymmetry": ("non_congruence",), "creep": ("lag",)}


def creep_beside(monkeypatch, *near: str, found: Sequence[Effect] = (), z: float = 4.0) -> Finding:
    """Return the finding of a creep of 0.74 % a decade that was not told from others."""
    size = Size(value=0.74, unit=creep.EFFECT.unit, ci95=(0.39, 1.09))
    monkeypatch.setattr(diagnose, "size_of", lambda _: size)
    cause = SimpleNamespace(
        effect=creep.EFFECT,
        share=0.01,
        strength=3.0,
        cv=SimpleNamespace(gain=0.1, p_value=1e-6, z=z),
        selected=SimpleNamespace(parameters={}, from_jumps=False),
    )
    outcome = SimpleNamespace(
        first=SimpleNamespace(stroke_m=1e-5),
        confounded={"creep": near},
        causes=[cause, *(SimpleNamespace(effect=effect) for effect in found)],
    )
    numbers = SimpleNamespace(without={"creep": 0.02}, final=0.018)
    return diagnose._of_cause(cause, outcome, numbers)


def test_a_cause_that_may_be_structure_may_also_be_none_at_all(monkeypatch) -> None:
    found = creep_beside(monkeypatch, "thermal_drift", "initial_state")
    assert found.size.ci95 == (0.0, 1.09)
    assert "A part of it, or all, may be initial state" in found.explanation
    assert found.next_experiment == f"{creep.EFFECT.experiment} {initial_state.EFFECT.experiment}"


def test_a_cause_that_may_be_another_cause_keeps_its_size_and_its_experiment(monkeypatch) -> None:
    found = creep_beside(monkeypatch, "thermal_drift")
    assert found.size.ci95 == (0.39, 1.09)
    assert "A part of it" not in found.explanation
    assert found.next_experiment == creep.EFFECT.experiment


def test_a_doubtful_cause_beside_structure_that_was_found_may_be_a_part_of_it(monkeypatch) -> None:
    found = [initial_state.EFFECT, thermal_drift.EFFECT]
    doubtful, sure = (creep_beside(monkeypatch, found=found, z=z) for z in (4.0, 9.0))
    assert doubtful.size.ci95 == (0.0, 1.09)
    assert doubtful.not_separable_from == ("initial_state",)
    assert initial_state.EFFECT.experiment in doubtful.next_experiment
    assert (sure.size.ci95, sure.not_separable_from) == ((0.39, 1.09), ())
    assert creep_beside(monkeypatch, found=[thermal_drift.EFFECT]).size.ci95 == (0.39, 1.09)


def test_an_effect_that_was_dropped_is_bounded_and_not_called_untestable() -> None:
    view = healthy_view()
    known = {"creep", "lag"}
    found = search._dropped(view, known)
    assert not known & found.keys()
    assert thermal_drift.EFFECT.name in found
    assert not {initial_state.EFFECT.name, non_congruence.EFFECT.name} & found.keys()
    assert all(one.bound > 0.0 for one in found.values())


def test_twice_the_same_fault_keeps_what_it_was_not_told_from() -> None:
    first = Fault(tracks=(), value=-2.0, spread=0.3, p_value=1e-9, alike=("lag",))
    second = Fault(tracks=(), value=-1.0, spread=0.1, p_value=1e-3, alike=("delay", "lag"))
    both = second.after(first)
    assert (both.value, both.spread, both.p_value) == (-2.0, 0.3, 1e-9)
    assert both.alike == ("lag", "delay")


@pytest.mark.parametrize(
    ("undone", "kept", "is_told"),
    [(0.010, 0.009, True), (0.009, 0.009, False), (0.009, 0.010, False)],
)
def test_a_slip_is_told_only_where_undoing_it_helps_the_simulation(undone, kept, is_told) -> None:
    """Other faults need not help: what is coarse stays coarse."""
    view = healthy_view()
    slip = Fault(tracks=view.tracks, value=3.0, spread=0.5, p_value=1e-6)
    nothing = without_names(view, search.without_causes(view, ""))
    faults = {"timestamp_fault": slip, "quantisation": slip}
    found = replace(nothing, outcome=replace(nothing.outcome, faults=faults))
    numbers = Simulated(baseline=0.02, final=kept, without=dict.fromkeys(faults, undone))
    told = diagnose._without_idle_slips(found, numbers).outcome.faults
    assert set(told) == {"quantisation"} | ({"timestamp_fault"} if is_told else set())
