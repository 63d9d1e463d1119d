"""Repair: faults of the data are found and undone before anything is explained by physics."""

from piezoid.diagnosis.effect import Fault
from piezoid.diagnosis.effects import EFFECTS
from piezoid.diagnosis.initial_state_search import (
    OTHER_INITIAL_STATES,
    shared_does_as_well,
    with_own_initial_states,
    with_shared_initial_state,
)
from piezoid.diagnosis.view import View, with_shared_reversals, with_tracks
from piezoid.numerics.executor import Executor

MOST_REPAIRS = 3
EVIDENT = 0.5  # of the error: what a shared initial state leaves that is beyond doubt


def repaired(view: View, executor: Executor, *, but: str = "") -> tuple[View, dict[str, Fault]]:
    """Return the view without the faults that can be undone, and all of them by effect.

    The initial state is the shared hypothesis that is evident, or a drive cycled over its range.

    but  name of a fault that is not looked for
    """
    faults: dict[str, Fault] = {}
    shared = with_shared_initial_state(view, executor)
    own = with_own_initial_states(view, shared)
    evident = shared.rms < EVIDENT * view.rms and shared_does_as_well(shared, own, view)
    believed = shared if evident else view
    # a wrong initial state looks like readings that are lost
    view = own if own.rms < OTHER_INITIAL_STATES * believed.rms else believed
    for effect in EFFECTS:
        if effect.fault is None or effect.name == but:
            continue
        for _ in range(MOST_REPAIRS):
            executor.report(f"looking for {effect.name.replace('_', ' ')}")
            fault = effect.fault(view)
            if fault is None:
                break
            faults[effect.name] = fault.after(faults.get(effect.name))
            if all(a is b for a, b in zip(fault.tracks, view.tracks, strict=True)):
                break
            view = with_tracks(view, fault.tracks)
    return with_shared_reversals(view, believed.nuisance.reversals), faults
