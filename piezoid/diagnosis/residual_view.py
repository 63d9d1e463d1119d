"""View: what effects may look at, and the null they must beat.

The nuisance class fitted to the tracks beside what was selected before, its static response at
every sample, and its residual at the rows.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from math import sqrt

import numpy as np

from piezoid.diagnosis.blocked_regression import Null
from piezoid.diagnosis.drive_history import History
from piezoid.diagnosis.initial_states import Reversals, hypotheses
from piezoid.diagnosis.nuisance import NuisanceClass
from piezoid.diagnosis.nuisance_columns import BoucWenLaw
from piezoid.diagnosis.segments import BLOCKS, Places, Track
from piezoid.numerics.arrays import Array
from piezoid.numerics.executor import Once
from piezoid.numerics.noise import white_noise_rms
from piezoid.records.sample_statistics import step_size

SLOWLY_Hz = 1e-9  # of turns before a recording: nothing is too fast for what lets them through
DIGITS = 9  # of half the stroke that count: a step is the same however it was rounded


@dataclass(frozen=True, kw_only=True, eq=False)
class View:
    """Tracks, their nuisance class, and what effects that were selected already make of them.

    selected  (rows, columns)  added to the null
    offset    (rows,)          what filters that all of the response passes change
    stroke_m  half the range of the displacement: what the number 1 means
    voltage_V half the range of the drive
    rest      the drive at 0 V, in half ranges from its middle
    guess     static responses to take in place of the fitted ones, (samples,) for each track
    one_speed whether like branches were all driven at one speed and nothing jumps: there all that
              needs time is a width of the loop
    """

    nuisance: NuisanceClass
    selected: Array
    offset: Array
    stroke_m: float
    voltage_V: float
    rest: float
    guess: tuple[Array, ...] | None = None
    one_speed: bool = False

    @property
    def tracks(self) -> tuple[Track, ...]:
        """Return the tracks."""
        return self.nuisance.tracks

    @Once
    def driven(self) -> dict[object, "View"]:
        """Return room for this view with other commands or initial states, by what changed."""
        return {}

    @Once
    def response(self) -> Array:
        """Return the measured response at the rows, as it was in front of such filters."""
        return np.concatenate([t.response[t.place] for t in self.tracks]) - self.offset

    @Once
    def block(self) -> Places:
        """Return the global block of every row."""
        return np.concatenate([t.block + BLOCKS * k for k, t in enumerate(self.tracks)])

    @Once
    def null(self) -> Null:
        """Return the nuisance class with everything selected."""
        return Null(
            columns=self.nuisance.columns,
            response=self.response,
            block=self.block,
            more=self.selected if self.selected.shape[1] else None,
            known=self.nuisance.gram,
        )

    @Once
    def weight(self) -> Array:
        """Return the coefficients of the shared columns."""
        return self.null.coefficients[: self.nuisance.shared]

    @Once
    def static(self) -> tuple[Array, ...]:
        """Return the static response of every track at every sample."""
        if self.guess is not None:
            return self.guess
        return tuple(self.nuisance.static(k, self.weight) for k in range(len(self.tracks)))

    @property
    def rms(self) -> float:
        """Return the rms of the residual."""
        return self.null.rms

    @Once
    def noise(self) -> float:
        """Return the white noise of the response or of a coarse converter, rms.

        What repeats every other sample passes for noise; where less is left, it was none.
        """
        rows = np.diff(self.nuisance.edges)
        left = np.add.reduceat(self.null.residual**2, self.nuisance.edges[:-1]) / rows
        noise = np.square([_noise(track.response) for track in self.tracks])
        return float(np.sqrt(np.average(np.minimum(noise, left), weights=rows)))

    def rows(self, signals: Sequence[Array]) -> Array:
        """Return one column: signals of all tracks at the rows."""
        picked = [s[t.place] for s, t in zip(signals, self.tracks, strict=True)]
        return np.concatenate(picked)

    def of(self, change: Callable[[int, Track], Array]) -> Array:
        """Return one column made track by track at the rows."""
        return self.rows([change(k, track) for k, track in enumerate(self.tracks)])

    def track_rows(self, k: int) -> slice:
        """Return the rows of one track."""
        edges = self.nuisance.edges
        return slice(int(edges[k]), int(edges[k + 1]))

    def of_track(self, k: int, values: Array) -> Array:
        """Return a column that is zero outside one track."""
        column = np.zeros(self.nuisance.edges[-1])
        column[self.track_rows(k)] = values
        return column


def _noise(response: Array) -> float:
    # readings that stay on one step for long differ by nothing, and err by a part of the step
    step = step_size(np.round(response, DIGITS))
    return max(white_noise_rms(response), step / sqrt(12.0))


def view_of(tracks: Sequence[Track], *, stroke_m: float, voltage_V: float, rest: float) -> View:
    """Fit the nuisance class to tracks whose drives were cycled before."""
    histories = tuple(
        History(track=track, reversals=hypotheses(track.drive)[0]) for track in tracks
    )
    nuisance = NuisanceClass(histories=histories)
    rows = int(nuisance.edges[-1])
    return View(
        nuisance=nuisance,
        selected=np.zeros((rows, 0)),
        offset=np.zeros(rows),
        stroke_m=stroke_m,
        voltage_V=voltage_V,
        rest=rest,
    )


def cycled(view: View) -> View:
    """Return the view as it is if every drive was cycled over its range before."""
    return with_shared_reversals(view, tuple(hypotheses(track.drive)[0] for track in view.tracks))


def with_free_memory(view: View) -> View:
    """Return the view in which the first states of every track may be corrected."""
    return replace(view, nuisance=replace(view.nuisance, free=True))


def with_reversals(view: View, reversals: tuple[Reversals, ...]) -> View:
    """Return the view with other initial states of its tracks."""
    if reversals == view.nuisance.reversals:
        return view
    return replace(view, nuisance=replace(view.nuisance, histories=_after(view, reversals)))


def with_shared_reversals(view: View, reversals: tuple[Reversals, ...]) -> View:
    """Return the view with other initial states of its tracks that nobody corrects."""
    histories = _after(view, reversals)
    return replace(view, nuisance=replace(view.nuisance, histories=histories, free=False))


def _after(view: View, reversals: tuple[Reversals, ...]) -> tuple[History, ...]:
    return tuple(h.after(t) for h, t in zip(view.nuisance.histories, reversals, strict=True))


def with_bouc_wen(view: View, bouc_wen: BoucWenLaw | None) -> View:
    """Return the view with a Bouc-Wen state of these parameters in its nuisance class."""
    return replace(view, nuisance=replace(view.nuisance, bouc_wen=bouc_wen))


def with_let_through(view: View, let_through: Callable[[Array, float], Array]) -> View:
    """Return the view of what is let through of commands, and nothing selected.

    let_through  (drive, rate_Hz) -> what reaches the stage

    What does not reach the stage did not before a recording either, when all was slow.
    """
    commands = [let_through(track.command, track.rate_Hz) for track in view.tracks]
    if all(a is b.command for a, b in zip(commands, view.tracks, strict=True)):
        return view
    tracks = tuple(
        track
        if np.array_equal(command, track.command)
        else replace(track, command=command, drive=track.read(command))
        for track, command in zip(view.tracks, commands, strict=True)
    )
    before = tuple(
        tuple(let_through(np.array(reversals), SLOWLY_Hz).tolist()) if reversals else ()
        for reversals in view.nuisance.reversals
    )
    return with_tracks(with_reversals(view, before), tracks)


def with_tracks(view: View, tracks: Sequence[Track]) -> View:
    """Return the view of other tracks, and nothing selected."""
    histories = tuple(
        h.on(track) for h, track in zip(view.nuisance.histories, tracks, strict=True)
    )
    nuisance = replace(view.nuisance, histories=histories)
    rows = int(nuisance.edges[-1])
    return replace(
        view,
        nuisance=nuisance,
        selected=np.zeros((rows, 0)),
        offset=np.zeros(rows),
        guess=None,
    )
