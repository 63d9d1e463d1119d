"""View of the recordings: the fit of nuisance class and selected effects, and its residual.

Effects are tested on the static response of the fit at all samples and on its residual at rows.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import sqrt

import numpy as np

from piezoid.diagnosis.blocked_regression import Null
from piezoid.diagnosis.nuisance import History, NuisanceClass, Reversals, hypotheses
from piezoid.diagnosis.nuisance_columns import BoucWenLaw
from piezoid.diagnosis.segments import BLOCKS, Places, Track
from piezoid.numerics.arrays import Array
from piezoid.numerics.executor import Once
from piezoid.numerics.robust import white_noise_rms
from piezoid.records.sample_statistics import step_size

PAST_RATE_Hz = 1e-9  # sampling rate of turning points before a recording: no limit acts on them
MAX_DEVIATION = 0.5  # of the share from 1: halfway to a drive that is held
LinearFilter = Callable[[Array, float], Array]
"""(signal, rate_Hz) -> filtered signal, of the same shape: (samples,) or (samples, columns)"""
DIGITS = 9  # of half the stroke: steps of a converter are equal up to rounding


@dataclass(frozen=True, kw_only=True)
class LinearPath:
    """Selected filters and modes behind the hysteresis.

        z = F x + sum_j s_j (M_j F x - F x)

    filters  F in their order, by the name of their effect
    modes    M_j
    shares   s_j, of the motion that takes part in each mode
    """

    filters: Mapping[str, LinearFilter]
    modes: Mapping[str, LinearFilter]
    shares: Mapping[str, float]

    def filtered(self, signal: Array, rate_Hz: float) -> Array:
        """Return a signal behind the filters."""
        for filter_ in self.filters.values():
            signal = filter_(signal, rate_Hz)
        return signal

    def moved(self, signal: Array, rate_Hz: float) -> Array:
        """Return a signal behind filters and modes, (samples,) or (samples, columns)."""
        filtered = self.filtered(signal, rate_Hz)
        moved = filtered
        for name, mode in self.modes.items():
            if self.shares[name]:
                moved = moved + self.shares[name] * (mode(filtered, rate_Hz) - filtered)
        return moved


@dataclass(frozen=True, kw_only=True, eq=False)
class View:
    """Tracks with their nuisance class and the selected effects.

    selected         (rows, columns)  of selected effects, part of the null
    path             selected filters and modes, behind which the columns of the nuisance class
                     are fitted; None if there are none
    coefficients_of  columns of each selected effect in ``selected``
    sensor_columns   number of the last selected columns that are errors of the reading: the stage
                     does not move by them
    half_stroke_m    half the range of the displacement: 1 in scaled units
    voltage_V        half the range of the drive
    rest_drive       drive at 0 V, in half ranges from its middle
    static_override  (samples,) of every track: static responses instead of the fitted ones
    continuous       command and drive of every track if they move between samples, where a
                     converter is assumed to hold them; empty if they are not held
    one_speed        whether all branches were driven at one speed without jumps, so that effects
                     that need time only change the loop width
    """

    nuisance: NuisanceClass
    selected: Array
    half_stroke_m: float
    voltage_V: float
    rest_drive: float
    path: LinearPath | None = None
    coefficients_of: Mapping[str, slice] = field(default_factory=dict)
    sensor_columns: int = 0
    static_override: tuple[Array, ...] | None = None
    continuous: tuple[tuple[Array, Array], ...] = ()
    one_speed: bool = False

    @property
    def tracks(self) -> tuple[Track, ...]:
        """Return the tracks of the nuisance class."""
        return self.nuisance.tracks

    @Once
    def cache(self) -> dict[object, "View"]:
        """Return a cache of views with other drives or initial states."""
        return {}

    @Once
    def response(self) -> Array:
        """Return the measured response at the rows, without the selected filters."""
        return self.rows([t.response for t in self.tracks]) - self.offset

    @Once
    def offset(self) -> Array:
        """Return the change of a fixed static response by the selected filters, (rows,)."""
        if self.path is None or self.static_override is None:
            return np.zeros(self.nuisance.edges[-1])
        return self.rows(self.static) - self.rows(self.unfiltered)

    @Once
    def columns(self) -> Array:
        """Return the columns of the nuisance class, behind the selected filters and modes."""
        if self.path is None or self.static_override is not None:
            return self.nuisance.columns
        return self.nuisance.columns_behind(self.path.moved)

    @Once
    def block(self) -> Places:
        """Return the global block of every row."""
        return np.concatenate([t.block + BLOCKS * k for k, t in enumerate(self.tracks)])

    @Once
    def null(self) -> Null:
        """Return the null hypothesis: the nuisance class and all selected effects."""
        return Null(
            columns=self.columns,
            response=self.response,
            block=self.block,
            extra=self.selected if self.selected.shape[1] else None,
            column_gram=self.nuisance.gram if self.columns is self.nuisance.columns else None,
        )

    @Once
    def weight(self) -> Array:
        """Return the coefficients of the shared columns."""
        return self.null.coefficients[: self.nuisance.shared]

    @Once
    def unfiltered(self) -> tuple[Array, ...]:
        """Return the static response of every track in front of the selected filters."""
        if self.static_override is not None:
            return self.static_override
        return tuple(self.nuisance.static(k, self.weight) for k in range(len(self.tracks)))

    @Once
    def static(self) -> tuple[Array, ...]:
        """Return the static response of every track at every sample, without the track's zero.

        Behind the selected filters: these are linear, so that a mode in front of a delay moves as
        one that is driven by the delayed response.
        """
        if self.path is None:
            return self.unfiltered
        pairs = zip(self.unfiltered, self.tracks, strict=True)
        return tuple(self.path.filtered(static, track.rate_Hz) for static, track in pairs)

    @Once
    def motion(self) -> tuple[Array, ...]:
        """Return the static response of every track with all selected effects but sensor errors.

        At every sample; the contributions of the effects are interpolated between rows.
        """
        count = self.selected.shape[1] - self.sensor_columns
        coefficients = self.null.coefficients[self.nuisance.columns.shape[1] :]
        added = self.selected[:, :count] @ coefficients[:count]
        moved = self.static
        if self.path is not None:
            pairs = zip(self.unfiltered, self.tracks, strict=True)
            moved = tuple(self.path.moved(static, track.rate_Hz) for static, track in pairs)
        if not np.any(added):
            return moved
        return tuple(
            static + np.interp(np.arange(len(static)), track.rows, added[self.track_rows(k)])
            for k, (track, static) in enumerate(zip(self.tracks, moved, strict=True))
        )

    @property
    def rms(self) -> float:
        """Return the rms of the residual."""
        return self.null.rms

    @property
    def fastest_Hz(self) -> float:
        """Return the sampling rate of the fastest track."""
        return max(track.rate_Hz for track in self.tracks)

    @property
    def longest_s(self) -> float:
        """Return the duration of the longest track."""
        return max(track.duration_s for track in self.tracks)

    @Once
    def noise(self) -> float:
        """Return the rms of the white noise, at least that of a coarse converter.

        A systematic error that alternates from sample to sample looks like noise, so the noise of
        a track is at most its residual. Readings on one step of a converter do not differ, but
        have an error of up to half the step.
        """
        rows, noise = np.diff(self.nuisance.edges), []
        for track in self.tracks:
            step = step_size(np.round(track.response, DIGITS))
            noise.append(max(white_noise_rms(track.response), step / sqrt(12.0)))
        residual = np.add.reduceat(self.null.residual**2, self.nuisance.edges[:-1]) / rows
        return float(np.sqrt(np.average(np.minimum(np.square(noise), residual), weights=rows)))

    def rows(self, signals: Sequence[Array]) -> Array:
        """Return the values of signals of all tracks at the rows, (rows,)."""
        return np.concatenate([s[t.rows] for s, t in zip(signals, self.tracks, strict=True)])

    def column(self, signal: Callable[[int, Track], Array]) -> Array:
        """Compute a signal for each track, and return its values at the rows, (rows,)."""
        return self.rows([signal(k, track) for k, track in enumerate(self.tracks)])

    def track_rows(self, k: int) -> slice:
        """Return the rows of one track."""
        edges = self.nuisance.edges
        return slice(int(edges[k]), int(edges[k + 1]))

    def track_column(self, k: int, values: Array) -> Array:
        """Return values at the rows of one track, and zero at all other rows, (rows,)."""
        column = np.zeros(self.nuisance.edges[-1])
        column[self.track_rows(k)] = values
        return column


def view_of(
    tracks: Sequence[Track], *, half_stroke_m: float, voltage_V: float, rest_drive: float
) -> View:
    """Return the view of tracks, assuming that drives were cycled over their range before."""
    histories = tuple(
        History(track=track, reversals=hypotheses(track.drive)[0]) for track in tracks
    )
    nuisance = NuisanceClass(histories=histories)
    rows = int(nuisance.edges[-1])
    return View(
        nuisance=nuisance,
        selected=np.zeros((rows, 0)),
        half_stroke_m=half_stroke_m,
        voltage_V=voltage_V,
        rest_drive=rest_drive,
    )


def with_cycled_drives(view: View) -> View:
    """Return the view with initial states of drives that were cycled over their range before."""
    return with_shared_reversals(view, tuple(hypotheses(track.drive)[0] for track in view.tracks))


def with_free_memory(view: View) -> View:
    """Return the view with fitted corrections of the initial state of every track."""
    return replace(view, nuisance=replace(view.nuisance, free=True))


def with_reversals(view: View, reversals: tuple[Reversals, ...]) -> View:
    """Return the view with other initial states of its tracks."""
    if reversals == view.nuisance.reversals:
        return view
    histories = tuple(
        history
        if of_track == history.reversals
        else History(track=history.track, reversals=of_track)
        for history, of_track in zip(view.nuisance.histories, reversals, strict=True)
    )
    return replace(view, nuisance=replace(view.nuisance, histories=histories))


def with_shared_reversals(view: View, reversals: tuple[Reversals, ...]) -> View:
    """Return the view with other initial states of its tracks and no fitted corrections."""
    nuisance = with_reversals(view, reversals).nuisance
    return replace(view, nuisance=replace(nuisance, free=False))


def with_bouc_wen(view: View, bouc_wen: BoucWenLaw | None) -> View:
    """Return the view with a Bouc-Wen state in its nuisance class, or with none."""
    return replace(view, nuisance=replace(view.nuisance, bouc_wen=bouc_wen))


def with_continuous_drive(view: View) -> View:
    """Return the view with a drive that no converter holds, and no selected effects."""
    tracks = [
        replace(track, command=command, drive=drive)
        for track, (command, drive) in zip(view.tracks, view.continuous, strict=True)
    ]
    return replace(with_tracks(view, tracks), continuous=())


def has_continuous_drive(view: View, continuous: View | None = None) -> bool:
    """Return whether the drive moves between samples, as that of a generator does.

        y = f(u_held) + s (f(u_continuous) - f(u_held)),   s about 1

    A hold delays the drive by half a period, which no class of hysteresis follows. On 39 stages
    whose drive is held, s was below 0.13 (34), above 2 (4), or the errors were equal (1). On eight
    stages of two simulators whose drives move, it was 0.73 to 1.02.

    continuous  the view with the continuous drive; default: without selected effects
    """
    if not view.continuous:
        return False
    tracks = (continuous or with_continuous_drive(view)).tracks
    changes = [
        view.nuisance.static_rows(k, view.weight, track.drive) - view.unfiltered[k][track.rows]
        for k, track in enumerate(tracks)
    ]
    change = np.concatenate(changes)[:, None]
    if not np.any(change):
        return False
    return bool(abs(view.null.cross_validated(change).coefficient[0] - 1.0) < MAX_DEVIATION)


def with_filtered_commands(view: View, drive_filter: Callable[[Array, float], Array]) -> View:
    """Return the view with filtered commands, and no selected effects.

    drive_filter  (drive, rate_Hz) -> drive of the stage

    Reversals before a recording, assumed to be slow, are filtered as well.
    """
    commands = [drive_filter(track.command, track.rate_Hz) for track in view.tracks]
    if all(command is track.command for command, track in zip(commands, view.tracks, strict=True)):
        return view
    tracks = tuple(
        track
        if np.array_equal(command, track.command)
        else replace(track, command=command, drive=track.read(command))
        for track, command in zip(view.tracks, commands, strict=True)
    )
    filtered_reversals = tuple(
        tuple(drive_filter(np.array(reversals), PAST_RATE_Hz).tolist()) if reversals else ()
        for reversals in view.nuisance.reversals
    )
    return with_tracks(with_reversals(view, filtered_reversals), tracks)


def with_tracks(view: View, tracks: Sequence[Track]) -> View:
    """Return the view of other tracks with the same initial states, and no selected effects."""
    histories = tuple(
        history.with_track(track)
        for history, track in zip(view.nuisance.histories, tracks, strict=True)
    )
    nuisance = replace(view.nuisance, histories=histories)
    rows = int(nuisance.edges[-1])
    return replace(
        view,
        nuisance=nuisance,
        selected=np.zeros((rows, 0)),
        path=None,
        coefficients_of={},
        sensor_columns=0,
        static_override=None,
    )
