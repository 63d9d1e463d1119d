"""Tables for a Nanonis controller: the published interface, and scan lines on the plants."""

import inspect
import json
import socket
import struct
import sys
import threading
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from piezoid.errors import ParameterFileError
from piezoid.targets.nanonis import (
    creep_after_move,
    hysteresis_table,
    line_errors_m,
    nanonis_files,
    settings_json,
)
from piezoid.targets.target_inputs import ControllerHardware
from tests.runtime.compiler import run, write_files
from tests.targets.known_inputs import csv_rows, exported


@cache
def files():
    return nanonis_files(exported())[0]


def calls(**changes):
    inputs = replace(exported(), **changes)
    tables = [hysteresis_table(inputs, axis) for axis in inputs.lateral]
    return json.loads(settings_json(inputs, tables))["calls"]


def test_calls_have_names_and_order_of_the_published_package():
    package = pytest.importorskip("nanonis_spm")
    for name, arguments in calls().items():
        parameters = list(inspect.signature(getattr(package.Nanonis, name)).parameters)[1:]
        assert parameters == list(arguments)


def test_the_transmitted_bytes_contain_the_table(tmp_path):
    """A server of this test receives from send.py and decodes without the package."""
    pytest.importorskip("nanonis_spm")
    write_files(tmp_path, files())
    received = {}

    def answer(connection):
        with connection:
            while len(header := connection.recv(40, socket.MSG_WAITALL)) == 40:
                name, size = header[:32].rstrip(b"\0").decode(), int.from_bytes(header[32:36])
                received[name] = connection.recv(size, socket.MSG_WAITALL) if size else b""
                floats = {"Piezo.SensGet": 3, "Piezo.XYZLimitsGet": 6}.get(name, 0)
                body = b"\0\1" if "Limits" in name and floats else b""
                body += struct.pack(f">{floats}f", *range(10, 10 + floats)) + b"\0" * 8
                connection.sendall(header[:32] + len(body).to_bytes(4) + b"\0" * 4 + body)

    with socket.create_server(("127.0.0.1", 0)) as server:
        thread = threading.Thread(target=lambda: answer(server.accept()[0]))
        thread.start()
        output = run(
            sys.executable, "send.py", "127.0.0.1", str(server.getsockname()[1]), cwd=tmp_path
        )
        thread.join(timeout=10)
    table = hysteresis_table(exported(), exported().lateral[0])
    body = received["Piezo.HystValsSet"]
    assert struct.unpack(">i", body[:4])[0] == 32
    np.testing.assert_array_equal(struct.unpack(">32f", body[4:132]), table.x_m)
    np.testing.assert_array_equal(struct.unpack(">32f", body[136:264]), table.y_m)
    # Y and Z are not in the stage and keep the values of the controller.
    assert struct.unpack(">3f", received["Piezo.SensSet"]) == (
        table.sensitivity_m_per_V,
        11.0,
        12.0,
    )
    assert "Piezo_SensSet" in output


def test_a_declared_amplifier_scales_to_volts_at_the_piezo():
    command, piezo = calls(), calls(amplifier_V_per_V={"x": 15.0})
    ratio = (
        command["Piezo_SensSet"]["Calibration_X_mPerV"]
        / piezo["Piezo_SensSet"]["Calibration_X_mPerV"]
    )
    assert ratio == pytest.approx(15.0, rel=1e-6)
    limits_V = [c["Piezo_XYZLimitsSet"]["Limit_X_high_V"] for c in (command, piezo)]
    assert limits_V[1] == pytest.approx(15.0 * limits_V[0])
    assert "those of the command" in files()["README.md"].decode()


def test_the_table_straightens_forward_lines_of_every_plant():
    axis = exported().lateral[0]
    rows = line_errors_m(exported(), axis, hysteresis_table(exported(), axis))
    assert len(rows) == len(exported().family("x"))
    for row in rows.values():
        assert row["table"] < 0.5 * row["straight"]
        assert row["mirrored"] < row["back"]
    assert rows["identified"]["table"] < 0.2 * rows["identified"]["straight"]


def test_the_csv_is_the_table():
    rows = csv_rows(files()["x.csv"])
    table = hysteresis_table(exported(), exported().lateral[0])
    for name, column in (("x_m", table.x_m), ("y_m", table.y_m)):
        np.testing.assert_array_equal(np.float32([float(row[name]) for row in rows]), column)
    assert json.loads(files()["nanonis.json"])["calls"] == calls()


def test_drift_compensation_follows_the_shipped_creep():
    axis = exported().lateral[0]
    rate, share = np.zeros(8), np.zeros(8)
    rate[0], share[0] = -np.expm1(-1.0 / (50.0 * 20e3)), 0.01  # 1 % with 50 s
    creeping = replace(
        axis, values={**axis.values, "relaxation_rate": rate, "relaxation_share": share}
    )
    stage = replace(exported(), file=replace(exported().file, axes=(creeping,)))
    table = hysteresis_table(stage, creeping)
    speed, drift_m, remaining_m = creep_after_move(stage, table)
    expected_m = 0.01 * table.half_m * (np.exp(-10.0 / 50.0) - np.exp(-100.0 / 50.0))
    assert drift_m == pytest.approx(expected_m, rel=1e-6)
    assert speed == pytest.approx(expected_m / 90.0, rel=1e-6)
    assert remaining_m < 0.5 * drift_m
    settings = calls(file=stage.file)["Piezo_DriftCompSet"]
    assert settings["Vx_m_s"] == pytest.approx(-speed, rel=1e-6)
    assert settings["Compensation_on_off"] == 2


def test_an_impossible_frame_or_table_is_refused_with_a_remedy():
    def refusal_of(**settings):
        with pytest.raises(ParameterFileError) as error:
            nanonis_files(replace(exported(), hardware=ControllerHardware(**settings)))
        return str(error.value)

    assert "the distance from the centre to the limits" in refusal_of(frame_half_range_m=1.0)
    assert "Set table_points =" in refusal_of(table_points=3)
