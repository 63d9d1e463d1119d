"""Repair: faults of the data are found and undone before anything is explained by physics."""

from piezoid.diagnosis.effect import Fault
from piezoid.diagnosis.effects import EFFECTS
from piezoid.diagnosis.memory import OTHER_PASTS, does_as_well, with_best_habit, with_own_pasts
from piezoid.diagnosis.view import View, with_habit, with_tracks
from piezoid.numerics.hands import Hands

MOST_REPAIRS = 3
EVIDENT = 0.5  # of the error: what a habit leaves that is beyond doubt


def repaired(view: View, hands: Hands, *, but: str = "") -> tuple[View, dict[str, Fault]]:
    """Return the view without the faults that can be undone, and all of them by effect.

    Its drives came from the habit that is evident, or were cycled over their range before.

    but  name of a fault that is not looked for
    """
    faults: dict[str, Fault] = {}
    habit = with_best_habit(view, hands)
    own = with_own_pasts(view, habit)
    evident = habit.rms < EVIDENT * view.rms and does_as_well(habit, own, view)
    believed = habit if evident else view
    # a wrong past looks like readings that are lost
    view = own if own.rms < OTHER_PASTS * believed.rms else believed
    for effect in EFFECTS:
        if effect.fault is None or effect.name == but:
            continue
        for _ in range(MOST_REPAIRS):
            hands.say(f"looking for {effect.name.replace('_', ' ')}")
            fault = effect.fault(view)
            if fault is None:
                break
            faults[effect.name] = fault.after(faults.get(effect.name))
            if all(a is b for a, b in zip(fault.tracks, view.tracks, strict=True)):
                break
            view = with_tracks(view, fault.tracks)
    return with_habit(view, believed.envelope.turns), faults
