"""Each effect follows its documented physics, as seen in the recordings."""

import numpy as np
import pytest
from numpy.typing import NDArray

from piezoid_datasets.virtual_lab.campaign import change_m, draw_campaign
from piezoid_datasets.virtual_lab.effects.ceramic import follow_slowly, freer_end
from piezoid_datasets.virtual_lab.effects.drive import limited
from piezoid_datasets.virtual_lab.truths.closed_form import BOUC_WEN
from piezoid_datasets.virtual_lab.truths.closed_form import WALL_PINNING as WALLS
from piezoid_datasets.virtual_lab.truths.truth import Ceramic
from tests.datasets.campaigns import campaign, number, pair, pairs

Array = NDArray[np.float64]


def test_creep_grows_with_the_logarithm_of_time():
    faulty, sound = pair("long_hold", 4, "creep", 1.0)
    change = change_m(faulty, sound)
    start = np.argmax(sound.time_s > 2.0)  # the hold begins at 2 s, after 1 s up and 1 s back
    creep_m = [change[start + int(100 * t)] - change[start] for t in (1.0, 10.0, 80.0)]
    level_m = sound.noise_free_m[start]
    expected = number(4, "creep", "creep_per_decade", 1.0) * level_m
    assert creep_m[1] - creep_m[0] > 0.5 * expected
    assert abs((creep_m[2] - creep_m[1]) / np.log10(8.0) / expected - 1.0) < 0.25


def test_drift_does_not_depend_on_the_drive():
    drifts = []
    for truth in ("preisach", "bouc_wen"):
        sizes = {"thermal_drift": 0.5}
        faulty = draw_campaign(6, effects=sizes, truth=truth, plans=("long_hold",))
        sound = draw_campaign(6, truth=truth, plans=("long_hold",))
        drifts.append(change_m(faulty.recordings[0], sound.recordings[0]))
    assert np.allclose(drifts[0], drifts[1], atol=1e-12)


def test_the_lag_of_walls_grows_as_arcsinh_of_the_rate():
    tau_s, scale = 2e-3, 0.01
    still = np.linspace(0.0, 0.3, 5001)
    for rate_Hz in (50.0, 5e3, 500e3):
        lag = np.max(still - follow_slowly(still, tau_s, scale, rate_Hz))
        expected = scale * np.arcsinh(0.3 / 5000 * rate_Hz * tau_s / scale)
        one_step = 0.3 / 5000  # the wall follows the end of each step of the target
        assert abs(lag - expected) < 1e-3 * expected + one_step


def test_the_wall_solves_its_kinetics():
    still, tau_s, scale, rate_Hz = np.linspace(0.0, 0.1, 2001), 0.02, 0.01, 1e4
    wall = 0.0
    for target in still[1:]:
        for _ in range(20):
            wall += scale / tau_s * np.sinh((target - wall) / scale) / rate_Hz / 20
    assert abs(follow_slowly(still, tau_s, scale, rate_Hz)[-1] - wall) < 1e-4


def test_a_resonance_is_a_mode_with_its_share_of_the_displacement():
    is_complete = set()
    for seed in (3, 4):
        faulty, sound = pair("chirp", seed, "resonance")
        f_Hz, z, share = (
            number(seed, "resonance", key) for key in ("frequency_Hz", "damping", "share")
        )
        lines_Hz = np.fft.rfftfreq(len(faulty.time_s), 1.0 / faulty.run.sampling_rate_Hz)
        ratio = 1.0 / (1.0 - (lines_Hz / f_Hz) ** 2 + 2j * z * lines_Hz / f_Hz)
        expected = np.fft.irfft(
            share * (ratio - 1.0) * np.fft.rfft(sound.noise_free_m), len(faulty.time_s)
        )
        residual_m = change_m(faulty, sound) - expected
        assert np.std(residual_m) < 0.1 * np.std(expected)  # the rows are coarser than the chain
        is_complete.add(share == 1.0)
    assert is_complete == {True, False}


def test_a_delay_is_constant_in_seconds_or_in_rows():
    for seed in (3, 4):
        numbers = campaign(seed, "delay").answer.effects[0].numbers
        for faulty, sound in pairs(seed, "delay"):
            rate_Hz = faulty.run.sampling_rate_Hz
            rows = float(numbers["rows"]) if "rows" in numbers else numbers["delay_s"] * rate_Hz
            index = np.arange(len(faulty.time_s))
            delayed_m = np.interp(index - rows, index, sound.noise_free_m)
            assert np.max(np.abs(faulty.noise_free_m - delayed_m)) < 0.03 * np.ptp(delayed_m)
            assert np.std(faulty.noise_free_m - delayed_m) < 0.1 * np.std(change_m(faulty, sound))


def test_lag_is_a_filter_behind_the_sensor():
    faulty, sound = pair("rates", 4, "lag", 0.4)
    tau_s = number(4, "lag", "time_constant_s", 0.4)
    speed = np.gradient(faulty.noise_free_m, faulty.time_s)
    residual_m = sound.noise_free_m - faulty.noise_free_m - tau_s * speed
    assert np.std(residual_m) < 0.05 * np.std(tau_s * speed)


def test_coupling_has_two_paths_and_needs_a_driven_axis():
    paths, plans = set(), ("check", "other_axis")
    for seed in range(4):
        effect = campaign(seed, "cross_coupling", None, plans).answer.effects[0]
        paths.add(effect.numbers["path"])
        for faulty, sound in pairs(seed, "cross_coupling", None, plans):
            if "y" not in faulty.others_V:
                assert np.array_equal(faulty.displacement_m, sound.displacement_m)
    assert paths == {"mechanical", "electrical"}


def test_mains_interference_is_a_line_of_the_grid():
    faulty, sound = pair("staircase", 4, "mains_interference")
    change = change_m(faulty, sound)
    lines = np.abs(np.fft.rfft(change * np.hanning(len(change))))
    loudest_Hz = np.argmax(lines) * faulty.run.sampling_rate_Hz / len(change)
    assert abs(loudest_Hz - number(4, "mains_interference", "grid_Hz")) < 0.3


def test_the_periodic_error_repeats_with_displacement():
    faulty, sound = pair("sweep", 4, "sensor_periodic_error")
    period_m = number(4, "sensor_periodic_error", "period_m")
    turn = np.floor(sound.noise_free_m / period_m * 40.0) % 40.0
    change = change_m(faulty, sound)
    within = np.sqrt(np.mean([np.var(change[turn == t]) for t in range(40)]))
    assert within < 0.15 * np.std(change)


def test_a_saturated_amplifier_stops_while_the_command_continues():
    for seed in (2, 3, 4):
        numbers = campaign(seed, "amplifier_saturation").answer.effects[0].numbers
        faulty, _ = pair("sweep", seed, "amplifier_saturation")
        beyond = np.zeros(len(faulty.time_s), dtype=bool)
        for side, sign in (("high_V", 1.0), ("low_V", -1.0)):
            beyond |= sign * 15.0 * faulty.voltage_V > sign * float(numbers.get(side, sign * 1e9))
        runs = np.split(faulty.noise_free_m, np.flatnonzero(np.diff(beyond)) + 1)
        flat = [
            part[2:-2] for part, hit in zip(runs, alternating_runs(beyond), strict=True) if hit
        ]
        assert max(np.ptp(part) for part in flat if len(part)) < 1e-9


def alternating_runs(flags: NDArray[np.bool_]) -> list[bool]:
    return [bool(flags[0]), *flags[np.flatnonzero(np.diff(flags)) + 1].tolist()]


def test_a_slew_limit_slows_only_fast_drives():
    command = np.concatenate((np.linspace(0.0, 1.0, 11), np.linspace(1.5, 5.0, 8)))
    followed = limited(command, 0.2)
    assert np.array_equal(followed[:11], command[:11])
    assert np.allclose(np.diff(followed[11:]), 0.2)
    assert limited(command[:11], 0.2) is not None
    sweep, sound = pair("sweep", 4, "slew_limit")
    assert np.array_equal(sweep.displacement_m, sound.displacement_m)


def test_the_gain_changes_at_its_instant_and_stays_changed():
    plans = ("sweep", "check", "staircase")
    numbers = campaign(4, "gain_change", None, plans).answer.effects[0].numbers
    gain, order = float(numbers["relative_change"]), int(numbers["recording"])
    instant_s = float(numbers["instant_s"])
    for k, (faulty, sound) in enumerate(pairs(4, "gain_change", None, plans)):
        is_after = faulty.time_s > instant_s + 0.1
        expected = gain * sound.noise_free_m * (is_after if k == order else float(k > order))
        settled = is_after | (faulty.time_s < instant_s)
        wrong = (change_m(faulty, sound) - expected)[settled]
        assert np.max(np.abs(wrong)) < 1e-9


def test_coarse_readings_lie_on_the_coarse_steps():
    faulty, _ = pair("sweep", 4, "quantisation")
    step_m = number(4, "quantisation", "step_m")
    codes = faulty.displacement_m / step_m
    tolerance = campaign(4).rig.adc_step_m / step_m
    assert np.max(np.abs(codes - np.round(codes))) < tolerance


def test_a_slip_lasts_and_is_not_in_the_time_column():
    kinds = set()
    for seed in (1, 4, 8, 10):
        numbers = campaign(seed, "timestamp_fault").answer.effects[0].numbers
        kinds.add(numbers["kind"])
        for order, (faulty, sound) in enumerate(pairs(seed, "timestamp_fault")):
            rows = len(faulty.time_s)
            assert np.array_equal(faulty.time_s, sound.time_s[:rows])
            assert np.array_equal(faulty.voltage_V, sound.voltage_V[:rows])
            slip_row = numbers.get(f"place_in_recording_{order}")
            if slip_row is None:
                assert np.array_equal(faulty.displacement_m, sound.displacement_m)
                continue
            shift = int(numbers["rows"]) * (1 if numbers["kind"] == "lost" else -1)
            row = int(0.7 * rows)
            assert faulty.noise_free_m[row] == sound.noise_free_m[row + shift]
            assert np.array_equal(
                faulty.noise_free_m[: rows // 10], sound.noise_free_m[: rows // 10]
            )
    assert kinds == {"lost", "stalled"}


def test_outliers_are_single_readings_of_either_sign():
    for faulty, sound in pairs(4, "outliers"):
        hit = np.flatnonzero(change_m(faulty, sound))
        assert 4 <= len(hit) <= 0.002 * len(faulty.time_s)
        assert np.mean(np.diff(np.sort(hit)) > 1) > 0.8


def test_an_initial_state_is_forgotten_after_a_full_cycle():
    faulty, sound = pair("rates", 4, "initial_state", 1.0)
    change = np.abs(change_m(faulty, sound))
    cycle = round(faulty.run.sampling_rate_Hz / 2.3)
    assert np.max(change[:cycle]) > 20.0 * np.max(change[cycle:])


def test_asymmetry_bends_both_branches_to_one_side():
    faulty, sound = pair("sweep", 4, "asymmetry")
    change = change_m(faulty, sound) * np.sign(number(4, "asymmetry", "curvature"))
    inside = (sound.voltage_V > 2.0) & (sound.voltage_V < 8.0)
    assert np.min(change[inside]) > 0.0


def test_non_congruence_opens_loops_at_a_single_end():
    faulty, sound = pair("rates", 4, "non_congruence", 0.6)
    cycle = slice(0, round(faulty.run.sampling_rate_Hz / 2.3))
    change, volts = change_m(faulty, sound)[cycle], faulty.voltage_V[cycle]
    rising = np.gradient(volts) > 0.0
    openings = [
        np.mean(change[~rising & is_near(volts, at)])
        - np.mean(change[rising & is_near(volts, at)])
        for at in (2.5, 7.5)
    ]
    assert openings[0] * openings[1] < 0.0
    assert abs(np.mean(change[is_near(volts, 5.0)])) < 0.1 * max(map(abs, openings))


@pytest.mark.parametrize("truth", [WALLS, BOUC_WEN])
def test_the_freer_end_of_walls_has_the_narrower_loops(truth):
    for seed in range(3):
        ceramic = truth.draw(np.random.default_rng(seed))
        wide = [loop_width(ceramic, bias) for bias in (-0.5, 0.5)]
        if abs(wide[1] / wide[0] - 1.0) > 0.03:
            assert freer_end(ceramic) == np.sign(wide[1] - wide[0])


def loop_width(ceramic: Ceramic, bias: float) -> float:
    """Return the rms opening of a small loop in its twentieth cycle."""
    up = np.linspace(bias - 0.25, bias + 0.25, 201)
    cycle = np.concatenate([up, up[-2:0:-1]])
    _, strain = ceramic.respond(np.tile(cycle, 20), np.array([-1.0, 1.0]))
    last_cycle = strain[-len(cycle) :]
    return float(np.sqrt(np.mean((last_cycle[1:200] - last_cycle[:200:-1]) ** 2)))


def is_near(volts: Array, at: float) -> NDArray[np.bool_]:
    return np.abs(volts - at) < 0.3
